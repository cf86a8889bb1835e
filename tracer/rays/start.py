"""From arrays of rays to states, four rays at a time in lanes.

Invariants: what the predicate reads (shear, origin, T_MIN, T_BEST, UNIT_T) has the bits that the scalar functions of
:mod:`tracer.rays.predicate` give; what the node test reads is conservative as :mod:`tracer.rays.state` says. A ray
that meets nothing, by definition or because it passes the object's box by, starts with the child word `END`.
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_CENTRE, FRAME_HALF, FRAME_SCALE, HEADER_BYTES, LARGEST, LEAF_BIT, NODE_HIGH, UNIT
from tracer.jit import inline
from tracer.rays import state as s
from tracer.simd import (
    absolute,
    any_lane,
    convert,
    deinterleave,
    float32x4,
    float64x4,
    from_bits,
    int64x4,
    load,
    maximum,
    minimum,
    select,
    splat,
    store,
    to_bits,
    transpose,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

LANES: Final = 4
SCRATCH_BYTES: Final = 256
ROOT: Final = HEADER_BYTES // UNIT << 3  # child word of the tree's root
END: Final = LEAF_BIT  # a leaf in the header, where none is: nothing is left to visit

_ROUNDING: Final = 2.0**-21
_LATE: Final = 2.0**-18
_LEAST_D: Final = 1e-18  # smaller direction components count as this: over the frame they move a ray by 4e-18
_WELL: Final = 2.0**-20  # frame time that a well-shaped triangle's t can be off: 6 * 2**-24, and room
COARSE_ROUNDING: Final = 2.0**-20  # of the largest coordinate: 16 * 2**-24; see tracer.rays.leaf
COARSE_LEAST: Final = 1e-18  # its square is above what float32 products lose to underflow
# Coordinates for which the sieve's products of two lengths, and of three, neither overflow nor vanish: tracer.rays.leaf
_SQUARES: Final = 2.0**60
_CUBES: Final = 2.0**38
_LEAST_CUBES: Final = 2.0**-22
_FINITE: Final = 1.7976931348623157e308
_INF: Final = float("inf")


@inline
def _f64(value: float) -> Any:
    return splat(float64x4, value)


@inline
def _f32(value: float) -> Any:
    return splat(float32x4, value)


@inline
def _i64(value: int) -> Any:
    return splat(int64x4, value)


@inline
def four_vectors(address: int, wide: int) -> Any:
    """Load x, y, z of four consecutive rows of three float32 (float64 when ``wide``)."""
    if wide != 0:
        x, y, z = deinterleave(load(float64x4, address), load(float64x4, address + 32), load(float64x4, address + 64))
        return x, y, z
    x, y, z = deinterleave(load(float32x4, address), load(float32x4, address + 16), load(float32x4, address + 32))
    return convert(_float64, x), convert(_float64, y), convert(_float64, z)


@inline
def _slab(origin: Any, direction: Any, slop: Any) -> Any:
    """Return (r, p - pad, p + pad) in float32, and whether the direction counts as negative."""
    o = convert(_float32, origin)
    d = convert(_float32, direction)
    d = select(absolute(d) < _f32(_LEAST_D), _f32(_LEAST_D), d)
    r = _f32(1.0) / d
    p = -o * r
    pad = (absolute(p) * _f32(_ROUNDING) + _f32(_LATE)) + slop * absolute(r)
    return r, p - pad, p + pad, d < _f32(0.0)


@inline
def _near_row(negative: Any, row: int) -> Any:
    """Return the row of the bounds that a ray meets first."""
    return select(negative, _i64(NODE_HIGH + row), _i64(row))


@inline
def _entry(p: Any, f: Any, h: Any, slop: Any, entry: Any, leave: Any) -> Any:
    """Clip (entry, leave) by the slab -h - slop .. h + slop of one axis."""
    inverse = _f64(1.0) / select(absolute(f) < _f64(1e-200), _f64(1e-200), f)
    a = (-h - slop - p) * inverse
    b = (h + slop - p) * inverse
    return maximum(entry, minimum(a, b)), minimum(leave, maximum(a, b))


@inline
def _store_rows(states: Any, field: int, a: Any, b: Any, c: Any, d: Any) -> None:
    """Store four fields of four rays; ``states`` are the states' addresses."""
    s0, s1, s2, s3 = states
    r0, r1, r2, r3 = transpose(a, b, c, d)
    store(s0 + field, r0)
    store(s1 + field, r1)
    store(s2 + field, r2)
    store(s3 + field, r3)


