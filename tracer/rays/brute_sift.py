"""Which of a few triangles each of eight rays may meet: float32, all triangles, no branch (:mod:`tracer.rays.brute`).

Bounds, eps = 2**-24. In the frame a triangle's corners lie within 1 of the centre on every axis, origins p within 2,
and the largest component of a direction f is in [1, 2), so a hit p + s f has s <= 3. A triangle's plane is z + m0 x +
m1 y + m2 with |m0|, |m1| <= 1, |m2| <= 3, each corner within 2**-25 of it; its lines are U = a x + b y + c with |a|,
|b| <= 1, |c| <= 2; its area is at most 4. With products and sums rounded one by one, and what they are made of rounded
to float32, U at p (at most 6) is off by 24 eps, U along f (at most 4) by 16 eps, the plane at p (at most 9) by 38 eps
and along f (at most 6) by 24 eps. So U where the ray meets the plane, times the plane along f, is off by 740 eps; the
third line, the area times the plane along f less those two, by 1950 eps: less than `_MARGIN`, 2048 eps. t is off by
(38 + 3 * 24 + 1) eps over the plane along f, and by 3 eps of its own: less than `_SLACK` over that, with room for what
the ends' roundings come to. Where the plane along f is next to 0, that is more than 3 either way.
"""

from typing import Any, Final

