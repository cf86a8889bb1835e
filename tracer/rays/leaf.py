"""A leaf against a ray: `LANES` triangles at once, each decided as :mod:`tracer.rays.predicate` decides it.

Invariant: a lane is accepted here only where the predicate would take its rounded branch, by the same floats in the
same order; lanes that are not certain go to the scalar predicate itself. So t has the same bits on every path.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.predicate import CERTAIN, TINY, intersect_triangle, weigh
from tracer.simd import (
    absolute,
    convert,
    count_trailing_zeros,
    float32x4,
    float32x8,
    float64x4,
    float64x8,
    from_bits,
    int32x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    splat,
    store,
    to_bits,
)
from tracer.simd.gateway import types

LANES: Final = 4
_vector: Final = float64x4  # of LANES lanes: one AVX2 register; eight lanes at once measured slower there
_narrow: Final = float32x4
_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

# what a traversal looks for
CLOSEST: Final = 0
ANY: Final = 1
COUNT: Final = 2
DIM: Final = 3  # a packet's light is multiplied by what each surface lets through
_INF: Final = float("inf")
_SIGN_BIT: Final = -(2**31)

# Scratch of `test_leaf`: t, U, V, W of each lane.
TIMES: Final = 0
WEIGHTS: Final = 8 * LANES
LEAF_SCRATCH_BYTES: Final = 4 * 8 * LANES


@inline
def _spread(address: int) -> Any:
    return splat(_vector, load(_float64, address))


@inline
def _coarse(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _coarse_rows(at: int, row: int, wide: int) -> Any:
    """Load one coordinate of a leaf's A, B and C, eight triangles, rounded to float32."""
    if wide != 0:
        return (
            convert(_float32, load(float64x8, at)),
            convert(_float32, load(float64x8, at + 3 * row)),
            convert(_float32, load(float64x8, at + 6 * row)),
        )
    return load(float32x8, at), load(float32x8, at + 3 * row), load(float32x8, at + 6 * row)