@inline
def as_intervals(ox: Any, oy: Any, oz: Any, dx: Any, dy: Any, dz: Any, t_min: Any, t_max: Any) -> Any:
    """Bring four rays into the form that the predicate takes.

    A ray is an open interval (max(tmin, 0), tmax) of o + t d. NaN anywhere, a zero or infinite direction, an origin
    beyond 1e100, or an empty interval: no ray, it meets nothing.

    Parameters
    ----------
    ox, oy, oz, dx, dy, dz, t_min, t_max
        float64x4.

    Returns
    -------
    tuple
        (whether it is a ray, `tracer.rays.predicate.unit_of` it, the direction times that: x, y, z; tmin and tmax for
        that direction: t is theirs times the unit).
    """
    zero, one = _f64(0.0), _f64(1.0)
    largest = maximum(maximum(absolute(dx), absolute(dy)), absolute(dz))
    t_min = maximum(zero, t_min)  # a NaN stays
    limit = _f64(LARGEST)
    infinite = _f64(_INF)
    valid = (absolute(dx) < infinite) & (absolute(dy) < infinite) & (absolute(dz) < infinite) & (largest > zero)
    valid = valid & (absolute(ox) <= limit) & (absolute(oy) <= limit) & (absolute(oz) <= limit) & (t_min < t_max)
    unit = from_bits(maximum(_i64(1), _i64(2046) - ((to_bits(largest) >> 52) & _i64(2047))) << 52)
    t_unit = one / unit
    t_min = t_min * t_unit
    t_max = minimum(minimum(t_max, _f64(_FINITE)) * t_unit, _f64(_FINITE))  # a t beyond float64 is no hit
    return valid, unit, dx * unit, dy * unit, dz * unit, t_min, t_max


@inline
def start_four(
    places: int,
    base: int,
    reach: float,
    origins: int,
    wide_o: int,
    directions: int,
    wide_d: int,
    t_min: Any,
    t_max: Any,
) -> None:
    """Fill four states from four consecutive rays and the tree at address ``base``.

    Parameters
    ----------
    places
        Address of four int64, the states' addresses. STACK, STACK_TOP and RAY_INDEX are left to the caller.
    base
        Address of the tree.
    reach
        From `reach_of`.
    origins, directions
        Addresses of four rows of three values: float64 where ``wide_o`` and ``wide_d`` are not 0, else float32.
    t_min, t_max
        float64x4.
    """
    # once: a store might write to where they are read from
    states = load(_int64, places), load(_int64, places + 8), load(_int64, places + 16), load(_int64, places + 24)
    ox, oy, oz = four_vectors(origins, wide_o)
    dx, dy, dz = four_vectors(directions, wide_d)
    valid, unit, fx, fy, fz, t_min, t_max = as_intervals(ox, oy, oz, dx, dy, dz, t_min, t_max)
    # tracer.rays.predicate.shear_of
    x, y, z = absolute(fx), absolute(fy), absolute(fz)
    on_z = (z >= x) & (z >= y)
    on_y = y >= x
    major = select(on_z, fz, select(on_y, fy, fx))
    shear_z = _f64(1.0) / major
    shear_x = select(on_z, fx, select(on_y, fz, fy)) * shear_z
    shear_y = select(on_z, fy, select(on_y, fx, fz)) * shear_z
    shear = shear_x, shear_y, shear_z, major, on_z, on_y
    none = _i64(-1)
    fill_states(states, base, reach, (ox, oy, oz), (fx, fy, fz), (valid, unit, t_min, t_max), shear, none, none)


