"""Between which lines a tile's rays travel: all of them, and each four that lie side by side.

All is in frame units and float32. The *depth* counts along the dominant axis in the sense of travel; rays are lines
x(depth), y(depth) with slopes of at most 1 in size. The least of several lines is concave and the greatest convex, so
the chords between depths -half and half bound them (see :mod:`tracer.rays.packet`).

Rounding: with M the greatest |x|, |y| at the two depths, a line's value off by less than 12 * 2**-24 M: 1 for each of
its two ends, 2 for their mean, 3 for the slope's product, 2 for the sum. `pad_of` leaves room for 16, and for what
float64 and the predicate round of coordinates so far out (`slop`).
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import LANES, NIBBLE, ORIGIN, ROW, SHEAR, SPEED, STEP, T_BEST, VECTOR, VECTORS, mask_of
from tracer.simd import (
    absolute,
    convert,
    count_trailing_zeros,
    float32x8,
    load,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
    splat,
    store,
    transpose,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int64: Final = types.int64
_INF: Final = float("inf")

LINE: Final = 4 * VECTORS  # bytes: one float32 for each four rays
# `survey_tile` leaves the extremes of x and y there, at depth -half and half, `draw_lines` makes lines of them
X_LOW: Final = 0  # start, then slope: x >= start + slope depth
X_HIGH: Final = 2 * LINE
Y_LOW: Final = 4 * LINE
Y_HIGH: Final = 6 * LINE
ENDS: Final = 8 * LINE  # greatest depth at which one of the four can still find something
BEGINS: Final = 9 * LINE  # least depth of an origin
BEAM_BYTES: Final = 10 * LINE
LATE: Final = 2.0**-18  # depth, and room, by which a hit's t and its float32 can be off
_FARTHEST: Final = 64.0  # origin, frame units: beyond, float32 lines are too coarse
_COARSEST: Final = 2.0**-16  # slop
_SCALES: Final = 1e15  # float32 leaves are brought into the frame in float32 within these


@inline
def _spread64(address: int) -> Any:
    return splat(VECTOR, load(_float64, address))


@inline
def _crossings(at: int, mask: Any, some: int, axes: Any, frame: Any, half: float) -> Any:
    """Return x and y at both depths, the depths of end and origin: float32x4; greatest coordinate of the origin.

    Lanes outside the mask count as the ray at ``some``.
    """
    kx, ky, kz = axes
    cx, cy, cz, scale, sign = frame
    s, sense = splat(VECTOR, scale), splat(VECTOR, sign)
    x = select(mask, load(VECTOR, at + ORIGIN + kx * ROW), _spread64(some + ORIGIN + kx * ROW))
    y = select(mask, load(VECTOR, at + ORIGIN + ky * ROW), _spread64(some + ORIGIN + ky * ROW))
    z = select(mask, load(VECTOR, at + ORIGIN + kz * ROW), _spread64(some + ORIGIN + kz * ROW))
    slope_x = select(mask, load(VECTOR, at + SHEAR), _spread64(some + SHEAR)) * sense
    slope_y = select(mask, load(VECTOR, at + SHEAR + ROW), _spread64(some + SHEAR + ROW)) * sense
    x, y, z = (x - splat(VECTOR, cx)) * s, (y - splat(VECTOR, cy)) * s, (z - splat(VECTOR, cz)) * s
    reach = maximum(absolute(x), maximum(absolute(y), absolute(z)))
    z = z * sense
    end = select(mask, z + load(VECTOR, at + T_BEST) * load(VECTOR, at + SPEED) * s, splat(VECTOR, -_INF))
    back = splat(VECTOR, -half) - z
    x, y = x + slope_x * back, y + slope_y * back
    across = splat(VECTOR, 2.0 * half)
    far_x, far_y = x + slope_x * across, y + slope_y * across
    return (
        convert(_float32, x),
        convert(_float32, far_x),
        convert(_float32, y),
        convert(_float32, far_y),
        convert(_float32, end),
        convert(_float32, z),
        reach,
    )


@inline
def _put_extremes(low: int, high: int, a: Any, b: Any, c: Any, d: Any) -> None:
    """Store the least and the greatest lane of each of four vectors."""
    a, b, c, d = transpose(a, b, c, d)
    store(low, minimum(minimum(a, b), minimum(c, d)))
    store(high, maximum(maximum(a, b), maximum(c, d)))


@inline
def survey_tile(tile: int, active: int, axes: Any, frame: Any, half: float, beam: int) -> Any:
    """Find the extremes of the active rays, four by four.

    Parameters
    ----------
    tile, active
        The rays, of one axis and sense; not none.
    axes, frame
        (kx, ky, kz); (centre of the frame in this order, scale, sense as 1 or -1).
    half
        Depth, either way, at which x and y are looked at.
    beam
        Address of BEAM_BYTES.

    Returns
    -------
    float64
        Greatest coordinate of an origin.
    """
    reach = splat(VECTOR, 0.0)
    some = tile + 8 * count_trailing_zeros(active)
    for j in range(0, VECTORS, 4):
        at = tile + STEP * j
        x0, fx0, y0, fy0, e0, z0, r0 = _crossings(at, mask_of(active, j), some, axes, frame, half)
        x1, fx1, y1, fy1, e1, z1, r1 = _crossings(at + STEP, mask_of(active, j + 1), some, axes, frame, half)
        x2, fx2, y2, fy2, e2, z2, r2 = _crossings(at + 2 * STEP, mask_of(active, j + 2), some, axes, frame, half)
        x3, fx3, y3, fy3, e3, z3, r3 = _crossings(at + 3 * STEP, mask_of(active, j + 3), some, axes, frame, half)
        row = beam + 4 * j
        _put_extremes(row + X_LOW, row + X_HIGH, x0, x1, x2, x3)
        _put_extremes(row + X_LOW + LINE, row + X_HIGH + LINE, fx0, fx1, fx2, fx3)
        _put_extremes(row + Y_LOW, row + Y_HIGH, y0, y1, y2, y3)
        _put_extremes(row + Y_LOW + LINE, row + Y_HIGH + LINE, fy0, fy1, fy2, fy3)
        e0, e1, e2, e3 = transpose(e0, e1, e2, e3)
        store(row + ENDS, maximum(maximum(e0, e1), maximum(e2, e3)))
        z0, z1, z2, z3 = transpose(z0, z1, z2, z3)
        store(row + BEGINS, minimum(minimum(z0, z1), minimum(z2, z3)))
        reach = maximum(reach, maximum(maximum(r0, r1), maximum(r2, r3)))
    return reduce_max(reach)


@inline
def slop_of(reach: float, centre: float) -> float:
    """Return what float64 does not resolve of coordinates so far out, in frame units."""
    return 2.0**-46 * (1.0 + reach + centre)


@inline
def is_resolved(reach: float, slop: float, size: int, scale: float) -> bool:
    """Tell whether lines and boxes in float32 are fine enough for a tree's scale and bytes of a coordinate."""
    return bool(reach <= _FARTHEST and slop <= _COARSEST and (size == 8 or 1.0 / _SCALES < scale < _SCALES))