@inline
def sift_leaf(wide: int, leaf: int, n: int, state: int) -> Any:
    """Return the bits of a leaf's triangles (n up to 8) that may be met; the others surely are not.

    The edge functions in float32. With eps = 2**-24 and Q the largest coordinate of ray and object, a coarse x or y is
    off by less than 16 eps Q < D = COARSE_ERROR: 4 eps Q for v - o, 8 eps Q for S z, 4 eps Q for their difference. With
    L the largest |x|, |y| of the three vertices, an edge function is off by 4 D (L + D) for that, and by 4 eps L**2 for
    its own roundings: in all less than E = (L + D) (5 D + 2**-20 (L + D)). A triangle is sifted out when one of its
    three edge functions is below -E and another above E: then the exact ones differ in sign.

    And it is when it lies before tmin: for the weights' mean m of z / d, the sum over U (z / d - tmin) is
    (m - tmin) (U + V + W), in float32 within (E + 2**-20 (|U| + |V| + |W|)) (|A.z| + |B.z| + |C.z| + 3 tmin) +
    5 D (|U| + |V| + |W|), roundings included; the predicate's own t is off by less than those. Where no edge function
    sifts the triangle out, |U| + |V| + |W| is at most |U + V + W| + 4 E. A NaN stays.
    """
    row = n << (2 + wide)
    shear_x, shear_y = _coarse(state + s.COARSE_SHEAR), _coarse(state + s.COARSE_SHEAR + 4)
    # o - v, not v - o: all x and y change sign, their products do not, and the load is part of the subtraction
    o = _coarse(state + s.COARSE_ORIGIN + 8)
    az, bz, cz = _coarse_rows(leaf + load(_int64, state + s.AXIS_Z) * row, row, wide)
    az, bz, cz = o - az, o - bz, o - cz
    o = _coarse(state + s.COARSE_ORIGIN)
    ax, bx, cx = _coarse_rows(leaf + load(_int64, state + s.AXIS_X) * row, row, wide)
    ax, bx, cx = multiply_add(shear_x, az, o - ax), multiply_add(shear_x, bz, o - bx), multiply_add(shear_x, cz, o - cx)
    o = _coarse(state + s.COARSE_ORIGIN + 4)
    ay, by, cy = _coarse_rows(leaf + load(_int64, state + s.AXIS_Y) * row, row, wide)
    ay, by, cy = multiply_add(shear_y, az, o - ay), multiply_add(shear_y, bz, o - by), multiply_add(shear_y, cz, o - cy)
    u = multiply_add(cx, by, -(cy * bx))
    v = multiply_add(ax, cy, -(ay * cx))
    w = multiply_add(bx, ay, -(by * ax))
    largest = maximum(
        maximum(maximum(absolute(ax), absolute(ay)), maximum(absolute(bx), absolute(by))),
        maximum(absolute(cx), absolute(cy)),
    )
    rounding = splat(float32x8, _float32(2.0**-20))
    off = _coarse(state + s.COARSE_ERROR_5)
    largest = largest + _coarse(state + s.COARSE_ERROR)
    e = largest * multiply_add(largest, rounding, off)
    low = minimum(u, minimum(v, w))
    high = maximum(u, maximum(v, w))
    out = minimum(high, -low) > e
    total = (u + v) + w
    ahead = multiply_add(u, az, multiply_add(v, bz, w * cz)) * _coarse(state + s.COARSE_SIGN)
    ahead = multiply_add(total, _coarse(state + s.COARSE_ENTRY), ahead)
    behind = from_bits(to_bits(ahead) ^ (~to_bits(total) & splat(int32x8, _SIGN_BIT)))
    weight = multiply_add(e, splat(float32x8, _float32(4.0)), absolute(total))
    depth = ((absolute(az) + absolute(bz)) + absolute(cz)) + _coarse(state + s.COARSE_ENTRY_3)
    slack = multiply_add(weight, off, multiply_add(weight, rounding, e) * depth)
    out = out | (behind > slack)
    return ~mask_to_bits(out) & ((1 << n) - 1)


@inline
def _rows(at: int, row: int, wide: int) -> Any:
    """Load LANES values of one coordinate of a leaf's A, B and C."""
    if wide != 0:
        return load(_vector, at), load(_vector, at + 3 * row), load(_vector, at + 6 * row)
    return (
        convert(_float64, load(_narrow, at)),
        convert(_float64, load(_narrow, at + 3 * row)),
        convert(_float64, load(_narrow, at + 6 * row)),
    )


@inline
def _value(address: int, wide: int) -> Any:
    """Load one value of a leaf's row."""
    return load(_float64, address) if wide != 0 else _float64(load(_float32, address))


