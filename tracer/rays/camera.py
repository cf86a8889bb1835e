"""Camera rays through the view plane.

Source: [farmer2019 eq. 1, 2].
"""

from typing import Any, NamedTuple

from tracer.geometry.vector import at, normalize
from tracer.jit import inline
from tracer.types import (
    CAMERA_BOTTOM,
    CAMERA_DISTANCE,
    CAMERA_EYE,
    CAMERA_LEFT,
    CAMERA_ORTHOGRAPHIC,
    CAMERA_RIGHT,
    CAMERA_TOP,
    CAMERA_U,
    CAMERA_V,
    CAMERA_W,
    Vec3,
)


class Ray(NamedTuple):
    """Origin and direction, p = e + t d [farmer2019 eq. 2]."""

    origin: Vec3
    direction: Vec3


@inline
def view_plane(camera: Any, x: float, y: float, width: int, height: int) -> tuple[float, float]:
    """Position on the view plane of a picture position in pixels from the top left [farmer2019 eq. 1]."""
    left = camera[CAMERA_LEFT]
    bottom = camera[CAMERA_BOTTOM]
    u = left + (camera[CAMERA_RIGHT] - left) * (x * (1.0 / width))
    v = bottom + (camera[CAMERA_TOP] - bottom) * ((height - y) * (1.0 / height))
    return u, v


@inline
def camera_ray(camera: Any, kind: int, x: float, y: float, width: int, height: int) -> Ray:
    """Ray through a picture position, with the direction as eq. 1 gives it (not unit).

    Parameters
    ----------
    camera : flat float64, CAMERA_*
    kind : CAMERA_VIEW_PLANE or CAMERA_ORTHOGRAPHIC
    x, y : pixels from the top left corner of the full image
    width, height : pixels of the full image
    """
    u, v = view_plane(camera, x, y, width, height)
    e = at(camera, CAMERA_EYE)
    cu = at(camera, CAMERA_U)
    cv = at(camera, CAMERA_V)
    cw = at(camera, CAMERA_W)
    if kind == CAMERA_ORTHOGRAPHIC:
        return Ray(
            Vec3(e.x + u * cu.x + v * cv.x, e.y + u * cu.y + v * cv.y, e.z + u * cu.z + v * cv.z),
            Vec3(-cw.x, -cw.y, -cw.z),
        )
    d = camera[CAMERA_DISTANCE]
    return Ray(
        e,
        Vec3(-d * cw.x + u * cu.x + v * cv.x, -d * cw.y + u * cu.y + v * cv.y, -d * cw.z + u * cu.z + v * cv.z),
    )


@inline
def unit_ray(ray: Ray) -> Ray:
    """Return the same ray with a unit direction: t counts in world units."""
    return Ray(ray.origin, normalize(ray.direction))