@inline
def leaf_pad(centre: float) -> float:
    """Return what a leaf's coordinates lose on their way into the frame."""
    return 2.0**-22 * (2.0 + centre)


@inline
def pad_of(reach: float, half: float, slop: float) -> float:
    """Room for rounding beside a line, for origins of at most this coordinate."""
    return 2.0**-20 * (2.0 * reach + half) + 8.0 * slop


@inline
def least_of(row: int) -> Any:
    """Return the least of a row's values."""
    return reduce_min(minimum(load(float32x8, row), load(float32x8, row + 32)))


@inline
def greatest_of(row: int) -> Any:
    """Return the greatest of a row's values."""
    return reduce_max(maximum(load(float32x8, row), load(float32x8, row + 32)))


@inline
def whole_line(near: float, far: float, half: float) -> Any:
    """Return (start, slope) of the line through two values."""
    return _float32(0.5) * (near + far), (far - near) * _float32(0.5 / half)


@inline
def draw_lines(beam: int, half: float, pad: float, room: float) -> None:
    """Turn the extremes of each four rays into lines, ``pad`` farther out and set begins and ends ``room`` apart."""
    middle, inverse = splat(float32x8, _float32(0.5)), splat(float32x8, _float32(0.5 / half))
    for row in range(X_LOW, ENDS, 2 * LINE):
        side = -pad if row % (4 * LINE) == 0 else pad  # lower lines, then upper ones
        aside = splat(float32x8, _float32(side))
        for at in range(row, row + LINE, 32):
            near, far = load(float32x8, beam + at), load(float32x8, beam + at + LINE)
            store(beam + at, (near + far) * middle + aside)
            store(beam + at + LINE, (far - near) * inverse)
    apart = splat(float32x8, _float32(room))
    for at in range(0, LINE, 32):
        store(beam + ENDS + at, load(float32x8, beam + ENDS + at) + apart)
        store(beam + BEGINS + at, load(float32x8, beam + BEGINS + at) - apart)


@inline
def groups_of(active: int) -> Any:
    """Return which vectors have an active ray, bit by bit."""
    groups = _int64(0)
    for i in range(VECTORS):
        groups |= _int64((active >> (LANES * i)) & NIBBLE != 0) << i
    return groups


@inline
def deepest_of(ray: int, mask: Any, oz: Any, t_best: Any, frame: Any) -> Any:
    """Return the greatest depth at which one of a vector's rays, those of the mask, can still find something.

    Parameters
    ----------
    ray
        Address of the vector's first ray.
    mask
        Mask of four.
    oz, t_best
        float64x4: the origins' coordinate along the axis, and the rays' ends.
    frame
        As for `survey_tile`.
    """
    _cx, _cy, cz, scale, sign = frame
    end = (oz - splat(VECTOR, cz)) * splat(VECTOR, scale * sign)
    end = end + t_best * load(VECTOR, ray + SPEED) * splat(VECTOR, scale)
    return reduce_max(convert(_float32, select(mask, end, splat(VECTOR, -_INF))))