from tracer.jit import inline, kernel
from tracer.rays.brute_table import FEW, PAIRS, PLANE_BYTES, PLANES, SINGLES
from tracer.rays.rows import LANES, PACKET, STEP, T_BEST, VECTOR, VECTORS
from tracer.rays.tile import T_MIN, start_vector
from tracer.simd import (
    absolute,
    convert,
    float32x8,
    from_bits,
    int32x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    prefetch,
    select,
    splat,
    stand_alone,
    store,
    to_bits,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

_MARGIN: Final = 2.0**-13
_SLACK: Final = 2.0**-15
_STEEP: Final = 2.0**-20  # of the plane along f, at least: `_SLACK` over it is 32
_FAR: Final = 2.0  # frame units: origins beyond go through the tree
_SIGN: Final = -(2**31)
_INF: Final = float("inf")
_AHEAD: Final = 2 * PACKET

# What is known of eight rays in float32: rows of eight.
_P: Final = 0  # x, y, z
_F: Final = 96  # x, y, z
_NEAREST: Final = 192
_FARTHEST: Final = 224
COARSE: Final = 256  # bytes
COARSE_BYTES: Final = COARSE * (PACKET // 8)
TIMES_BYTES: Final = 32 * FEW
WORD: Final = 32  # triangles that a word of candidates holds
HIGH: Final = 4 * PACKET  # from the first 32 triangles' words to the others'


@inline
def start_strip(tile: int, coarse: int, frame: Any, rays: Any, first: int) -> Any:
    """Fill a tile and its float32 rows with rays first .. first + 63; returns (rays that start near, and far away)."""
    cx, cy, cz, scale = frame
    near, far = _int64(0), _int64(0)
    origins, wide_o, directions, wide_d, _t_min, _step_min, _t_max, _step_max = rays
    limit = splat(VECTOR, _FAR)
    for i in range(VECTORS):
        number = first + LANES * i
        prefetch(origins + ((number + _AHEAD) * 12 << wide_o))
        prefetch(directions + ((number + _AHEAD) * 12 << wide_d))
        valid, origin, direction = start_vector(tile, i, rays, number)
        px = (origin[0] - splat(VECTOR, cx)) * splat(VECTOR, scale)
        py = (origin[1] - splat(VECTOR, cy)) * splat(VECTOR, scale)
        pz = (origin[2] - splat(VECTOR, cz)) * splat(VECTOR, scale)
        here = mask_to_bits((absolute(px) <= limit) & (absolute(py) <= limit) & (absolute(pz) <= limit))
        at = tile + STEP * i
        row = coarse + COARSE * (i // 2) + 16 * (i % 2)
        store(row + _P, convert(_float32, px))
        store(row + _P + 32, convert(_float32, py))
        store(row + _P + 64, convert(_float32, pz))
        store(row + _F, convert(_float32, direction[0]))
        store(row + _F + 32, convert(_float32, direction[1]))
        store(row + _F + 64, convert(_float32, direction[2]))
        store(row + _NEAREST, convert(_float32, load(VECTOR, at + T_MIN) * splat(VECTOR, scale)))
        store(row + _FARTHEST, convert(_float32, load(VECTOR, at + T_BEST) * splat(VECTOR, scale)))
        near |= (valid & here) << (LANES * i)
        far |= (valid & ~here) << (LANES * i)
    return near, far


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _flip(value: Any, sign: Any) -> Any:
    """Change the sign of the lanes whose bit is set."""
    return from_bits(to_bits(value) ^ sign)


@inline
def _line(plane: int, row: int, p: Any, f: Any, ahead: Any, slope: Any, sign: Any) -> Any:
    """Return a line's value where eight rays meet the plane, times |slope|."""
    a, b, c = _spread(plane + row), _spread(plane + row + 4), _spread(plane + row + 8)
    at_p = multiply_add(a, p[0], multiply_add(b, p[1], c))
    along = multiply_add(a, f[0], b * f[1])
    return _flip(multiply_add(at_p, slope, -(ahead * along)), sign)


@inline
def _test(plane: int, p: Any, f: Any, nearest: Any, best: Any, times: int, is_pair: bool) -> Any:
    """Hold eight rays against a triangle, or against two that make up a parallelogram.

    Parameters
    ----------
    plane
        Address of its numbers.
    p, f
        Origins and directions, in the order of the plane's axes.
    nearest, best
        Where the rays begin, and where they surely end.
    times
        Address of eight float32, of a pair sixteen, which receive the least t at which the rays may meet the triangle,
        or infinity.

    Returns
    -------
    float32x8
        Where the rays surely end now.
    """
    m0, m1 = _spread(plane), _spread(plane + 4)
    ahead = p[2] + multiply_add(m0, p[0], multiply_add(m1, p[1], _spread(plane + 8)))
    slope = f[2] + multiply_add(m0, f[0], m1 * f[1])
    sign = to_bits(slope) & splat(int32x8, _int32(_SIGN))
    u = _line(plane, 12, p, f, ahead, slope, sign)
    v = _line(plane, 24, p, f, ahead, slope, sign)
    steep = absolute(slope)
    area = _spread(plane + 36) * steep
    w = area - (u + v)
    low = minimum(u, minimum(v, w))
    inverse = splat(float32x8, _float32(1.0)) / maximum(steep, splat(float32x8, _float32(_STEEP)))
    t = _flip(-ahead, sign) * inverse
    slack = splat(float32x8, _float32(_SLACK)) * inverse
    early, late = t - slack, t + slack
    margin = splat(float32x8, _float32(_MARGIN))
    infinite = splat(float32x8, _float32(_INF))
    ends_late = late >= nearest
    store(times, select((low >= -margin) & ends_late, early, infinite))
    if is_pair:
        other = minimum(minimum(area - u, area - v), -w)
        store(times + 32, select((other >= -margin) & ends_late, early, infinite))
        low = maximum(low, other)
    return minimum(best, select((low > margin) & (early > nearest), late, infinite))


@inline
def _candidates(times: int, first: int, last: int, best: Any) -> Any:
    """Return, lane by lane, the bits of the triangles first .. last that a ray may meet before its end."""
    bits = splat(int32x8, _int32(0))
    for k in range(first, last):
        bit = splat(int32x8, _int32(_int64(1) << (k - first)))
        bits = bits | select(load(float32x8, times + 32 * k) <= best, bit, splat(int32x8, _int32(0)))
    return bits


@kernel
def sift(table: int, coarse: int, times: int, low: int, high: int) -> Any:
    """Write eight rays' candidates to ``low`` and ``high``; returns the bits of rays that surely meet something."""
    stand_alone()
    nearest, farthest = load(float32x8, coarse + _NEAREST), load(float32x8, coarse + _FARTHEST)
    best = farthest
    plane, triangle = table + PLANES, times
    for axis in range(3):
        x, y, z = coarse + 32 * ((axis + 1) % 3), coarse + 32 * ((axis + 2) % 3), coarse + 32 * axis
        p = load(float32x8, x + _P), load(float32x8, y + _P), load(float32x8, z + _P)
        f = load(float32x8, x + _F), load(float32x8, y + _F), load(float32x8, z + _F)
        for _ in range(load(_int64, table + PAIRS + 8 * axis)):
            best = _test(plane, p, f, nearest, best, triangle, True)
            plane += PLANE_BYTES
            triangle += 64
        for _ in range(load(_int64, table + SINGLES + 8 * axis)):
            best = _test(plane, p, f, nearest, best, triangle, False)
            plane += PLANE_BYTES
            triangle += 32
    n = (triangle - times) // 32
    store(low, _candidates(times, _int64(0), min(n, WORD), best))
    store(high, _candidates(times, _int64(WORD), n, best))
    return mask_to_bits(best < farthest)