@inline
def test_leaf(wide: int, leaf: int, n: int, first: int, state: int, scratch: int) -> Any:
    """Test triangles first .. first + LANES of a leaf of n.

    Parameters
    ----------
    wide
        1: the leaf's rows are float64; 0: float32.
    leaf
        Address.
    n, first
        Triangles in the leaf; the first to test.
    state
        The ray's address.
    scratch
        Address of LEAF_SCRATCH_BYTES: t, U, V and W of each lane, where anything is met.

    Returns
    -------
    tuple of int64
        Bits of the lanes that are met within (tmin, tbest], and of those that the scalar predicate must decide.
    """
    row = n << (2 + wide)
    place = leaf + (first << (2 + wide))
    at_x = place + load(_int64, state + s.AXIS_X) * row
    at_y = place + load(_int64, state + s.AXIS_Y) * row
    at_z = place + load(_int64, state + s.AXIS_Z) * row
    oz = _spread(state + s.ORIGIN_Z)
    az, bz, cz = _rows(at_z, row, wide)
    az, bz, cz = az - oz, bz - oz, cz - oz
    shear_x = _spread(state + s.SHEAR_X)
    ox = _spread(state + s.ORIGIN_X)
    ax, bx, cx = _rows(at_x, row, wide)
    ax = (ax - ox) - shear_x * az
    bx = (bx - ox) - shear_x * bz
    cx = (cx - ox) - shear_x * cz
    shear_y = _spread(state + s.SHEAR_Y)
    oy = _spread(state + s.ORIGIN_Y)
    ay, by, cy = _rows(at_y, row, wide)
    ay = (ay - oy) - shear_y * az
    by = (by - oy) - shear_y * bz
    cy = (cy - oy) - shear_y * cz
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
    certain = (low > e) | (high < -e)
    shear_z = _spread(state + s.SHEAR_Z)
    ta = shear_z * az
    tb = shear_z * bz
    tc = shear_z * cz
    least = minimum(ta, minimum(tb, tc))
    most = maximum(ta, maximum(tb, tc))
    u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
    t = ((u * ta + v * tb) + w * tc) / ((u + v) + w)
    t = maximum(t, least)
    t = minimum(t, most)
    t_min = _spread(state + s.T_MIN)
    t_best = _spread(state + s.T_BEST)
    certain_bits = mask_to_bits(certain) & present
    met = mask_to_bits((t > t_min) & (t <= t_best)) & certain_bits
    unsure = mask_to_bits((most > t_min) & (least <= t_best)) & possible_bits & ~certain_bits
    if met != 0:
        store(scratch + TIMES, t)
        store(scratch + WEIGHTS, u)
        store(scratch + WEIGHTS + 8 * LANES, v)
        store(scratch + WEIGHTS + 16 * LANES, w)
    return met, unsure


@inline
def _scalar(wide: int, leaf: int, n: int, lane: int, state: int) -> Any:
    """Evaluate the predicate on one triangle of a leaf: (met, t, U, V, W)."""
    row = n << (2 + wide)
    place = leaf + (lane << (2 + wide))
    x = place + load(_int64, state + s.AXIS_X) * row
    y = place + load(_int64, state + s.AXIS_Y) * row
    z = place + load(_int64, state + s.AXIS_Z) * row
    return intersect_triangle(
        _value(x, wide),
        _value(y, wide),
        _value(z, wide),
        _value(x + 3 * row, wide),
        _value(y + 3 * row, wide),
        _value(z + 3 * row, wide),
        _value(x + 6 * row, wide),
        _value(y + 6 * row, wide),
        _value(z + 6 * row, wide),
        load(_float64, state + s.ORIGIN_X),
        load(_float64, state + s.ORIGIN_Y),
        load(_float64, state + s.ORIGIN_Z),
        load(_float64, state + s.SHEAR_X),
        load(_float64, state + s.SHEAR_Y),
        load(_float64, state + s.SHEAR_Z),
    )


@kernel
def settle(wide: int, leaf: int, n: int, first: int, unsure: int, state: int, scratch: int) -> Any:
    """Decide the unsure lanes by the scalar predicate; returns the bits that are met, their t, U, V, W in scratch."""
    met = _int64(0)
    while unsure != 0:
        lane = count_trailing_zeros(unsure)
        unsure &= unsure - 1
        hit, t, u, v, w = _scalar(wide, leaf, n, first + lane, state)
        if hit and t > load(_float64, state + s.T_MIN) and t <= load(_float64, state + s.T_BEST):
            place = scratch + 8 * lane
            store(place + TIMES, t)
            store(place + WEIGHTS, u)
            store(place + WEIGHTS + 8 * LANES, v)
            store(place + WEIGHTS + 16 * LANES, w)
            met |= _int64(1) << lane
    return met


