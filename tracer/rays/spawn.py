"""Origins of rays that leave a surface, four at a time.

The origin is moved along the geometric normal, to the side on which the new ray goes, by the bound on the hit
point's error and one representable number further: as little as keeps the ray from meeting the surface it left, at
any scale.

Source: Pharr et al., "Physically Based Rendering" 6.8.6.
"""

from typing import Any, Final

from tracer.geometry.rounding import EPSILON, SMALLEST
from tracer.geometry.vector import dot
from tracer.jit import inline
from tracer.rays.rows import VECTOR
from tracer.simd import absolute, select, splat
from tracer.types import Vec3

_SUCCESSOR: Final = EPSILON * (1.0 + 2.0 * EPSILON)


@inline
def away(value: Any, towards: Any) -> Any:
    """Next float64 after ``value`` in the direction of the sign of ``towards`` (or the one after it; Rump 2009).

    A zero ``towards`` leaves the value as it is.
    """
    zero = splat(VECTOR, 0.0)
    step = absolute(value) * splat(VECTOR, _SUCCESSOR) + splat(VECTOR, SMALLEST)
    step = select(towards < zero, -step, step)
    return select(towards == zero, value, value + step)


@inline
def offset_origin(position: Any, error: Any, normal: Any, direction: Any) -> Any:
    """Origins of rays from ``position`` along ``direction``.

    Parameters
    ----------
    position, error
        Hit points, and the bounds on each coordinate's error.
    normal
        Geometric normals, unit, either side.
    direction
        Of the new rays, any length.

    Returns
    -------
    Vec3
        As the parameters: of float64x4.
    """
    distance = absolute(normal.x) * error.x + absolute(normal.y) * error.y + absolute(normal.z) * error.z
    distance = select(dot(direction, normal) < splat(VECTOR, 0.0), -distance, distance)
    x, y, z = distance * normal.x, distance * normal.y, distance * normal.z
    return Vec3(away(position.x + x, x), away(position.y + y, y), away(position.z + z, z))
