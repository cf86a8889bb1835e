"""Origins of rays that leave a surface.

The origin is moved along the geometric normal, to the side on which the new ray goes, by the bound on the hit
point's error and one representable number further: as little as keeps the ray from meeting the surface it left, at
any scale.

Source: Pharr et al., "Physically Based Rendering" 6.8.6.
"""

from typing import Final

from tracer.geometry.rounding import EPSILON, SMALLEST
from tracer.jit import inline
from tracer.types import Vec3

_SUCCESSOR: Final = EPSILON * (1.0 + 2.0 * EPSILON)


@inline
def away(value: float, towards: float) -> float:
    """Next float64 after ``value`` in the direction of the sign of ``towards`` (or the one after it; Rump 2009).

    A zero ``towards`` leaves the value as it is.
    """
    step = abs(value) * _SUCCESSOR + SMALLEST
    if towards > 0.0:
        return value + step
    if towards < 0.0:
        return value - step
    return value


@inline
def offset_origin(position: Vec3, error: Vec3, normal: Vec3, direction: Vec3) -> Vec3:
    """Origin of a ray from ``position`` along ``direction``.

    Parameters
    ----------
    position, error : hit point and the bound on each coordinate's error
    normal : geometric normal, unit, either side
    direction : of the new ray, any length
    """
    distance = abs(normal.x) * error.x + abs(normal.y) * error.y + abs(normal.z) * error.z
    if direction.x * normal.x + direction.y * normal.y + direction.z * normal.z < 0.0:
        distance = -distance
    x = distance * normal.x
    y = distance * normal.y
    z = distance * normal.z
    return Vec3(away(position.x + x, x), away(position.y + y, y), away(position.z + z, z))
