"""Camera rays four at a time: the equations of :mod:`tracer.rays.camera`, lane by lane."""

from typing import Any, Final

from tracer.geometry.vector import dot
from tracer.jit import inline, kernel
from tracer.rays.camera import camera_ray, unit_ray
from tracer.rays.rows import ROW, STEP, VECTOR
from tracer.simd import all_lanes, load, splat, sqrt, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_BOTTOM,
    CAMERA_DISTANCE,
    CAMERA_EYE,
    CAMERA_LEFT,
    CAMERA_RIGHT,
    CAMERA_TOP,
    CAMERA_U,
    CAMERA_V,
    CAMERA_VIEW_PLANE,
    CAMERA_W,
    Vec3,
)

_float64: Final = types.float64


@inline
def _axis(camera: Any, start: int, axis: int, u: Any, v: Any) -> Any:
    """One coordinate of ``start`` + u U + v V, summed as the scalar code does."""
    first = splat(VECTOR, start)
    return first + u * splat(VECTOR, camera[CAMERA_U + axis]) + v * splat(VECTOR, camera[CAMERA_V + axis])


@inline
def view_directions(camera: Any, width: int, height: int, x: Any, y: Any) -> Any:
    """Directions of perspective rays through four picture positions, as eq. 1 gives them (not unit)."""
    left, bottom = camera[CAMERA_LEFT], camera[CAMERA_BOTTOM]
    across, up = camera[CAMERA_RIGHT] - left, camera[CAMERA_TOP] - bottom
    d = camera[CAMERA_DISTANCE]
    u = splat(VECTOR, left) + splat(VECTOR, across) * (x * splat(VECTOR, 1.0 / width))
    v = splat(VECTOR, bottom) + splat(VECTOR, up) * ((splat(VECTOR, float(height)) - y) * splat(VECTOR, 1.0 / height))
    return Vec3(
        _axis(camera, -d * camera[CAMERA_W], 0, u, v),
        _axis(camera, -d * camera[CAMERA_W + 1], 1, u, v),
        _axis(camera, -d * camera[CAMERA_W + 2], 2, u, v),
    )


@kernel
def fill_camera_rays(
    camera: Any, kind: int, width: int, height: int, n: int, places: int, origins: int, directions: int
) -> None:
    """Make rays through picture positions.

    Parameters
    ----------
    camera, kind, width, height
        As :func:`tracer.rays.camera.camera_ray`.
    n
        How many; positions are read, and rays written, up to the next multiple of four.
    places
        Address of two rows: x, y in pixels from the top left corner of the full image.
    origins, directions
        Addresses of three rows each; directions are unit.
    """
    for step in range(0, 8 * n, STEP):
        if kind == CAMERA_VIEW_PLANE:
            x, y = load(VECTOR, places + step), load(VECTOR, places + ROW + step)
            d = view_directions(camera, width, height, x, y)
            squared = dot(d, d)
            if all_lanes((squared > splat(VECTOR, 1e-290)) & (squared < splat(VECTOR, 1e290))):
                inverse = splat(VECTOR, 1.0) / sqrt(squared)
                store(directions + step, d.x * inverse)
                store(directions + ROW + step, d.y * inverse)
                store(directions + 2 * ROW + step, d.z * inverse)
                for axis in range(3):
                    store(origins + axis * ROW + step, splat(VECTOR, camera[CAMERA_EYE + axis]))
                continue
        for lane in range(step, step + STEP, 8):
            px, py = load(_float64, places + lane), load(_float64, places + ROW + lane)
            ray = unit_ray(camera_ray(camera, kind, px, py, width, height))
            store(origins + lane, ray.origin.x)
            store(origins + ROW + lane, ray.origin.y)
            store(origins + 2 * ROW + lane, ray.origin.z)
            store(directions + lane, ray.direction.x)
            store(directions + ROW + lane, ray.direction.y)
            store(directions + 2 * ROW + lane, ray.direction.z)