@inline
def take(wide: int, leaf: int, n: int, first: int, met: int, state: int, scratch: int, mode: int) -> bool:
    """Note what the lanes that are met bring; True when the ray's answer changed."""
    changed = False
    ids = leaf + 9 * (n << (2 + wide)) + 4 * first
    while met != 0:
        lane = count_trailing_zeros(met)
        met &= met - 1
        t = load(_float64, scratch + TIMES + 8 * lane)
        best = load(_float64, state + s.T_BEST)
        if mode == COUNT:
            if t < best:
                store(state + s.BEST_ID, load(_int64, state + s.BEST_ID) + 1)
            continue
        word = _int64(load(_int32, ids + 4 * lane))
        primitive = word >> ORDER_BITS
        if t < best or (t == best and primitive < load(_int64, state + s.BEST_ID)):
            store(state + s.BEST_ID, primitive if mode == CLOSEST else _int64(0))
            store(state + s.BEST_ORDER, word & ((1 << ORDER_BITS) - 1))
            u = load(_float64, scratch + WEIGHTS + 8 * lane)
            v = load(_float64, scratch + WEIGHTS + 8 * (LANES + lane))
            w = load(_float64, scratch + WEIGHTS + 8 * (2 * LANES + lane))
            total = (u + v) + w
            store(state + s.WEIGHTS, u / total)
            store(state + s.WEIGHTS + 8, v / total)
            store(state + s.WEIGHTS + 16, w / total)
            store(state + s.T_BEST, t)
            changed = True
    return changed


@inline
def visit_triangles(wide: int, leaf: int, n: int, left: int, state: int, scratch: int, mode: int) -> bool:
    """Test the triangles of a leaf whose bits are set and note what they bring; True when the ray's answer changed.

    Closest: the least (t, id) is kept in the state. Any: BEST_ID becomes 0. Count: BEST_ID, from -1, is increased.
    """
    changed = False
    while left != 0:
        first = count_trailing_zeros(left)
        left &= ~(_int64((1 << LANES) - 1) << first)
        met, unsure = test_leaf(wide, leaf, n, first, state, scratch)
        if met | unsure != 0:
            if unsure != 0:
                met |= settle(wide, leaf, n, first, unsure, state, scratch)
            if take(wide, leaf, n, first, met, state, scratch, mode):
                changed = True
    return changed


@inline
def visit_leaf(wide: int, leaf: int, n: int, state: int, scratch: int, mode: int) -> bool:
    """Test all triangles of a leaf; as `visit_triangles`."""
    return visit_triangles(wide, leaf, n, sift_leaf(wide, leaf, n, state), state, scratch, mode)


@inline
def barycentrics(state: int) -> Any:
    """Return (u, v) of the state's hit: the weights of the face's second and third vertex, in the order given."""
    weights = state + s.WEIGHTS
    order = load(_int64, state + s.BEST_ORDER)
    second = (PLACE_1 >> (2 * order)) & 3
    third = (PLACE_2 >> (2 * order)) & 3
    return load(_float64, weights + 8 * second), load(_float64, weights + 8 * third)


@inline
def finish(state: int, i: int, mode: int, outputs: Any) -> None:
    """Write the answer of ray i, as :func:`tracer.rays.single.trace_single` says; ``outputs`` are addresses.

    Arrays handed to an inlined function would cost eight atomic reference counts a ray, half the time of a small scene.
    """
    out_t, out_primitive, out_u, out_v = outputs
    primitive = load(_int64, state + s.BEST_ID)
    if mode == CLOSEST:
        t, u, v = _INF, 0.0, 0.0
        if primitive >= 0:
            t = load(_float64, state + s.T_BEST) * load(_float64, state + s.UNIT_T)
            u, v = barycentrics(state)
        store(out_primitive + 4 * i, _int32(primitive))
        store(out_t + 8 * i, t)
        store(out_u + 8 * i, u)
        store(out_v + 8 * i, v)
    else:
        store(out_primitive + 4 * i, _int32(primitive + 1))  # ANY: the id 0 stands for a hit
