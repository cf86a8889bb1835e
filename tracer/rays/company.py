"""Rays that travel well together: of one dominant axis and sense, from near each other, with slopes alike."""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import AXIS, INTEGERS, LANES, ORIGIN, ROW, SHEAR, STEP, VECTOR, VECTORS
from tracer.simd import absolute, count_trailing_zeros, load, mask_to_bits, maximum, splat
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64


@inline
def companions(packet: int, lanes: int, near: float, alike: float) -> Any:
    """Return the rays of a set that go well with its first one.

    Parameters
    ----------
    packet, lanes
        Address of the rays (:mod:`tracer.rays.rows`); the set, not empty.
    near, alike
        How far apart origins, in world units, and slopes may be.
    """
    first = count_trailing_zeros(lanes)
    ray = packet + 8 * first
    axis = splat(INTEGERS, load(_int64, ray + AXIS))
    x, y = splat(VECTOR, load(_float64, ray + ORIGIN)), splat(VECTOR, load(_float64, ray + ORIGIN + ROW))
    z = splat(VECTOR, load(_float64, ray + ORIGIN + 2 * ROW))
    sx, sy = splat(VECTOR, load(_float64, ray + SHEAR)), splat(VECTOR, load(_float64, ray + SHEAR + ROW))
    chosen = _int64(0)
    reach, most = splat(VECTOR, near), splat(VECTOR, alike)
    for i in range(VECTORS):
        at = packet + STEP * i
        apart = maximum(absolute(load(VECTOR, at + ORIGIN) - x), absolute(load(VECTOR, at + ORIGIN + ROW) - y))
        apart = maximum(apart, absolute(load(VECTOR, at + ORIGIN + 2 * ROW) - z))
        turned = maximum(absolute(load(VECTOR, at + SHEAR) - sx), absolute(load(VECTOR, at + SHEAR + ROW) - sy))
        good = mask_to_bits((apart <= reach) & (turned <= most) & (load(INTEGERS, at + AXIS) == axis))
        chosen |= good << (LANES * i)
    return (chosen & lanes) | (_int64(1) << first)
