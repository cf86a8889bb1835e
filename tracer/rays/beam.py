"""The hull of a packet's rays: between which lines they travel, where they begin and end.

Depths count along the dominant axis in the sense of travel; all is in frame units (:mod:`tracer.accel.layout`).
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import (
    LANES,
    NIBBLE,
    ORIGIN,
    ROW,
    SHEAR,
    SPEED,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    mask_of,
)
from tracer.simd import (
    absolute,
    count_trailing_zeros,
    load,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
    splat,
    store,
)
from tracer.simd.gateway import types

_float64: Final = types.float64
_INF: Final = float("inf")

# Offsets of float64: what a beam is to a leaf; they lie in memory from the beam's address on
BEAM_CENTRE: Final = 0  # of the frame, in the order kx, ky, kz
BEAM_SCALE: Final = 24
BEAM_SIGN: Final = 32
BEAM_HALF: Final = 40  # the lines hold for depths of at most this size
BEAM_FIRST: Final = 48  # depths between which something can be found
BEAM_LAST: Final = 56
BEAM_SURE_FIRST: Final = 64  # depths between which all rays are on their way
BEAM_SURE_LAST: Final = 72
BEAM_X_SLOPE: Final = 80  # middle line x = slope depth + start, half width = spread depth + width
BEAM_X_START: Final = 88
BEAM_X_SPREAD: Final = 96
BEAM_X_WIDTH: Final = 104
BEAM_Y_SLOPE: Final = 112
BEAM_Y_START: Final = 120
BEAM_Y_SPREAD: Final = 128
BEAM_Y_WIDTH: Final = 136
BEAM_BYTES: Final = 144
# What `survey` leaves behind it, in frame units
BEGIN: Final = BEAM_BYTES  # depths: where the first ray begins, where the last
LAST_BEGIN: Final = BEGIN + 8
LAST_END: Final = BEGIN + 16  # where the last ray ends, where the first
FIRST_END: Final = BEGIN + 24
REACH: Final = BEGIN + 32  # greatest coordinate of an origin
EXTREMES_X: Final = BEGIN + 40  # least and greatest x at depth -half, then at half
EXTREMES_Y: Final = BEGIN + 72
BEAM_MEMORY: Final = BEGIN + 104
_FAR: Final = 1024.0  # frame units: a point beyond would cost the beam too much accuracy
LATE: Final = 2.0**-20  # depth, and room, by which a hit's t can be off


@inline
def _spread64(address: int) -> Any:
    return splat(VECTOR, load(_float64, address))


@inline
def survey(packet: int, active: int, axes: Any, frame: Any, half: float, beam: int) -> None:
    """Bound the active rays: see the offsets `EXTREMES_X` and so on, from ``beam``."""
    kx, ky, kz = axes
    cx, cy, cz, scale, sign = frame
    infinite = splat(VECTOR, _INF)
    begin, last_begin, end, first_end = infinite, -infinite, -infinite, infinite
    low_x, high_x, far_low_x, far_high_x = infinite, -infinite, infinite, -infinite
    low_y, high_y, far_low_y, far_high_y = infinite, -infinite, infinite, -infinite
    reach = splat(VECTOR, 0.0)
    middle_x, middle_y, middle_z = splat(VECTOR, cx), splat(VECTOR, cy), splat(VECTOR, cz)
    s, sense, nearest = splat(VECTOR, scale), splat(VECTOR, sign), splat(VECTOR, -half)
    across = splat(VECTOR, 2.0 * half)
    some = packet + 8 * count_trailing_zeros(active)  # what lanes that are not active count as
    for i in range(VECTORS):
        bits = (active >> (LANES * i)) & NIBBLE
        if bits == 0:
            continue
        at = packet + STEP * i
        x, y = load(VECTOR, at + ORIGIN + kx * ROW), load(VECTOR, at + ORIGIN + ky * ROW)
        z = load(VECTOR, at + ORIGIN + kz * ROW)
        slope_x, slope_y = load(VECTOR, at + SHEAR), load(VECTOR, at + SHEAR + ROW)
        way = load(VECTOR, at + T_BEST) * load(VECTOR, at + SPEED)
        if bits != NIBBLE:
            mask = mask_of(active, i)
            x = select(mask, x, _spread64(some + ORIGIN + kx * ROW))
            y = select(mask, y, _spread64(some + ORIGIN + ky * ROW))
            z = select(mask, z, _spread64(some + ORIGIN + kz * ROW))
            slope_x = select(mask, slope_x, _spread64(some + SHEAR))
            slope_y = select(mask, slope_y, _spread64(some + SHEAR + ROW))
            way = select(mask, way, _spread64(some + T_BEST) * _spread64(some + SPEED))
        x, y, z = (x - middle_x) * s, (y - middle_y) * s, (z - middle_z) * s
        reach = maximum(reach, maximum(absolute(x), maximum(absolute(y), absolute(z))))
        z = z * sense
        begin, last_begin = minimum(begin, z), maximum(last_begin, z)
        stop = z + way * s
        end, first_end = maximum(end, stop), minimum(first_end, stop)
        back = nearest - z
        slope_x, slope_y = slope_x * sense, slope_y * sense
        x, y = x + slope_x * back, y + slope_y * back
        low_x, high_x, low_y, high_y = minimum(low_x, x), maximum(high_x, x), minimum(low_y, y), maximum(high_y, y)
        x, y = x + slope_x * across, y + slope_y * across
        far_low_x, far_high_x = minimum(far_low_x, x), maximum(far_high_x, x)
        far_low_y, far_high_y = minimum(far_low_y, y), maximum(far_high_y, y)
    store(beam + BEGIN, reduce_min(begin))
    store(beam + LAST_BEGIN, reduce_max(last_begin))
    store(beam + LAST_END, reduce_max(end))
    store(beam + FIRST_END, reduce_min(first_end))
    store(beam + REACH, reduce_max(reach))
    store(beam + EXTREMES_X, reduce_min(low_x))
    store(beam + EXTREMES_X + 8, reduce_max(high_x))
    store(beam + EXTREMES_X + 16, reduce_min(far_low_x))
    store(beam + EXTREMES_X + 24, reduce_max(far_high_x))
    store(beam + EXTREMES_Y, reduce_min(low_y))
    store(beam + EXTREMES_Y + 8, reduce_max(high_y))
    store(beam + EXTREMES_Y + 16, reduce_min(far_low_y))
    store(beam + EXTREMES_Y + 24, reduce_max(far_high_y))


@inline
def _slopes(packet: int, active: int, kz: int, beam: int, with_depths: bool) -> None:
    """Store the active rays' least and greatest slopes in EXTREMES_X, EXTREMES_Y, and z of their origins in BEGIN."""
    infinite = splat(VECTOR, _INF)
    low_x, high_x, low_y, high_y, low_z, high_z = infinite, -infinite, infinite, -infinite, infinite, -infinite
    some = packet + 8 * count_trailing_zeros(active)  # what lanes that are not active count as
    for i in range(VECTORS):
        bits = (active >> (LANES * i)) & NIBBLE
        if bits == 0:
            continue
        at = packet + STEP * i
        x, y, z = load(VECTOR, at + SHEAR), load(VECTOR, at + SHEAR + ROW), load(VECTOR, at + ORIGIN + kz * ROW)
        if bits != NIBBLE:
            mask = mask_of(active, i)
            x, y = select(mask, x, _spread64(some + SHEAR)), select(mask, y, _spread64(some + SHEAR + ROW))
            z = select(mask, z, _spread64(some + ORIGIN + kz * ROW))
        low_x, high_x, low_y, high_y = minimum(low_x, x), maximum(high_x, x), minimum(low_y, y), maximum(high_y, y)
        if with_depths:
            low_z, high_z = minimum(low_z, z), maximum(high_z, z)
    store(beam + EXTREMES_X, reduce_min(low_x))
    store(beam + EXTREMES_X + 8, reduce_max(high_x))
    store(beam + EXTREMES_Y, reduce_min(low_y))
    store(beam + EXTREMES_Y + 8, reduce_max(high_y))
    if with_depths:
        store(beam + BEGIN, reduce_min(low_z))
        store(beam + LAST_BEGIN, reduce_max(high_z))


