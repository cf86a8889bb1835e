"""A small picture of what is done so far.

Invariant: a preview pixel is the plain mean, in linear light, of the finished pixels under it; where nothing is
finished, it is transparent. Its size never depends on the picture's beyond `max_side`, so a preview is cheap
for any film.
"""

import io

import numpy as np
from numpy.typing import NDArray

from tracer.film.develop import ColorSpace, encode_8bit
from tracer.film.tile import Rect


class Preview:
    """Gathers finished tiles into a downsampled picture.

    Parameters
    ----------
    window : Rect
        The rendered part of the picture (the crop, or all of it) in absolute pixels.
    max_side : int
        Upper bound of the preview's width and height, in pixels.
    """

    def __init__(self, window: Rect, max_side: int = 512) -> None:
        self._window = window
        self._factor = max(1, -(-max(window.width, window.height) // max_side))
        height, width = -(-window.height // self._factor), -(-window.width // self._factor)
        self._sums = np.zeros((height, width, 3), np.float64)
        self._weights = np.zeros((height, width), np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the preview in pixels."""
        return self._weights.shape

    def add(self, rect: Rect, pixels: NDArray[np.float32]) -> None:
        """Add a finished rectangle.

        Parameters
        ----------
        rect : Rect
            Absolute pixels, inside the window.
        pixels : float32 (height, width, 3)
            Linear.
        """
        rows, row_counts = self._cells(rect.y - self._window.y, rect.height)
        columns, column_counts = self._cells(rect.x - self._window.x, rect.width)
        sums = _sum_cells(pixels, row_counts, column_counts)
        if not np.isfinite(sums).all():  # a pixel at infinity or NaN must not eat its whole cell
            shown = np.nan_to_num(pixels.astype(np.float64), nan=0.0, posinf=1.0, neginf=0.0)
            sums = _sum_cells(shown, row_counts, column_counts)
        self._sums[rows, columns] += sums
        self._weights[rows, columns] += np.multiply.outer(row_counts, column_counts)

    def _cells(self, start: int, length: int) -> tuple[slice, NDArray[np.intp]]:
        """Return the cells along one axis: which, and how many pixels of the rectangle each takes."""
        first, last = start // self._factor, (start + length - 1) // self._factor
        edges = np.arange(first, last + 2) * self._factor
        edges[0], edges[-1] = start, start + length
        return slice(first, last + 1), np.diff(edges)

    def encode_png(self, color_space: ColorSpace = "srgb") -> bytes:
        """Return the preview as a PNG with an alpha channel."""
        from PIL import Image

        done = self._weights > 0.0
        means = self._sums / np.maximum(self._weights, 1.0)[:, :, np.newaxis]
        rgba = np.empty((*self.shape, 4), np.uint8)
        rgba[:, :, :3] = encode_8bit(means.astype(np.float32), color_space)
        rgba[:, :, 3] = np.where(done, 255, 0)
        buffer = io.BytesIO()
        Image.fromarray(rgba).save(buffer, format="PNG", compress_level=1)
        return buffer.getvalue()


def _sum_cells(
    pixels: NDArray[np.float32] | NDArray[np.float64], row_counts: NDArray[np.intp], column_counts: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Sum the pixels of each cell, rows first: whole rows are added, which is four times as fast as cell by cell."""
    sums = np.zeros((row_counts.size, *pixels.shape[1:]), np.float64)
    y = 0
    for cell, count in enumerate(row_counts.tolist()):
        for row in pixels[y : y + count]:
            sums[cell] += row
        y += count
    column_starts = np.cumsum(column_counts) - column_counts
    return np.add.reduceat(sums, column_starts, axis=1)
