"""Compensated sums of a wave's samples: each pixel's even and odd samples apart, one after another.

Invariant: a pixel's sums depend on its own samples and their order alone, whether it is added up by itself or side by
side with three neighbours: the same floats in the same order.

Sources: Knuth (two-sum: what a rounding lost, exactly, whichever term is larger); Neumaier 1974 (the lost parts are
summed apart and added at the end).
"""

from typing import Any, Final

from tracer.integrators.scratch import WAVE
from tracer.jit import inline, kernel
from tracer.rays.rows import INTEGERS, LANES, STEP, VECTOR
from tracer.simd import extract, iota, load, select, splat, stack_memory, store, transpose
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64
_FOUR: Final = 4 * STEP
SUMS: Final = 12  # numbers of a pixel: R, G, B of even samples, of odd ones, and what the roundings of these six lost
_ODD: Final = 3
_LOST: Final = 6


@inline
def _add(total: Any, lost: Any, value: Any) -> Any:
    """Return the new total and the new sum of what the roundings lost, of numbers or of lanes."""
    new = total + value
    back = new - total
    return new, lost + ((total - (new - back)) + (value - back))


@inline
def add_up(values: int, n: int, parity: int, sums: Any, place: int) -> None:
    """Add samples of a pixel and channel to its sums.

    Parameters
    ----------
    values, n
        Address of the samples; how many.
    parity
        Number of the first, or its rest modulo 2.
    sums, place
        Flat float64; where the channel's sum of even samples is.
    """
    for k in range(n):
        i = place + _ODD * ((parity + k) % 2)
        sums[i], sums[i + _LOST] = _add(sums[i], sums[i + _LOST], load(_float64, values + 8 * k))


@inline
def _add_color(sums: Any, place: int, color: Any, share: Any) -> None:
    """Add a colour times a number to one half of a pixel's sums."""
    sums[place], sums[place + _LOST] = _add(sums[place], sums[place + _LOST], color.x * share)
    sums[place + 1], sums[place + 1 + _LOST] = _add(sums[place + 1], sums[place + 1 + _LOST], color.y * share)
    sums[place + 2], sums[place + 2 + _LOST] = _add(sums[place + 2], sums[place + 2 + _LOST], color.z * share)


@inline
def add_everywhere(color: Any, first: int, end: int, sums: Any, place: int) -> None:
    """Add one colour to a pixel's sums for each of its samples ``first`` to ``end``."""
    n_even = (end + 1) // 2 - (first + 1) // 2
    _add_color(sums, place, color, _float64(n_even))
    _add_color(sums, place + _ODD, color, _float64(end - first - n_even))


@inline
def add_shares(color: Any, shares: int, n: int, parity: int, sums: Any, place: int) -> None:
    """Add to a pixel's sums one colour times each sample's share.

    Parameters
    ----------
    color
        R, G, B.
    shares, n
        Address of float64; how many. Memory is read up to the next multiple of four.
    parity
        Number of the first sample, or its rest modulo 2.
    sums, place
        Flat float64; where the pixel's begin.
    """
    total, lost = splat(VECTOR, 0.0), splat(VECTOR, 0.0)
    whole = n & ~(LANES - 1)
    for k in range(0, 8 * whole, STEP):
        total, lost = _add(total, lost, load(VECTOR, shares + k))
    if whole < n:
        rest = iota(INTEGERS) < splat(INTEGERS, _int64(n - whole))
        total, lost = _add(total, lost, select(rest, load(VECTOR, shares + 8 * whole), splat(VECTOR, 0.0)))
    lanes = total + lost
    one = extract(lanes, _int64(0)) + extract(lanes, _int64(2))
    other = extract(lanes, _int64(1)) + extract(lanes, _int64(3))
    odd = parity % 2 != 0
    _add_color(sums, place, color, other if odd else one)
    _add_color(sums, place + _ODD, color, one if odd else other)


@inline
def _add_four(values: int, n: int, first_is_odd: bool, sums: Any, place: int) -> None:
    """As `add_up` for four pixels that follow each other, ``n`` samples each, a multiple of four."""
    row = 8 * n
    state = stack_memory(_FOUR)
    first, second = (_ODD, 0) if first_is_odd else (0, _ODD)  # which sums the samples 0, 2, ... and 1, 3, ... go to
    for lane in range(LANES):
        pixel = place + SUMS * lane
        store(state + 8 * lane, _float64(sums[pixel + first]))
        store(state + STEP + 8 * lane, _float64(sums[pixel + second]))
        store(state + 2 * STEP + 8 * lane, _float64(sums[pixel + first + _LOST]))
        store(state + 3 * STEP + 8 * lane, _float64(sums[pixel + second + _LOST]))
    total_1, total_2 = load(VECTOR, state), load(VECTOR, state + STEP)
    lost_1, lost_2 = load(VECTOR, state + 2 * STEP), load(VECTOR, state + 3 * STEP)
    for k in range(0, row, STEP):
        a, b, c, d = transpose(
            load(VECTOR, values + k),
            load(VECTOR, values + row + k),
            load(VECTOR, values + 2 * row + k),
            load(VECTOR, values + 3 * row + k),
        )
        total_1, lost_1 = _add(total_1, lost_1, a)
        total_2, lost_2 = _add(total_2, lost_2, b)
        total_1, lost_1 = _add(total_1, lost_1, c)
        total_2, lost_2 = _add(total_2, lost_2, d)
    store(state, total_1)
    store(state + STEP, total_2)
    store(state + 2 * STEP, lost_1)
    store(state + 3 * STEP, lost_2)
    for lane in range(LANES):
        pixel = place + SUMS * lane
        sums[pixel + first] = load(_float64, state + 8 * lane)
        sums[pixel + second] = load(_float64, state + STEP + 8 * lane)
        sums[pixel + first + _LOST] = load(_float64, state + 2 * STEP + 8 * lane)
        sums[pixel + second + _LOST] = load(_float64, state + 3 * STEP + 8 * lane)


@kernel
def add_wave(radiance: int, n_pixels: int, per_pixel: int, first: int, sums: Any, place: int) -> None:
    """Add a wave's samples to its pixels' sums.

    Parameters
    ----------
    radiance
        Address of three rows of `WAVE` float64: R, G, B of the samples, pixel by pixel.
    n_pixels, per_pixel
        Pixels; samples of each.
    first
        Number of each pixel's first sample.
    sums, place
        Flat float64, `SUMS` of each pixel; where the first one's begin.
    """
    odd = first % 2 != 0
    for channel in range(3):
        values = radiance + 8 * WAVE * channel
        pixel = 0
        if per_pixel % LANES == 0:
            while pixel + LANES <= n_pixels:
                _add_four(values + 8 * pixel * per_pixel, per_pixel, odd, sums, place + SUMS * pixel + channel)
                pixel += LANES
        while pixel < n_pixels:
            add_up(values + 8 * pixel * per_pixel, per_pixel, first, sums, place + SUMS * pixel + channel)
            pixel += 1