@inline
def _fan(extremes: int, at_point: float, depth: float, sign: float, half: float) -> None:
    """From the slopes of lines through a point to their extremes at the depths -half and half."""
    low, high = load(_float64, extremes) * sign, load(_float64, extremes + 8) * sign
    back = -half - depth
    a, b = at_point + low * back, at_point + high * back
    store(extremes, min(a, b))
    store(extremes + 8, max(a, b))
    a, b = a + low * (2.0 * half), b + high * (2.0 * half)
    store(extremes + 16, min(a, b))
    store(extremes + 24, max(a, b))


@inline
def survey_pencil(packet: int, active: int, axes: Any, frame: Any, half: float, beam: int, ending: bool) -> bool:
    """As `survey`, for endless rays from one point, or (``ending``) rays that end in one point; cheaper.

    Returns
    -------
    bool
        False when the point is so far away that this would be too coarse: nothing is known then.
    """
    kx, ky, kz = axes
    cx, cy, cz, scale, sign = frame
    ray = packet + 8 * count_trailing_zeros(active)
    x, y, z = (
        load(_float64, ray + ORIGIN + kx * ROW),
        load(_float64, ray + ORIGIN + ky * ROW),
        load(_float64, ray + ORIGIN + kz * ROW),
    )
    if ending:
        way = load(_float64, ray + T_BEST) * load(_float64, ray + SPEED) * sign
        x, y, z = x + load(_float64, ray + SHEAR) * way, y + load(_float64, ray + SHEAR + ROW) * way, z + way
    x, y, z = (x - cx) * scale, (y - cy) * scale, (z - cz) * scale
    reach = max(abs(x), abs(y), abs(z))
    if not reach < _FAR:
        return False
    _slopes(packet, active, kz, beam, ending)
    depth = z * sign
    if ending:
        a, b = (
            (load(_float64, beam + BEGIN) - cz) * scale * sign,
            (load(_float64, beam + LAST_BEGIN) - cz) * scale * sign,
        )
        store(beam + BEGIN, min(a, b))
        store(beam + LAST_BEGIN, max(a, b))
        store(beam + LAST_END, depth)
        store(beam + FIRST_END, depth)
        reach += max(abs(depth - a), abs(depth - b))  # slopes are at most 1
    else:
        store(beam + BEGIN, depth)
        store(beam + LAST_BEGIN, depth)
        store(beam + LAST_END, _INF)
        store(beam + FIRST_END, _INF)
    store(beam + REACH, reach)
    _fan(beam + EXTREMES_X, x, depth, sign, half)
    _fan(beam + EXTREMES_Y, y, depth, sign, half)
    return True


