"""A ray in flight: a block of memory that node tests and leaf tests read by address.

Float64 state lives in memory and is reloaded by broadcast: sixteen registers do not hold it beside a leaf's lanes.

The node test is `near <= far` in float32, conservatively, in the object's frame. With r = 1/d and p = -o r, a slab's
bounds are b r + p; near uses p - pad and far p + pad, where pad = |p| 2**-21 + slop |r| + 2**-18:

* |p| 2**-21 covers the roundings of o, r and p to float32 (each at most 2**-24 relative, on |o r| and on |b r| <=
  |o r| + t);
* 2**-18 covers what falls on t, at most 2**-22 t: a ray leaves the frame's box before t = 2 (1 + slop), as the largest
  component of its direction is at least 1, and of later times only that they are later counts;
* slop = 2**-48 (1 + R) + 2**-40, R the distance of the origin in frame units, covers what the leaf's predicate and
  the shift of the origin to the frame's box round in float64 (at most 9 eps R each, see :mod:`tracer.rays.predicate`).

The fields stand in rows of 32 bytes (16 for float32), so that :mod:`tracer.rays.start` fills four rays at once by
transposing four vectors of lanes.

Invariant: a node is skipped only if no triangle in it can be met at a distance that would change the answer.
"""

from typing import Final

from tracer.jit import inline
from tracer.simd import load, store
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64

STATE_BYTES: Final = 320
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
BEST_ID: Final = 88  # int64: primitive, or -1; COUNT: crossings less 1; 0 for ANY and SHADE where the ray has ended
TIME_SCALE: Final = 96  # float64: frame time = T * TIME_SCALE - TIME_ENTRY
TIME_ENTRY: Final = 104
TIME_SLACK: Final = 112
UNIT_T: Final = 120  # float64: T_MIN and T_BEST times this are t
NEAR_X: Final = 128  # int64: byte offset of the near row of each axis
NEAR_Y: Final = 136
NEAR_Z: Final = 144
NODE: Final = 152  # int64: the next child word
R: Final = 160  # float32: r of three axes
F_MIN: Final = 172  # float32: tmin in frame time
P_NEAR: Final = 176  # float32: p - pad of three axes
F_BEST: Final = 188  # float32: the nearest hit in frame time
P_FAR: Final = 192  # float32: p + pad of three axes
WEIGHTS: Final = 208  # float64: U, V, W of the nearest hit, over their sum
BEST_ORDER: Final = 232  # int64: the number of the order that its vertices are sorted into
STACK: Final = 240  # int64: address of the stack, and of its next free entry; set by the traversal
STACK_TOP: Final = 248
RAY_INDEX: Final = 256  # int64: the ray's number, where many are in flight
CANDIDATES: Final = 264  # int64: bits of the leaf's triangles that may be met
COARSE_ORIGIN: Final = 272  # float32: the origin in the order kx, ky, kz
COARSE_ERROR: Final = 284  # float32: what a coarse x or y can be off
COARSE_SHEAR: Final = 288  # float32: -Sx, -Sy
COARSE_SIGN: Final = 296  # float32: 1 where d.kz is negative, else -1
COARSE_ERROR_5: Final = 300  # float32: 5 times COARSE_ERROR
COARSE_ENTRY: Final = 304  # float32: minus T_MIN |d.kz|, tmin on the axis kz; and 3 times T_MIN |d.kz|
COARSE_ENTRY_3: Final = 308
SKIP: Final = 312  # int32: a primitive that the ray cannot meet, or -1

NEAR_AND_FAR: Final = (96, 160, 224)  # near row + far row of each axis

UP: Final = 1.0 + 2.0**-21


@inline
def update_frame_best(state: int) -> None:
    """Recompute F_BEST from T_BEST, a little later than it is."""
    t = load(_float64, state + T_BEST) * load(_float64, state + TIME_SCALE) - load(_float64, state + TIME_ENTRY)
    store(state + F_BEST, _float32(t * UP + load(_float64, state + TIME_SLACK)))
