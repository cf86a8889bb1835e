"""A contact sheet: pictures in labelled rows and columns, drawn with Pillow.

Invariant: pictures are shown pixel by pixel, not scaled, until the whole sheet is saved at the size that is asked for.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Picture = NDArray[np.uint8]
LINE_PX = 26
GAP_PX = 8


def difference(a: Picture, b: Picture, gain: int = 8) -> Picture:
    """Return the absolute difference of two pictures, times gain, clipped."""
    return np.minimum(np.abs(a.astype(int) - b.astype(int)) * gain, 255).astype(np.uint8)


def draw_sheet(columns: list[str], rows: list[tuple[str, list[Picture]]]) -> Image.Image:
    """Return a sheet with a title above each column and a line of text above each row of pictures."""
    height, width = rows[0][1][0].shape[:2]
    row_px = LINE_PX + height + GAP_PX
    size = (GAP_PX + len(columns) * (width + GAP_PX), LINE_PX + len(rows) * row_px)
    sheet = Image.new("RGB", size, (24, 24, 24))
    pen = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=17)
    for k, title in enumerate(columns):
        pen.text((GAP_PX + k * (width + GAP_PX), 4), title, fill=(255, 255, 255), font=font)
    for i, (label, pictures) in enumerate(rows):
        top = LINE_PX + i * row_px
        pen.text((GAP_PX, top + 3), label, fill=(255, 208, 120), font=font)
        for k, picture in enumerate(pictures):
            sheet.paste(Image.fromarray(picture), (GAP_PX + k * (width + GAP_PX), top + LINE_PX))
    return sheet


def save_sheet(sheet: Image.Image, path: Path, scale: float = 1.0) -> None:
    """Write the sheet, scaled, as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if scale != 1.0:
        size = (round(sheet.width * scale), round(sheet.height * scale))
        sheet = sheet.resize(size, Image.Resampling.LANCZOS)
    sheet.save(path, optimize=True)