@inline
def chords(extremes: int, half: float, slop: float) -> Any:
    """Return (slope, start) of the lower and of the upper bounding line, padded for float64."""
    low_0, high_0 = load(_float64, extremes), load(_float64, extremes + 8)
    low_1, high_1 = load(_float64, extremes + 16), load(_float64, extremes + 24)
    inverse = 0.5 / half
    low_slope, high_slope = (low_1 - low_0) * inverse, (high_1 - high_0) * inverse
    pad = slop + 2.0**-46 * (abs(low_0) + abs(low_1) + abs(high_0) + abs(high_1))
    return low_slope, 0.5 * (low_0 + low_1) - pad, high_slope, 0.5 * (high_0 + high_1) + pad


@inline
def deepest_end(packet: int, active: int, kz: int, frame: Any) -> float:
    """Greatest depth at which an active ray can still find something, frame units."""
    _cx, _cy, cz, scale, sign = frame
    last = splat(VECTOR, -_INF)
    middle, s = splat(VECTOR, cz), splat(VECTOR, scale * sign)
    speed = splat(VECTOR, scale)
    for i in range(VECTORS):
        if (active >> (LANES * i)) & NIBBLE == 0:
            continue
        at = packet + STEP * i
        end = (load(VECTOR, at + ORIGIN + kz * ROW) - middle) * s
        end = end + load(VECTOR, at + T_BEST) * load(VECTOR, at + SPEED) * speed
        last = maximum(last, select(mask_of(active, i), end, last))
    return float(reduce_max(last))
