"""A leaf against a ray: eight triangles are sifted at once, and one is decided by :mod:`tracer.rays.predicate`.

Invariant: no triangle is sifted out that the predicate would say is met.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.accel.layout import UNIT
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.predicate import intersect_triangle
from tracer.simd import (
    absolute,
    convert,
    float32x8,
    float64x4,
    float64x8,
    from_bits,
    insert,
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

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

# what a traversal looks for
CLOSEST: Final = 0
ANY: Final = 1
COUNT: Final = 2
SHADE: Final = 3  # a packet's light is multiplied by what each surface lets through
_INF: Final = float("inf")
_SIGN_BIT: Final = -(2**31)


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
def leaf_of(base: int, word: int) -> Any:
    """Return (address, triangles) of the leaf that a child word names, in the tree at address ``base``."""
    return base + (word & 0x7FFFFFF8) * (UNIT // 8), (word & 7) + 1


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

    Nothing may overflow unseen. An x or y is below 4 Q, an edge function below 2**5 Q**2, their sum below 2**7 Q**2:
    all finite for Q < 2**60, beyond which D is infinite and nothing is sifted out (:mod:`tracer.rays.start`). Products
    with z or with tmin |d.kz| up to 2**4 Q are finite for Q < 2**38, beyond which COARSE_ENTRY_3 is infinite and
    nothing is before tmin; a greater tmin |d.kz| outweighs every z, so an infinite sum has its sign. Nor may it vanish:
    the slack is at least 100 D**3, for Q > 2**-22 more than 2**-120, which no rounding of denormals comes near; for
    smaller ones, too, nothing is before tmin.
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
def _value(address: int, wide: int) -> Any:
    """Load one value of a leaf's row."""
    return load(_float64, address) if wide != 0 else _float64(load(_float32, address))


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
def decide(wide: int, leaf: int, n: int, k: int, state: int) -> Any:
    """Decide about triangle k of a leaf by the scalar predicate: (met within (tmin, tbest], t, U, V, W)."""
    met, t, u, v, w = _scalar(wide, leaf, n, k, state)
    return met and t > load(_float64, state + s.T_MIN) and t <= load(_float64, state + s.T_BEST), t, u, v, w


@inline
def word_of(wide: int, leaf: int, n: int, k: int) -> Any:
    """Load a leaf's word of triangle k: id and vertex order."""
    return _int64(load(_int32, leaf + 9 * (n << (2 + wide)) + 4 * k))


@inline
def over_sum(u: float, v: float, w: float) -> Any:
    """Return a hit's weights over their sum, as `keep` takes them."""
    weights = insert(insert(splat(float64x4, u), 1, v), 2, w)
    return weights / splat(float64x4, (u + v) + w)


@inline
def keep(state: int, word: int, t: float, weights: Any) -> None:
    """Keep a hit as the nearest so far; ``weights`` are U, V, W over their sum, and one that does not matter."""
    store(state + s.WEIGHTS, weights)
    store(state + s.BEST_ID, word >> ORDER_BITS)
    store(state + s.BEST_ORDER, word & ((1 << ORDER_BITS) - 1))
    store(state + s.T_BEST, t)
    s.update_frame_best(state)


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
