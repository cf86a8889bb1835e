"""Images: the usual forms, and bombs that are refused by their header."""

import io
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from loader_files import model_file, png_bytes
from PIL import Image

from tracer.loaders.errors import LoadError
from tracer.loaders.images import load_image
from tracer.loaders.limits import DEFAULT_LIMITS


def _saved(image, form, **options):
    buffer = io.BytesIO()
    image.save(buffer, form, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("form", ["PNG", "JPEG", "BMP", "TGA", "WEBP"])
def test_formats(tmp_path, form):
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:4] = (250, 20, 20)  # the upper half is red
    data = _saved(Image.fromarray(pixels), form)
    image = load_image(model_file(tmp_path, f"a.{form.lower()}", data))
    assert image.shape == (8, 16, 3)
    assert image.dtype == np.uint8
    assert np.abs(image[0, 0].astype(int) - (250, 20, 20)).max() < 12
    assert image[7, 15].max() < 12


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGBA", "CMYK"])
def test_modes(tmp_path, mode):
    form = "JPEG" if mode == "CMYK" else "PNG"
    image = load_image(
        model_file(tmp_path, "a.img", _saved(Image.new("RGB", (4, 4), (255, 255, 255)).convert(mode), form))
    )
    assert image.shape == (4, 4, 3)
    assert image.min() > 245


def test_sixteen_bits(tmp_path):
    grey = np.array([[0, 32768, 65535]], np.uint16)
    image = load_image(model_file(tmp_path, "a.png", _saved(Image.fromarray(grey), "PNG")))
    assert image[0, :, 0].tolist() == [0, 128, 255]


def test_a_bomb_is_refused_by_its_header(tmp_path):
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = zlib.compress(bytes(10_000_000), 9)
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    file = model_file(tmp_path, "bomb.png", data)
    tracemalloc.start()
    with pytest.raises(LoadError, match=r"bomb.png: is an image of 60000 x 60000 pixels, more than"):
        load_image(file)
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_the_limit_is_a_limit(tmp_path):
    limits = DEFAULT_LIMITS._replace(image_pixels=8)
    assert load_image(model_file(tmp_path, "a.png", png_bytes(4, 2), limits=limits)).shape == (2, 4, 3)
    with pytest.raises(LoadError, match="3 x 3"):
        load_image(model_file(tmp_path, "a.png", png_bytes(3, 3), limits=limits))


@pytest.mark.parametrize("content", [b"GIF89a" + bytes(100), b"%PDF-1.4", b"<svg/>", b"x", b"II*\0" + bytes(50)])
def test_what_is_no_image_is_refused(tmp_path, content):
    with pytest.raises(LoadError, match=r"a\.png: is not an image of a known format; use one of PNG"):
        load_image(model_file(tmp_path, "a.png", content))


@pytest.mark.parametrize("form", ["PNG", "JPEG", "BMP", "WEBP"])
def test_cut_images_are_refused(tmp_path, form):
    data = _saved(Image.effect_noise((64, 64), 50).convert("RGB"), form)
    for length in (10, len(data) // 3, len(data) // 2):
        with pytest.raises(LoadError, match=r"a\.png"):
            load_image(model_file(tmp_path, "a.png", data[:length]))
