"""From sums of samples to pixels, and from pixels to 8 bits.

Invariants: a pixel is `float32((half 0 + half 1) / N)`, added once, divided once, rounded once; an 8-bit value is
`round(255 * transfer(clamp(x)))` with the transfer curve in float64, clamped and never wrapped.
Source of the curve: IEC 61966-2-1 (sRGB).
"""

from functools import lru_cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.film.tile import N_HALVES, Rect, grid_of_blocks
from tracer.types import BLOCK_PX

ColorSpace = Literal["srgb", "linear"]

_ONE_BITS: Final = 0x3F800000
"""The bits of float32 1.0."""

_PIECE: Final = 1 << 15
"""Values that are encoded at once."""


class _Table(NamedTuple):
    """Step function from the upper half of a float32's bits to 8 bits.

    The upper 16 bits of a float32 in [0, 1] name a bin at most 2^-8 wide in value and 2^-7 in ratio. Neither curve
    has two steps in one bin (sRGB's steps are 0.009 apart at 1 and wider in ratio below), so the value is `low` of
    the bin, plus one where x reaches the bin's `step`.
    """

    low: NDArray[np.uint8]
    step: NDArray[np.float32]


def develop(sums: NDArray[np.float64], n_samples: int) -> NDArray[np.float32]:
    """Average the two halves of a film.

    Parameters
    ----------
    sums : float64 (..., 2, height, width, channels)
    n_samples : int
        Samples of both halves together.

    Returns
    -------
    float32 (..., height, width, channels)
        Linear radiance, not clamped.
    """
    if n_samples < 1:
        raise ValueError(f"a film of {n_samples} samples has no average")
    with np.errstate(over="ignore"):  # a radiance beyond float32 is infinite in the EXR and white in the PNG
        pixels: NDArray[np.float32] = ((sums[..., 0, :, :, :] + sums[..., 1, :, :, :]) / n_samples).astype(np.float32)
    return pixels


def develop_blocks(rect: Rect, block_sums: NDArray[np.float64], n_samples: int) -> NDArray[np.float32]:
    """Lay the kernel's blocks side by side, average their halves, and cut a tile's rectangle out of them.

    The same bits as `develop` of `join_blocks`, a row of blocks at a time, which stays in the processor's cache.

    Parameters
    ----------
    rect : Rect
        Absolute pixels.
    block_sums : float64 (n, 2, 16, 16, channels)
        In the order of `blocks_of_rect(rect)`.
    n_samples : int
        Samples of both halves together.

    Returns
    -------
    float32 (height, width, channels), C-contiguous
    """
    if n_samples < 1:
        raise ValueError(f"a film of {n_samples} samples has no average")
    n_rows, n_columns = grid_of_blocks(rect)
    n_channels = block_sums.shape[-1]
    if block_sums.shape != (n_rows * n_columns, N_HALVES, BLOCK_PX, BLOCK_PX, n_channels):
        raise ValueError(f"{block_sums.shape} is not {n_rows} x {n_columns} blocks")
    grid = block_sums.reshape(n_rows, n_columns, N_HALVES, BLOCK_PX, BLOCK_PX, n_channels)
    pixels = np.empty((n_rows, BLOCK_PX, n_columns, BLOCK_PX, n_channels), np.float32)
    means = np.empty((n_columns, BLOCK_PX, BLOCK_PX, n_channels), np.float64)
    with np.errstate(over="ignore"):  # as in `develop`
        for row in range(n_rows):
            np.add(grid[row, :, 0], grid[row, :, 1], out=means)
            np.divide(means, n_samples, out=means)
            pixels[row] = means.transpose(1, 0, 2, 3)  # (block column, row, ...) -> (row, block column, ...)
    y, x = rect.y % BLOCK_PX, rect.x % BLOCK_PX
    joined = pixels.reshape(n_rows * BLOCK_PX, n_columns * BLOCK_PX, n_channels)
    return np.ascontiguousarray(joined[y : y + rect.height, x : x + rect.width])


def srgb_from_linear(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the sRGB transfer curve to numbers in [0, 1]."""
    with np.errstate(invalid="ignore"):
        return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def linear_from_srgb(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Undo `srgb_from_linear`."""
    return np.where(encoded <= 0.04045, encoded / 12.92, np.power((encoded + 0.055) / 1.055, 2.4))


def encode_8bit(pixels: NDArray[np.float32], color_space: ColorSpace) -> NDArray[np.uint8]:
    """Turn linear pixels into 8 bits by the given transfer curve.

    Exactly `rint(255 * transfer(x))` in float64 for every float32 x; below 0 and NaN give 0, above 1 gives 255.
    A table instead of `np.power`, and in pieces that stay in the processor's cache: 3.5 ns a value, 0.09 s of CPU for
    3840 x 2160; all at once it takes 0.3 s, and by `np.power` 0.7 s.
    """
    table = _table(color_space)
    flat = pixels.reshape(-1)
    encoded = np.empty(flat.size, np.uint8)
    n = min(_PIECE, flat.size)
    room, room_for_bins, room_for_steps = np.empty(n, np.float32), np.empty(n, np.intp), np.empty(n, np.float32)
    for start in range(0, flat.size, _PIECE):
        piece = flat[start : start + _PIECE]
        clamped, bins, step = room[: piece.size], room_for_bins[: piece.size], room_for_steps[: piece.size]
        np.fmax(piece, np.float32(0.0), out=clamped)  # fmax(NaN, 0) is 0
        np.fmin(clamped, np.float32(1.0), out=clamped)
        clamped += np.float32(0.0)  # fmax may return either zero; the bits of 0.0 index the table, those of -0.0 do not
        np.right_shift(clamped.view(np.uint32), np.uint32(16), out=bins, casting="unsafe")
        out = encoded[start : start + _PIECE]
        np.take(table.low, bins, out=out, mode="clip")  # any other mode makes a copy; every bin is in the table
        np.take(table.step, bins, out=step, mode="clip")
        out += clamped >= step
    return encoded.reshape(pixels.shape)


@lru_cache(maxsize=2)
def _table(color_space: ColorSpace) -> _Table:
    """Find the steps of a transfer curve by bisection over the bits of float32."""
    values = np.arange(1, 256)
    below = np.zeros(values.size, np.uint32)
    reached = np.full(values.size, _ONE_BITS, np.uint32)
    while np.any(reached - below > 1):
        middle = below + (reached - below) // np.uint32(2)
        is_reached = _encode_exactly(middle.view(np.float32), color_space) >= values
        reached = np.where(is_reached, middle, reached)
        below = np.where(is_reached, below, middle)
    n_bins = (_ONE_BITS >> 16) + 1
    step_bins = reached >> np.uint32(16)
    if np.any(np.diff(step_bins) < 1):
        raise AssertionError("two steps of the transfer curve share a bin")
    starts = np.arange(n_bins, dtype=np.uint32) << np.uint32(16)
    low = _encode_exactly(starts.view(np.float32), color_space).astype(np.uint8)
    step = np.full(n_bins, np.inf, np.float32)
    inside = (reached & np.uint32(0xFFFF)) != 0  # a step at the very start of a bin is in `low` already
    step[step_bins[inside]] = reached[inside].view(np.float32)
    return _Table(low, step)


def _encode_exactly(linear: NDArray[np.float32], color_space: ColorSpace) -> NDArray[np.float64]:
    """Compute the definition, slowly."""
    exact = linear.astype(np.float64)
    return np.rint(255.0 * (srgb_from_linear(exact) if color_space == "srgb" else exact))