@inline
def fill_states(
    states: Any, base: int, reach: float, origin: Any, direction: Any, interval: Any, shear: Any, best: Any, skip: Any
) -> None:
    """Fill four states.

    Parameters
    ----------
    states
        Their addresses. STACK, STACK_TOP and RAY_INDEX are left to the caller.
    base, reach
        As for `start_four`.
    origin, direction
        x, y, z, float64x4; directions times their unit.
    interval
        From `as_intervals`: valid, unit, tmin, tmax.
    shear
        Sx, Sy, Sz, the component along kz, and whether that is z or y.
    best, skip
        int64x4: BEST_ID and SKIP.
    """
    ox, oy, oz = origin
    fx, fy, fz = direction
    valid, unit, t_min, t_max = interval
    shear_x, shear_y, shear_z, major, on_z, on_y = shear
    zero, one = _f64(0.0), _f64(1.0)
    infinite = _f64(_INF)
    half = base + 8 * FRAME_HALF
    hx, hy, hz = _f64(load(_float64, half)), _f64(load(_float64, half + 8)), _f64(load(_float64, half + 16))
    valid = valid & (hx >= zero)  # negative: an empty tree
    scale = _f64(load(_float64, base + 8 * FRAME_SCALE))
    centre = base + 8 * FRAME_CENTRE
    px = (ox - _f64(load(_float64, centre))) * scale
    py = (oy - _f64(load(_float64, centre + 8))) * scale
    pz = (oz - _f64(load(_float64, centre + 16))) * scale
    distance = maximum(maximum(absolute(px), absolute(py)), absolute(pz))
    slop = (one + distance) * 2.0**-48
    slack = distance * 2.0**-46 + _f64(_WELL)
    entry = zero
    blind = slop > one
    outside = (absolute(px) > hx) | (absolute(py) > hy) | (absolute(pz) > hz)
    if any_lane(outside):
        # move the origin to the frame's box, so that float32 resolves what follows
        entry, leave = _entry(px, fx, hx, slop, zero, infinite)
        entry, leave = _entry(py, fy, hy, slop, entry, leave)
        entry, leave = _entry(pz, fz, hz, slop, entry, leave)
        valid = valid & (blind | (entry * (1.0 - 2.0**-40) <= leave * (1.0 + 2.0**-40)))
        px, py, pz = px + entry * fx, py + entry * fy, pz + entry * fz
        # So far away that float64 does not resolve the object: visit every node, the predicate decides. Frame times
        # mean nothing either: 0 .. 1e30 for good.
        px, py, pz = select(blind, zero, px), select(blind, zero, py), select(blind, zero, pz)
        entry = select(blind, zero, entry)
        scale = select(blind, zero, scale)
        slack = select(blind, _f64(1e30), slack)
        slop = select(blind, _f64(4.0), slop)
    slop32 = convert(_float32, slop + _f64(2.0**-40))
    rx, near_x, far_x, neg_x = _slab(px, fx, slop32)
    ry, near_y, far_y, neg_y = _slab(py, fy, slop32)
    rz, near_z, far_z, neg_z = _slab(pz, fz, slop32)
    first = maximum(zero, (t_min * scale - entry) * (1.0 - 2.0**-21) - slack)
    last = (t_max * scale - entry) * s.UP + slack
    f_min, f_best = convert(_float32, first), convert(_float32, last)
    valid = valid & (last >= first)
    kx = select(on_z, _i64(0), select(on_y, _i64(2), _i64(1)))
    ky = select(on_z, _i64(1), select(on_y, _i64(0), _i64(2)))
    kz = select(on_z, _i64(2), select(on_y, _i64(1), _i64(0)))
    sheared_x = select(on_z, ox, select(on_y, oz, oy))
    sheared_y = select(on_z, oy, select(on_y, ox, oz))
    sheared_z = select(on_z, oz, select(on_y, oy, ox))
    _store_rows(states, s.SHEAR_X, shear_x, shear_y, shear_z, sheared_x)
    _store_rows(states, s.ORIGIN_Y, sheared_y, sheared_z, t_min, t_max)
    _store_rows(states, s.AXIS_X, kx, ky, kz, best)
    _store_rows(states, s.TIME_SCALE, scale, entry, slack, unit)
    word = select(valid, _i64(ROOT), _i64(END))
    _store_rows(states, s.NEAR_X, _near_row(neg_x, 0), _near_row(neg_y, 32), _near_row(neg_z, 64), word)
    _store_rows(states, s.R, rx, ry, rz, f_min)
    _store_rows(states, s.P_NEAR, near_x, near_y, near_z, f_best)
    _store_rows(states, s.P_FAR, far_x, far_y, far_z, f_best)
    coarse = convert(_float32, sheared_x), convert(_float32, sheared_y), convert(_float32, sheared_z)
    size = maximum(maximum(absolute(coarse[0]), absolute(coarse[1])), maximum(absolute(coarse[2]), _f32(reach)))
    error = select(size < _f32(_SQUARES), size * _f32(COARSE_ROUNDING) + _f32(COARSE_LEAST), _f32(_INF))
    _store_rows(states, s.COARSE_ORIGIN, coarse[0], coarse[1], coarse[2], error)
    sign = select(major < zero, one, -one)
    nearest = convert(_float32, t_min * absolute(major))
    _store_rows(
        states,
        s.COARSE_SHEAR,
        -convert(_float32, shear_x),
        -convert(_float32, shear_y),
        convert(_float32, sign),
        error * _f32(5.0),
    )
    skip32 = from_bits(convert(_int32, skip))
    thrice = select((size < _f32(_CUBES)) & (size > _f32(_LEAST_CUBES)), nearest * _f32(3.0), _f32(_INF))
    _store_rows(states, s.COARSE_ENTRY, -nearest, thrice, skip32, skip32)


