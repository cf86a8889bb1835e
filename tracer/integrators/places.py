"""Where samples lie in the picture, up to 64 at a time, and in which order they travel."""

import math
from typing import Any, Final

from tracer.jit import inline, kernel
from tracer.rays.rows import LANES, PACKET, ROW, STEP, VECTOR
from tracer.sampling import lanes
from tracer.sampling.lanes import fill_samples, place_in_pixel
from tracer.simd import int32x4, iota, load, splat, stack_memory, store
from tracer.simd.gateway import types
from tracer.types import SAMPLER_SOBOL, SETTING_SAMPLER, SETTING_SAMPLES

_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64
PIXEL: Final = 4  # numbers of a pixel of a wave: x, y, key, and what was asked about it (`tracer.integrators.survey`)
_WORD_BYTES: Final = 4 * PACKET
_FINE: Final = 4  # cells a side that a pixel is divided into where it fills a packet, else 2
_CELLS_BYTES: Final = 8 * _FINE * _FINE


@kernel
def place_samples(
    settings: Any, pixels: Any, first_pixel: int, first: int, n: int, per_pixel: int, points: int, places: int
) -> None:
    """Find where up to 64 samples lie in the picture.

    Parameters
    ----------
    settings
        The scene's.
    pixels
        Flat int64, `PIXEL` of each pixel of the wave.
    first_pixel, first
        Pixel and sample of the first.
    n, per_pixel
        Samples; those of a pixel in this wave. The next pixel follows when one's are through.
    points
        Address of two rows of scratch.
    places
        Address of two rows, written: x and y in pixels from the top left corner of the full image.
    """
    sampler, n_samples = settings[SETTING_SAMPLER], settings[SETTING_SAMPLES]
    if sampler == SAMPLER_SOBOL and per_pixel % lanes.LANES == 0 and n % lanes.LANES == 0:
        together = min(per_pixel, n)
        for k in range(n // together):
            pixel = PIXEL * (first_pixel + k)
            place = places + 8 * k * together
            px, py, key = pixels[pixel], pixels[pixel + 1], pixels[pixel + 2]
            place_in_pixel(n_samples, key, first, together, px, py, place, place + ROW)
        return
    keys = stack_memory(_WORD_BYTES)
    indices = stack_memory(_WORD_BYTES)
    pixel, index = PIXEL * first_pixel, first
    if per_pixel % LANES == 0 and n % LANES == 0:  # four samples of one pixel at a time
        following = iota(int32x4)
        for k in range(0, n, LANES):
            store(keys + 4 * k, splat(int32x4, _int32(pixels[pixel + 2])))
            store(indices + 4 * k, following + splat(int32x4, _int32(index)))
            store(places + 8 * k, splat(VECTOR, _float64(pixels[pixel])))
            store(places + ROW + 8 * k, splat(VECTOR, _float64(pixels[pixel + 1])))
            index += LANES
            if index == first + per_pixel:
                pixel, index = pixel + PIXEL, first
    else:
        for k in range(n):
            store(keys + 4 * k, _int32(pixels[pixel + 2]))
            store(indices + 4 * k, _int32(index))
            store(places + 8 * k, _float64(pixels[pixel]))
            store(places + ROW + 8 * k, _float64(pixels[pixel + 1]))
            index += 1
            if index == first + per_pixel:
                pixel, index = pixel + PIXEL, first
    fill_samples(sampler, n_samples, n, keys, indices, points, points + ROW)
    for k in range(0, 8 * n, STEP):
        store(places + k, load(VECTOR, places + k) + load(VECTOR, points + k))
        store(places + ROW + k, load(VECTOR, places + ROW + k) + load(VECTOR, points + ROW + k))


@inline
def order_samples(x: int, y: int, n: int, per_pixel: int, points: int, numbers: int) -> None:
    """Bring the samples of each pixel that lie near each other together, so that four rays at a time go the same way.

    Parameters
    ----------
    x, y
        Addresses of rows of float64, places in the picture; put in order.
    n, per_pixel
        Up to 64 samples; those of a pixel here.
    points
        Address of three rows of scratch.
    numbers
        Address of int64: where each sample stood before.
    """
    cells = stack_memory(_CELLS_BYTES)
    fine = per_pixel >= PACKET
    side = _FINE if fine else 2
    for first in range(0, n, per_pixel):
        for cell in range(side * side):
            store(cells + 8 * cell, _int64(0))
        for k in range(first, first + per_pixel):
            u, v = load(_float64, x + 8 * k), load(_float64, y + 8 * k)
            column, row = _int64((u - math.floor(u)) * side), _int64((v - math.floor(v)) * side)
            # cells follow each other to and fro
            cell = row * side + (column if row & 1 == 0 else side - 1 - column)
            store(numbers + 8 * k, cell)
            store(points + 8 * k, u)
            store(points + ROW + 8 * k, v)
            store(cells + 8 * cell, load(_int64, cells + 8 * cell) + 1)
        place = first
        for cell in range(side * side):
            count = load(_int64, cells + 8 * cell)
            store(cells + 8 * cell, place)
            place += count
        for k in range(first, first + per_pixel):
            cell = cells + 8 * load(_int64, numbers + 8 * k)
            place = load(_int64, cell)
            store(cell, place + 1)
            store(x + 8 * place, load(_float64, points + 8 * k))
            store(y + 8 * place, load(_float64, points + ROW + 8 * k))
            store(points + 2 * ROW + 8 * place, k)
    for k in range(n):
        store(numbers + 8 * k, load(_int64, points + 2 * ROW + 8 * k))
