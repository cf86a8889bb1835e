"""Rays of a batch in tiles, as long as that is faster; the others many in flight.

Invariant: the answers of :mod:`tracer.rays.single`, bit for bit, in whatever company a ray travels.
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_SCALE
from tracer.jit import kernel
from tracer.rays.company import companions
from tracer.rays.leaf import CLOSEST
from tracer.rays.rows import LANES, PACKET
from tracer.rays.stream import follow
from tracer.rays.tile import TILE_BYTES, expect_outputs, finish_any, finish_closest, prepare_tile, ray_of, start_tile
from tracer.rays.tile_trace import trace_tile
from tracer.simd import (
    address_of,
    count_trailing_zeros,
    load,
    population_count,
    stack_memory,
    store,
)
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64

SIDE: Final = 8  # of a tile of a picture
WAITING: Final = 4096  # rays that travel alone, from which they set out
_NEAR: Final = 0.25  # of origins, in frame units (the scene is 1 to 2 wide)
_ALIKE: Final = 0.125  # of slopes
_FEWEST: Final = 16  # rays that travel together
_PATIENCE: Final = 20  # work a ray after which a tile is given up
_LONGEST: Final = 15  # tiles that are not tried after several in a row were given up
_ALONE_BYTES: Final = 8 * (WAITING + PACKET)


@kernel
def trace_coherent(
    tree: Any,
    rays: Any,
    start: int,
    end: int,
    mode: int,
    out_t: Any,
    out_primitive: Any,
    out_u: Any,
    out_v: Any,
    width: int,
) -> None:
    """Answer rays start..end in tiles; parameters as :func:`tracer.rays.single.trace_single`, without COUNT.

    Parameters
    ----------
    width
        Rays from one row of a picture to the next; less than SIDE: no picture, tiles are 64 rays in a row.
    """
    base = address_of(tree)
    tile, alone = stack_memory(TILE_BYTES), stack_memory(_ALONE_BYTES)
    outputs = (address_of(out_t), address_of(out_primitive), address_of(out_u), address_of(out_v))
    prepare_tile(tile)
    near = _NEAR / load(_float64, base + 8 * FRAME_SCALE)
    closest = _int64(1 if mode == CLOSEST else 0)
    n_alone = _int64(0)
    pause = skipped = _int64(0)
    tall = width >= SIDE and end - start >= SIDE * width
    rows = (end - start) // width if tall else 0
    columns = (width + SIDE - 1) // SIDE if tall else 0
    in_rows = ((rows + SIDE - 1) // SIDE) * columns
    strips = (end - start - rows * width + PACKET - 1) // PACKET
    for number in range(in_rows + strips):
        if number < in_rows:
            band, column = number // columns, number % columns
            # the last ones overlap those before: whoever comes second writes the same
            first = start + min(band * SIDE, rows - SIDE) * width + min(column * SIDE, width - SIDE)
            across, shift = width, _int64(1)
        else:
            first = start + rows * width + (number - in_rows) * PACKET
            across, shift = _int64(0), _int64(4)
            if first + PACKET > end:
                if end - start < PACKET:
                    break
                first = end - PACKET
        rest = _int64(-1)
        if skipped < pause:
            skipped += 1
        else:
            left = start_tile(tile, rays, first, across, shift)
            if mode == CLOSEST:
                expect_outputs(outputs, first, across, shift)
            met = rest = _int64(0)
            while left != 0:
                chosen = companions(tile, left, near, _ALIKE)
                left &= ~chosen
                count = population_count(chosen)
                if count < _FEWEST:
                    rest |= chosen
                    continue
                hit, lost = trace_tile(base, tile, chosen, closest, _PATIENCE * count)
                met |= hit
                rest |= lost
            if mode == CLOSEST:
                finish_closest(tile, outputs, first, across, shift)
            else:
                finish_any(met, outputs, first, across, shift)
            skipped = _int64(0)
            pause = min(2 * pause + 1, _LONGEST) if 2 * population_count(rest) > PACKET else _int64(0)
        while rest != 0:
            k = count_trailing_zeros(rest)
            rest &= rest - 1
            store(alone + 8 * n_alone, ray_of(k // LANES, first, across, shift) + k % LANES)
            n_alone += 1
        if n_alone >= WAITING:
            follow(base, rays, alone, _int64(0), n_alone, mode, outputs)
            n_alone = _int64(0)
    if n_alone > 0:
        follow(base, rays, alone, _int64(0), n_alone, mode, outputs)
    if end - start < PACKET:
        follow(base, rays, _int64(0), start, end, mode, outputs)
