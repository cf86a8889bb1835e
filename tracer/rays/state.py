"""A ray ready for traversal: 256 bytes of memory that node tests and leaf tests read by address.

Float64 state lives in memory and is reloaded by broadcast: sixteen registers do not hold it beside a leaf's lanes.

The node test is `near <= far` in float32, conservatively, in the object's frame. With r = 1/d and p = -o r, a slab's
bounds are b r + p; near uses p - pad and far p + pad and is scaled up by `UP`, where pad = |p| 2**-21 + slop |r|:

* |p| 2**-21 covers the roundings of o, r and p to float32 (each at most 2**-24 relative, on |o r| and on |b r| <=
  |o r| + t; what falls on t is covered by UP);
* slop = 2**-48 (1 + R) + 2**-40, R the distance of the origin in frame units, covers what the leaf's predicate and
  the shift of the origin to the frame's box round in float64 (at most 9 eps R each, see :mod:`tracer.rays.predicate`).

Invariant: a node is skipped only if no triangle in it can be met at a distance that would change the answer.
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_CENTRE, FRAME_HALF, FRAME_SCALE, LARGEST, NODE_HIGH
from tracer.jit import inline
from tracer.rays.predicate import shear_of, unit_of
from tracer.simd import load, store
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

STATE_BYTES: Final = 256
SHEAR_X: Final = 0  # float64: Sx, Sy, Sz, and the origin in the order kx, ky, kz
SHEAR_Y: Final = 8
SHEAR_Z: Final = 16
ORIGIN_X: Final = 24
ORIGIN_Y: Final = 32
ORIGIN_Z: Final = 40
T_MIN: Final = 48  # float64, in units of UNIT_T
T_BEST: Final = 56  # tmax, then the nearest hit
AXIS_X: Final = 64  # int64: kx, ky, kz
AXIS_Y: Final = 72
AXIS_Z: Final = 80
BEST_ID: Final = 88  # int64: primitive, or -1; in count mode the number of crossings
BEST_LEAF: Final = 96  # int64: address of the hit's leaf
BEST_LANE: Final = 104  # int64: its lane << 8 | triangles in the leaf
TIME_SCALE: Final = 112  # float64: frame time = T * TIME_SCALE - TIME_ENTRY
TIME_ENTRY: Final = 120
TIME_SLACK: Final = 128
NEAR_X: Final = 136  # int64: byte offset of the near row of each axis
NEAR_Y: Final = 144
NEAR_Z: Final = 152
R: Final = 160  # float32: r of three axes, then p - pad, p + pad
P_NEAR: Final = 172
P_FAR: Final = 184
F_MIN: Final = 196  # float32: tmin and the nearest hit in frame time
F_BEST: Final = 200
RAY_INDEX: Final = 208  # int64: the ray's number, where many are in flight
NODE: Final = 216  # int64: the next child word
STACK_TOP: Final = 224  # int64: address
UNIT_T: Final = 232  # float64: T_MIN and T_BEST times this are t

UP: Final = 1.0 + 2.0**-21
_ROUNDING: Final = 2.0**-21
_LEAST_D: Final = 1e-18  # smaller direction components count as this: over the frame they move a ray by 4e-18
_WELL: Final = 2.0**-20  # frame time that a well-shaped triangle's t can be off: 6 * 2**-24, and room
_FINITE: Final = 1.7976931348623157e308


@inline
def _slab(origin: float, direction: float, slop: float) -> Any:
    """Return (r, p - pad, p + pad, whether the direction is negative) in float32."""
    o = _float32(origin)
    d = _float32(direction)
    d = _float32(_LEAST_D) if abs(d) < _float32(_LEAST_D) else d
    r = _float32(1.0) / d
    p = -o * r
    pad = abs(p) * _float32(_ROUNDING) + _float32(slop) * abs(r)
    return r, p - pad, p + pad, d < _float32(0.0)


@inline
def update_frame_best(state: int) -> None:
    """Recompute F_BEST from T_BEST, a little later than it is."""
    t = load(_float64, state + T_BEST) * load(_float64, state + TIME_SCALE) - load(_float64, state + TIME_ENTRY)
    store(state + F_BEST, _float32(t * UP + load(_float64, state + TIME_SLACK)))


@inline
def start_ray(
    state: int,
    base: int,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    t_min: float,
    t_max: float,
) -> bool:
    """Fill a state from a ray and the tree at address ``base``; False when the ray meets nothing, by definition or box.

    A ray is an open interval (max(tmin, 0), tmax) of o + t d. NaN anywhere, a zero or infinite direction, an origin
    beyond 1e100, or an empty interval: no ray, it meets nothing.
    """
    store(state + BEST_ID, _int64(-1))
    largest = max(abs(dx), abs(dy), abs(dz))
    t_min = max(0.0, t_min) if t_min == t_min else t_min  # noqa: PLR0124 - keeps a NaN
    valid = (
        abs(dx) < float("inf")
        and abs(dy) < float("inf")
        and abs(dz) < float("inf")
        and largest > 0.0
        and abs(ox) <= LARGEST
        and abs(oy) <= LARGEST
        and abs(oz) <= LARGEST
        and t_min < t_max
    )
    if not valid:
        return False
    frame = base
    if load(_float64, frame + 8 * FRAME_HALF) < 0.0:  # an empty tree
        return False
    scale = load(_float64, frame + 8 * FRAME_SCALE)
    unit = unit_of(dx, dy, dz)
    fx, fy, fz = dx * unit, dy * unit, dz * unit
    px = (ox - load(_float64, frame + 8 * FRAME_CENTRE)) * scale
    py = (oy - load(_float64, frame + 8 * FRAME_CENTRE + 8)) * scale
    pz = (oz - load(_float64, frame + 8 * FRAME_CENTRE + 16)) * scale
    distance = max(abs(px), abs(py), abs(pz))
    hx = load(_float64, frame + 8 * FRAME_HALF)
    hy = load(_float64, frame + 8 * FRAME_HALF + 8)
    hz = load(_float64, frame + 8 * FRAME_HALF + 16)
    entry = 0.0
    slop = 2.0**-48 * (1.0 + distance)
    # So far away that float64 does not resolve the object: visit every node, the predicate decides.
    blind = slop > 1.0
    if blind:
        px, py, pz, slop = 0.0, 0.0, 0.0, 4.0
    elif abs(px) > hx or abs(py) > hy or abs(pz) > hz:
        # outside: move the origin to the frame's box, so that float32 resolves what follows
        leave = float("inf")
        for axis in range(3):
            p, f, h = (px, fx, hx) if axis == 0 else ((py, fy, hy) if axis == 1 else (pz, fz, hz))
            inverse = 1.0 / (1e-200 if abs(f) < 1e-200 else f)
            a = (-h - slop - p) * inverse
            b = (h + slop - p) * inverse
            entry = max(entry, min(a, b))
            leave = min(leave, max(a, b))
        if entry * (1.0 - 2.0**-40) > leave * (1.0 + 2.0**-40):
            return False
        px, py, pz = px + entry * fx, py + entry * fy, pz + entry * fz
    slop += 2.0**-40
    rx, near_x, far_x, neg_x = _slab(px, fx, slop)
    ry, near_y, far_y, neg_y = _slab(py, fy, slop)
    rz, near_z, far_z, neg_z = _slab(pz, fz, slop)
    store(state + R, rx)
    store(state + R + 4, ry)
    store(state + R + 8, rz)
    store(state + P_NEAR, near_x)
    store(state + P_NEAR + 4, near_y)
    store(state + P_NEAR + 8, near_z)
    store(state + P_FAR, far_x)
    store(state + P_FAR + 4, far_y)
    store(state + P_FAR + 8, far_z)
    store(state + NEAR_X, _int64(NODE_HIGH if neg_x else 0))
    store(state + NEAR_Y, _int64(NODE_HIGH if neg_y else 0) + 32)
    store(state + NEAR_Z, _int64(NODE_HIGH if neg_z else 0) + 64)
    slack = _WELL + distance * 2.0**-46
    if blind:  # frame times mean nothing either: 0 .. 1e30 for good
        scale, entry, slack = 0.0, 0.0, 1e30
    store(state + TIME_SCALE, scale)
    store(state + TIME_ENTRY, entry)
    store(state + TIME_SLACK, slack)
    t_min /= unit
    store(state + T_MIN, t_min)
    store(state + T_BEST, min(t_max, _FINITE) / unit)  # a t beyond float64 is no hit
    store(state + UNIT_T, unit)
    store(state + F_MIN, _float32(max(0.0, (t_min * scale - entry) * (1.0 - 2.0**-21) - slack)))
    update_frame_best(state)
    kx, ky, kz, shear_x, shear_y, shear_z = shear_of(fx, fy, fz)
    store(state + SHEAR_X, shear_x)
    store(state + SHEAR_Y, shear_y)
    store(state + SHEAR_Z, shear_z)
    store(state + AXIS_X, _int64(kx))
    store(state + AXIS_Y, _int64(ky))
    store(state + AXIS_Z, _int64(kz))
    store(state + ORIGIN_X, ox if kx == 0 else (oy if kx == 1 else oz))
    store(state + ORIGIN_Y, ox if ky == 0 else (oy if ky == 1 else oz))
    store(state + ORIGIN_Z, ox if kz == 0 else (oy if kz == 1 else oz))
    return bool(load(_float32, state + F_BEST) >= load(_float32, state + F_MIN))
