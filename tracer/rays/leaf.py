"""A leaf against a ray: `LANES` triangles at once, each decided as :mod:`tracer.rays.predicate` decides it.

Invariant: a lane is accepted here only where the predicate would take its rounded branch, by the same floats in the
same order; lanes that are not certain go to the scalar predicate itself. So t has the same bits on every path.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.predicate import CERTAIN, TINY, WELL_SHAPED, intersect_triangle
from tracer.simd import (
    absolute,
    bytes_of,
    count_trailing_zeros,
    float64x4,
    load,
    load_as_float64,
    mask_to_bits,
    maximum,
    minimum,
    splat,
    store,
)
from tracer.simd.gateway import types

LANES: Final = 4
_vector: Final = float64x4  # of LANES lanes: one AVX2 register; eight lanes at once measured slower there
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

# what a traversal looks for
CLOSEST: Final = 0
ANY: Final = 1
COUNT: Final = 2


@inline
def _spread(address: int) -> Any:
    return splat(_vector, load(_float64, address))


@inline
def test_leaf(rows: Any, leaf: int, n: int, first: int, state: int, times: int) -> Any:
    """Test triangles first .. first + LANES of a leaf of n.

    Parameters
    ----------
    rows
        Scalar type of the leaf's rows.
    leaf
        Address.
    n, first
        Triangles in the leaf; the first to test.
    state
        The ray's address.
    times
        Address for LANES float64: t of each lane.

    Returns
    -------
    tuple of int64
        Bits of the lanes that are met within (tmin, tbest], and of those that the scalar predicate must decide.
    """
    size = bytes_of(rows)
    row = n * size
    place = leaf + first * size
    at_x = place + load(_int64, state + s.AXIS_X) * row
    at_y = place + load(_int64, state + s.AXIS_Y) * row
    at_z = place + load(_int64, state + s.AXIS_Z) * row
    shear_x = _spread(state + s.SHEAR_X)
    shear_y = _spread(state + s.SHEAR_Y)
    ox = _spread(state + s.ORIGIN_X)
    oy = _spread(state + s.ORIGIN_Y)
    oz = _spread(state + s.ORIGIN_Z)
    az = load_as_float64(_vector, rows, at_z) - oz
    bz = load_as_float64(_vector, rows, at_z + 3 * row) - oz
    cz = load_as_float64(_vector, rows, at_z + 6 * row) - oz
    ax = (load_as_float64(_vector, rows, at_x) - ox) - shear_x * az
    ay = (load_as_float64(_vector, rows, at_y) - oy) - shear_y * az
    bx = (load_as_float64(_vector, rows, at_x + 3 * row) - ox) - shear_x * bz
    by = (load_as_float64(_vector, rows, at_y + 3 * row) - oy) - shear_y * bz
    cx = (load_as_float64(_vector, rows, at_x + 6 * row) - ox) - shear_x * cz
    cy = (load_as_float64(_vector, rows, at_y + 6 * row) - oy) - shear_y * cz
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    largest = maximum(
        maximum(maximum(absolute(ax), absolute(ay)), maximum(absolute(bx), absolute(by))),
        maximum(absolute(cx), absolute(cy)),
    )
    e = largest * largest * CERTAIN + TINY
    low = minimum(u, minimum(v, w))
    high = maximum(u, maximum(v, w))
    possible = (low >= -e) | (high <= e)
    present = (1 << min(n - first, LANES)) - 1
    possible_bits = mask_to_bits(possible) & present
    if possible_bits == 0:
        return _int64(0), _int64(0)
    total = (u + v) + w
    certain = ((low > e) | (high < -e)) & (absolute(total) > e * WELL_SHAPED)
    shear_z = _spread(state + s.SHEAR_Z)
    ta = shear_z * az
    tb = shear_z * bz
    tc = shear_z * cz
    least = minimum(ta, minimum(tb, tc))
    most = maximum(ta, maximum(tb, tc))
    t = ((u * ta + v * tb) + w * tc) / total
    t = maximum(t, least)
    t = minimum(t, most)
    store(times, t)
    t_min = _spread(state + s.T_MIN)
    t_best = _spread(state + s.T_BEST)
    certain_bits = mask_to_bits(certain) & present
    met = mask_to_bits((t > t_min) & (t <= t_best)) & certain_bits
    unsure = mask_to_bits((most > t_min) & (least <= t_best)) & possible_bits & ~certain_bits
    return met, unsure


@inline
def _scalar(rows: Any, leaf: int, n: int, lane: int, state: int) -> Any:
    """Evaluate the predicate on one triangle of a leaf: (met, t, U, V, W)."""
    size = bytes_of(rows)
    row = n * size
    place = leaf + lane * size
    x = place + load(_int64, state + s.AXIS_X) * row
    y = place + load(_int64, state + s.AXIS_Y) * row
    z = place + load(_int64, state + s.AXIS_Z) * row
    return intersect_triangle(
        load_as_float64(_float64, rows, x),
        load_as_float64(_float64, rows, y),
        load_as_float64(_float64, rows, z),
        load_as_float64(_float64, rows, x + 3 * row),
        load_as_float64(_float64, rows, y + 3 * row),
        load_as_float64(_float64, rows, z + 3 * row),
        load_as_float64(_float64, rows, x + 6 * row),
        load_as_float64(_float64, rows, y + 6 * row),
        load_as_float64(_float64, rows, z + 6 * row),
        load(_float64, state + s.ORIGIN_X),
        load(_float64, state + s.ORIGIN_Y),
        load(_float64, state + s.ORIGIN_Z),
        load(_float64, state + s.SHEAR_X),
        load(_float64, state + s.SHEAR_Y),
        load(_float64, state + s.SHEAR_Z),
    )


@kernel
def settle(rows: Any, leaf: int, n: int, first: int, unsure: int, state: int, times: int) -> Any:
    """Decide the unsure lanes by the scalar predicate; returns the bits that are met, their t in ``times``."""
    met = _int64(0)
    while unsure != 0:
        lane = count_trailing_zeros(unsure)
        unsure &= unsure - 1
        hit, t, _u, _v, _w = _scalar(rows, leaf, n, first + lane, state)
        if hit and t > load(_float64, state + s.T_MIN) and t <= load(_float64, state + s.T_BEST):
            store(times + 8 * lane, t)
            met |= _int64(1) << lane
    return met


@inline
def visit_leaf(rows: Any, leaf: int, n: int, state: int, times: int, mode: int) -> bool:
    """Test a leaf and note what it brings; True when the ray's answer changed.

    Closest: the least (t, id) is kept in the state. Any: BEST_ID becomes the first met. Count: BEST_ID is increased.
    """
    changed = False
    ids = leaf + 9 * n * bytes_of(rows)
    for first in range(0, n, LANES):
        met, unsure = test_leaf(rows, leaf, n, first, state, times)
        if unsure != 0:
            met |= settle(rows, leaf, n, first, unsure, state, times)
        while met != 0:
            lane = count_trailing_zeros(met)
            met &= met - 1
            t = load(_float64, times + 8 * lane)
            best = load(_float64, state + s.T_BEST)
            if mode == COUNT:
                if t < best:
                    store(state + s.BEST_ID, load(_int64, state + s.BEST_ID) + 1)
                continue
            primitive = _int64(load(_int32, ids + 4 * (first + lane))) >> ORDER_BITS
            if t < best or (t == best and primitive < load(_int64, state + s.BEST_ID)):
                store(state + s.BEST_ID, primitive)
                store(state + s.BEST_LEAF, leaf)
                store(state + s.BEST_LANE, (first + lane) << 8 | n)
                store(state + s.T_BEST, t)
                changed = True
    return changed


@inline
def barycentrics(rows: Any, state: int) -> Any:
    """Return (u, v) of the state's hit: the weights of the face's second and third vertex, in the order given."""
    leaf = load(_int64, state + s.BEST_LEAF)
    lane = load(_int64, state + s.BEST_LANE) >> 8
    n = load(_int64, state + s.BEST_LANE) & 255
    _hit, _t, u, v, w = _scalar(rows, leaf, n, lane, state)
    total = (u + v) + w
    order = _int64(load(_int32, leaf + 9 * n * bytes_of(rows) + 4 * lane)) & ((1 << ORDER_BITS) - 1)
    second = (PLACE_1 >> (2 * order)) & 3
    third = (PLACE_2 >> (2 * order)) & 3
    weight_1 = u if second == 0 else (v if second == 1 else w)
    weight_2 = u if third == 0 else (v if third == 1 else w)
    return weight_1 / total, weight_2 / total