@inline
def reach_of(base: int) -> Any:
    """Return the largest coordinate of a tree's triangles, a little more than it is."""
    reach = 0.0
    scale = load(_float64, base + 8 * FRAME_SCALE)
    for axis in range(3):
        half = load(_float64, base + 8 * (FRAME_HALF + axis))
        reach = max(reach, abs(load(_float64, base + 8 * (FRAME_CENTRE + axis))) + half / scale)
    return reach * (1.0 + 2.0**-20)


@inline
def coordinate(address: int, wide: int, k: int) -> Any:
    """Load coordinate k of a row of three float64 (``wide``) or float32."""
    return load(_float64, address + 8 * k) if wide != 0 else _float64(load(_float32, address + 4 * k))


@inline
def four_limits(t_min: int, step_min: int, t_max: int, step_max: int) -> Any:
    """Return (tmin, tmax) of four rays, float64x4, from two addresses and the bytes from one ray's to the next."""
    nearest = load(float64x4, t_min) if step_min != 0 else _f64(load(_float64, t_min))
    farthest = load(float64x4, t_max) if step_max != 0 else _f64(load(_float64, t_max))
    return nearest, farthest


@inline
def start_rays(states: int, base: int, reach: float, rays: Any, i: int, count: int, listed: int, scratch: int) -> None:
    """Start rays i .. i + count, 1 to 4 of them; behind the last come rays that meet nothing.

    Parameters
    ----------
    states, base, reach
        As for `start_four`: always four states.
    rays
        Tuple of int64: addresses of origins and directions, each followed by whether they are float64 (else float32),
        and addresses of tmin and tmax (float64), each followed by the bytes from one ray's to the next (8, or 0 where
        one serves all). Numbers, not arrays: one kernel serves every type.
    listed
        Address of int64, the rays' numbers, of which i .. i + count are meant; 0: the numbers are i .. i + count.
    scratch
        Address of `SCRATCH_BYTES` for the last few rays, and for listed ones: nothing is read beyond the arrays' ends.
    """
    origins, wide_o, directions, wide_d, t_min, step_min, t_max, step_max = rays
    o, d = origins + i * (12 << wide_o), directions + i * (12 << wide_d)
    first, last = t_min + step_min * i, t_max + step_max * i
    if count < LANES or listed != 0:
        for k in range(0, SCRATCH_BYTES, 32):
            store(scratch + k, _f64(0.0))
        for k in range(count):
            number = load(_int64, listed + 8 * (i + k)) if listed != 0 else i + k
            for axis in range(3):
                value = coordinate(origins + number * (12 << wide_o), wide_o, axis)
                store(scratch + 24 * k + 8 * axis, value)
                value = coordinate(directions + number * (12 << wide_d), wide_d, axis)
                store(scratch + 96 + 24 * k + 8 * axis, value)
            store(scratch + 192 + 8 * k, load(_float64, t_min + step_min * number))
            store(scratch + 224 + 8 * k, load(_float64, t_max + step_max * number))
        o, wide_o, d, wide_d = scratch, _int64(1), scratch + 96, _int64(1)
        first, step_min, last, step_max = scratch + 192, _int64(8), scratch + 224, _int64(8)
    nearest, farthest = four_limits(first, step_min, last, step_max)
    start_four(states, base, reach, o, wide_o, d, wide_d, nearest, farthest)
