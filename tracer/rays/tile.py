"""A tile: 64 rays that lie side by side in a batch, from the arrays into rows of lanes and back.

A batch in the order of a picture's rows is cut into tiles of 8 rows of 8 rays; any other one into 64 rays in a row.
Either way four rays of a vector follow each other in the arrays, so that all goes in and out four at a time.

The rows are those of :mod:`tracer.rays.rows` as far as they are known here, and two more.
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    ORIGIN,
    PRIMITIVE,
    RAY_ROWS,
    ROW,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    WEIGHT_1,
    WEIGHT_2,
    shear_lanes,
)
from tracer.rays.start import as_intervals, four_limits, four_vectors
from tracer.simd import convert, int32x4, load, mask4, mask_from_bits, mask_to_bits, prefetch, select, splat, store
from tracer.simd.gateway import types

_int32: Final = types.int32
_int64: Final = types.int64

T_MIN: Final = RAY_ROWS * ROW  # in units of UNIT_T, as T_BEST
UNIT_T: Final = T_MIN + ROW
WEIGHTS: Final = UNIT_T + ROW  # sum of the three; WEIGHT_1 and WEIGHT_2 are not yet divided by it
LANE_MASKS: Final = WEIGHTS + ROW  # for each set of four lanes, int64: -1 where a lane is in it
TILE_BYTES: Final = LANE_MASKS + 16 * STEP
_INF: Final = float("inf")


@inline
def ray_of(vector: int, first: int, width: int, shift: int) -> Any:
    """Return the number of a vector's first ray, in a tile from ray ``first`` on: rows of 2**shift vectors."""
    return first + (vector >> shift) * width + LANES * (vector & ((1 << shift) - 1))


@inline
def prepare_tile(tile: int) -> None:
    """Write what stays in a tile's memory whatever rays come."""
    for bits in range(16):
        for lane in range(LANES):
            store(tile + LANE_MASKS + STEP * bits + 8 * lane, -_int64((bits >> lane) & 1))


@inline
def start_vector(tile: int, vector: int, rays: Any, number: int) -> Any:
    """Fill a vector of a tile with rays number .. number + 3 of the arrays.

    Returns
    -------
    tuple
        (bits of those that can meet anything; origins x, y, z; directions x, y, z, the largest in [1, 2)).
    """
    origins, wide_o, directions, wide_d, t_min, step_min, t_max, step_max = rays
    ox, oy, oz = four_vectors(origins + number * (12 << wide_o), wide_o)
    dx, dy, dz = four_vectors(directions + number * (12 << wide_d), wide_d)
    nearest, farthest = four_limits(t_min + step_min * number, step_min, t_max + step_max * number, step_max)
    valid, unit, dx, dy, dz, nearest, farthest = as_intervals(ox, oy, oz, dx, dy, dz, nearest, farthest)
    at = tile + STEP * vector
    store(at + ORIGIN, ox)
    store(at + ORIGIN + ROW, oy)
    store(at + ORIGIN + 2 * ROW, oz)
    store(at + T_MIN, nearest)
    store(at + T_BEST, farthest)
    store(at + UNIT_T, unit)
    store(at + PRIMITIVE, splat(INTEGERS, _int64(-1)))
    shear_lanes(tile, vector, dx, dy, dz)
    return mask_to_bits(valid), (ox, oy, oz), (dx, dy, dz)


@inline
def start_tile(tile: int, rays: Any, first: int, width: int, shift: int) -> Any:
    """Fill a tile from the arrays, and ask for the memory of the next tile but one.

    Parameters
    ----------
    tile
        Address of TILE_BYTES.
    rays
        As :func:`tracer.rays.start.start_rays` takes it.
    first, width, shift
        The tile's first ray, rays from row to row, and the binary logarithm of a row's vectors.

    Returns
    -------
    int64
        The rays that can meet anything.
    """
    origins, wide_o, directions, wide_d, _t_min, _step_min, _t_max, _step_max = rays
    rays_there = _int64(0)
    ahead = (2 * LANES) << shift
    for i in range(VECTORS):
        number = ray_of(i, first, width, shift)
        soon = (number + ahead) * 12
        prefetch(origins + (soon << wide_o))
        prefetch(directions + (soon << wide_d))
        valid, _origin, _direction = start_vector(tile, i, rays, number)
        rays_there |= valid << (LANES * i)
    return rays_there


@inline
def expect_outputs(outputs: Any, first: int, width: int, shift: int) -> None:
    """Ask for the memory that `finish_closest` will write."""
    for i in range(VECTORS):
        number = ray_of(i, first, width, shift)
        prefetch(outputs[0] + 8 * number)
        prefetch(outputs[1] + 4 * number)
        prefetch(outputs[2] + 8 * number)
        prefetch(outputs[3] + 8 * number)


@inline
def finish_closest(tile: int, outputs: Any, first: int, width: int, shift: int) -> None:
    """Write a tile's nearest hits, as :func:`tracer.rays.single.trace_single` says."""
    out_t, out_primitive, out_u, out_v = outputs
    zero = splat(VECTOR, 0.0)
    for i in range(VECTORS):
        at = tile + STEP * i
        number = ray_of(i, first, width, shift)
        primitive = load(INTEGERS, at + PRIMITIVE)
        met = primitive >= splat(INTEGERS, _int64(0))
        store(out_primitive + 4 * number, convert(_int32, primitive))
        store(
            out_t + 8 * number,
            select(met, load(VECTOR, at + T_BEST) * load(VECTOR, at + UNIT_T), splat(VECTOR, _INF)),
        )
        total = load(VECTOR, at + WEIGHTS)
        store(out_u + 8 * number, select(met, load(VECTOR, at + WEIGHT_1) / total, zero))
        store(out_v + 8 * number, select(met, load(VECTOR, at + WEIGHT_2) / total, zero))


@inline
def finish_any(met: int, outputs: Any, first: int, width: int, shift: int) -> None:
    """Write which rays of a tile met anything."""
    one, zero = splat(int32x4, _int32(1)), splat(int32x4, _int32(0))
    for i in range(VECTORS):
        mask = mask_from_bits(mask4, (met >> (LANES * i)) & 15)
        store(outputs[1] + 4 * ray_of(i, first, width, shift), select(mask, one, zero))
