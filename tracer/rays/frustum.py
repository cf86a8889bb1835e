"""Which part of a picture cannot see the scene's bounds.

The camera rays of a rectangle of the picture lie between four planes. Where all of a box is outside one of them by more
than the rounding errors of the planes and of the rays, no ray of the rectangle meets it.
"""

from typing import Any, Final

from tracer.geometry.rounding import gamma
from tracer.geometry.vector import add, at, cross, dot, subtract
from tracer.jit import inline, kernel
from tracer.rays.camera import Ray, camera_ray
from tracer.types import (
    CAMERA_BOTTOM,
    CAMERA_DISTANCE,
    CAMERA_LEFT,
    CAMERA_RIGHT,
    CAMERA_TOP,
    CAMERA_U,
    CAMERA_V,
    CAMERA_W,
    Vec3,
)

_GAMMA_64: Final = gamma(64)


@inline
def _size(a: Vec3) -> float:
    """Largest absolute coordinate."""
    return max(abs(a.x), abs(a.y), abs(a.z))


@inline
def _between(p: Ray, q: Ray) -> Vec3:
    """Vector between the points at t = 1 of two rays; exact zero parts stay exact."""
    return add(subtract(q.origin, p.origin), subtract(q.direction, p.direction))


@inline
def _is_outside(root: Any, o: Vec3, n: Vec3, margin: float) -> bool:
    """Tell whether every corner of a box has n . (corner - o) below -margin."""
    x = max(n.x * (root[0] - o.x), n.x * (root[3] - o.x))
    y = max(n.y * (root[1] - o.y), n.y * (root[4] - o.y))
    z = max(n.z * (root[2] - o.z), n.z * (root[5] - o.z))
    return bool(x + y + z < -margin)


@kernel
def misses_bounds(
    camera: Any, kind: int, x0: float, y0: float, x1: float, y1: float, width: int, height: int, root: Any
) -> bool:
    """Tell whether no camera ray through the rectangle can meet the box ``root`` (flat: lower, upper corner).

    Parameters
    ----------
    camera, kind, width, height
        As for :func:`tracer.rays.camera.camera_ray`.
    x0, y0, x1, y1 : float
        Rectangle in pixels from the top left, x0 < x1 and y0 < y1.
    root : flat float64
        Lower, then upper corner, world; an empty box is always missed.
    """
    if not root[0] <= root[3]:
        return True
    # The terms that directions (and origins) are summed from: they may cancel, their rounding errors do not.
    terms = (
        camera[CAMERA_DISTANCE] * _size(at(camera, CAMERA_W))
        + max(abs(camera[CAMERA_LEFT]), abs(camera[CAMERA_RIGHT])) * _size(at(camera, CAMERA_U))
        + max(abs(camera[CAMERA_BOTTOM]), abs(camera[CAMERA_TOP])) * _size(at(camera, CAMERA_V))
    )
    for side in range(4):
        # Go round the corners: the plane holds the rays at p and q, and those at r are on its inner side.
        px = x0 if side == 0 or side == 3 else x1  # noqa: PLR1714 - a set is slow to compile
        py = y0 if side <= 1 else y1
        qx = x1 if side <= 1 else x0
        qy = y0 if side == 0 or side == 3 else y1  # noqa: PLR1714
        p = camera_ray(camera, kind, px, py, width, height)
        q = camera_ray(camera, kind, qx, qy, width, height)
        r = camera_ray(camera, kind, x0 + x1 - px, y0 + y1 - py, width, height)
        n = cross(p.direction, _between(p, q))
        inner = dot(n, _between(p, r))
        if inner < 0.0:
            n = Vec3(-n.x, -n.y, -n.z)
        reach = max(
            _size(Vec3(root[0] - p.origin.x, root[1] - p.origin.y, root[2] - p.origin.z)),
            _size(Vec3(root[3] - p.origin.x, root[4] - p.origin.y, root[5] - p.origin.z)),
        )
        least = min(_size(p.direction), _size(q.direction))
        if least > 0.0 and inner != 0.0:
            # A ray strays from its plane by gamma(16) of the terms over its length, times the distance; so does the
            # plane.
            n_size = abs(n.x) + abs(n.y) + abs(n.z)
            margin = _GAMMA_64 * n_size * (reach * (1.0 + terms / least) + _size(p.origin) + terms)
            if _is_outside(root, p.origin, n, margin):
                return True
    return False
