"""Decode an image file into 8-bit RGB.

Invariant: the size in the header is checked before a pixel is decoded, so a small file cannot take much memory.
Source: Pillow, with the formats of `limits.IMAGE_FORMATS` and no others.
"""

import io
import warnings

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.files import ModelFile
from tracer.loaders.limits import IMAGE_FORMATS, LoadLimits


class ImageError(Exception):
    """The bytes are not an image that can be used; the message says why, and `mend` what would be right."""

    def __init__(self, reason: str, mend: str) -> None:
        super().__init__(reason)
        self.mend = mend


def load_image(file: ModelFile) -> NDArray[np.uint8]:
    """Read an image file.

    Returns
    -------
    uint8 (height, width, 3)
        As encoded in the file (mostly sRGB), row 0 at the top.

    Raises
    ------
    LoadError
    """
    try:
        return decode_image(file.read(), file.limits)
    except ImageError as error:
        raise file.error(str(error), error.mend) from None


def decode_image(data: bytes, limits: LoadLimits) -> NDArray[np.uint8]:
    """Decode bytes; `ImageError` says what is wrong with them."""
    from PIL import Image, ImageFile, UnidentifiedImageError

    ImageFile.LOAD_TRUNCATED_IMAGES = False
    Image.MAX_IMAGE_PIXELS = None  # our own bound is checked right after the header
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=IMAGE_FORMATS) as image:
                width, height = image.size
                if width < 1 or height < 1 or width * height > limits.image_pixels:
                    text = f"is an image of {width} x {height} pixels, more than the {limits.image_pixels} allowed"
                    raise ImageError(text, "make it smaller")  # noqa: TRY301 - passed through below
                if image.mode.startswith("I"):  # 16 bits of grey
                    grey = (np.asarray(image).astype(np.uint32) * 255 + 32767) // 65535
                    return np.repeat(np.minimum(grey, 255).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
                # Transparent pixels keep the colour that is stored under them.
                return np.array(image.convert("RGB"))
    except ImageError:
        raise
    except UnidentifiedImageError:
        raise ImageError("is not an image of a known format", f"use one of {', '.join(IMAGE_FORMATS)}") from None
    except (OSError, SyntaxError, ValueError, EOFError, IndexError, OverflowError, TypeError, KeyError) as error:
        raise ImageError(f"is a damaged image ({str(error)[:100]})", "save it again, or name another") from None
