"""From objects of the scene document to triangles, shapes and planes in world space.

Invariants: every transform is baked (meshes) or becomes a pair of affine maps (shapes, placements); products are
written out element by element, in one order, so that the same scene has the same bits on every machine; a mesh without
a transform keeps its numbers untouched.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.scene import Box, Cylinder, Disk, Fault, Matrix, Plane, SceneError, Sphere
from tracer.scene.limits import MAX_COORDINATE
from tracer.types import (
    SHAPE_BOX,
    SHAPE_CYLINDER_CAPPED,
    SHAPE_CYLINDER_OPEN,
    SHAPE_DISK,
    SHAPE_SPHERE,
)

Vector3 = tuple[float, float, float]


class ShapeRecord(NamedTuple):
    """One finite shape: p_world = origin + to_world @ p_local."""

    kind: int  # SHAPE_*
    origin: NDArray[np.float64]  # (3,)
    to_world: NDArray[np.float64]  # (3, 3)
    to_local: NDArray[np.float64]  # (3, 3)


class PlaneRecord(NamedTuple):
    """One infinite plane, world."""

    point: NDArray[np.float64]  # (3,)
    normal: NDArray[np.float64]  # (3,) unit
    uv: NDArray[np.float64]  # (2, 3) u, v = uv @ (p_world - point)


def transform_points(rows: Matrix, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the affine map to points, float64 (n, 3)."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    out = np.empty_like(points)
    for axis, (a, b, c, t) in enumerate(rows[:3]):
        out[:, axis] = a * x + b * y + c * z + t
    return out


def transform_normals(rows: Matrix, normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the inverse transpose to normals, float64 (n, 3); their lengths change along."""
    inverse = invert3(np.array(rows)[:3, :3])
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    out = np.empty_like(normals)
    for axis in range(3):
        out[:, axis] = inverse[0, axis] * x + inverse[1, axis] * y + inverse[2, axis] * z
    return out


def determinant3(m: NDArray[np.float64]) -> float:
    """Return the determinant of a 3 x 3 matrix."""
    return float(
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )


def is_mirroring(rows: Matrix) -> bool:
    """Whether an affine map turns a right hand into a left one."""
    linear = np.array(rows)[:3, :3]
    return determinant3(linear / np.abs(linear).max(axis=1, keepdims=True)) < 0.0


def invert3(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert a 3 x 3 matrix by cofactors; rows are scaled first, so that neither 1e-30 nor 1e30 overflows."""
    size = np.abs(m).max(axis=1, keepdims=True)
    s = m / size
    cofactors = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            c, d = (i + 1) % 3, (i + 2) % 3
            cofactors[i, j] = s[a, c] * s[b, d] - s[a, d] * s[b, c]
    inverse: NDArray[np.float64] = cofactors / determinant3(s) / size.T
    return inverse


def basis_of(normal: Sequence[float]) -> NDArray[np.float64]:
    """Return columns (e1, e2, n): a right-handed orthonormal basis with n along `normal`.

    Source: Duff et al., Building an Orthonormal Basis, Revisited (2017); (0, 1, 0) gives (x, -z, y).
    """
    length = math.hypot(*normal)
    x, y, z = (coordinate / length for coordinate in normal)
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array(
        [
            [1.0 + sign * x * x * a, b, x],
            [sign * b, sign + y * y * a, y],
            [-sign * x, -y, z],
        ]
    )


def build_shape(shape: Sphere | Box | Disk | Cylinder, rows: Matrix, pointer: str) -> ShapeRecord:
    """Map a shape to its unit form.

    Raises
    ------
    SceneError
        When the transform takes it out of the range of coordinates.
    """
    if isinstance(shape, Sphere):
        kind, origin, local = SHAPE_SPHERE, shape.center, np.diag([shape.radius] * 3)
    elif isinstance(shape, Box):
        low, high = np.array(shape.min), np.array(shape.max)
        kind, origin = SHAPE_BOX, tuple((0.5 * low + 0.5 * high).tolist())
        local = np.diag(0.5 * high - 0.5 * low)
    elif isinstance(shape, Disk):
        kind, origin, local = SHAPE_DISK, shape.center, basis_of(shape.normal) * shape.radius
    else:
        kind = SHAPE_CYLINDER_CAPPED if shape.capped else SHAPE_CYLINDER_OPEN
        axis = [end - start for start, end in zip(shape.start, shape.end, strict=True)]
        origin, local = shape.start, basis_of(axis) * shape.radius
        local[:, 2] = axis
    # What lies at the ends of float64 may overflow here; the check after the product refuses it.
    linear = np.array(rows)[:3, :3]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
        to_world = np.stack([linear[:, 0] * c[0] + linear[:, 1] * c[1] + linear[:, 2] * c[2] for c in local.T], axis=1)
        origin_world = transform_points(rows, np.array([origin]))[0]
        to_local = invert3(to_world)
    numbers = np.concatenate([to_world.ravel(), origin_world])
    if not (np.abs(numbers) <= MAX_COORDINATE).all() or not np.isfinite(to_local).all():
        raise _range_error(pointer)
    return ShapeRecord(kind, origin_world, np.ascontiguousarray(to_world), to_local)


def build_plane(plane: Plane, rows: Matrix, pointer: str) -> PlaneRecord:
    """Move a plane to the world."""
    basis = basis_of(plane.normal)
    inverse = invert3(np.array(rows)[:3, :3])
    point = transform_points(rows, np.array([plane.point]))[0]
    normal = transform_normals(rows, basis[:, 2][np.newaxis])[0]
    normal /= np.abs(normal).max()
    normal /= math.hypot(*normal.tolist())
    uv = np.stack([basis[0, k] * inverse[0] + basis[1, k] * inverse[1] + basis[2, k] * inverse[2] for k in (0, 1)])
    if not (np.abs(point) <= MAX_COORDINATE).all() or not (np.isfinite(normal).all() and np.isfinite(uv).all()):
        raise _range_error(pointer)
    return PlaneRecord(point, normal, uv)


def check_range(positions: NDArray[np.float64], pointer: str) -> None:
    """Refuse a mesh that its transform takes out of the range of coordinates."""
    if positions.size and not (np.abs(positions) <= MAX_COORDINATE).all():
        raise _range_error(pointer)


def _range_error(pointer: str) -> SceneError:
    return SceneError(
        [Fault(f"{pointer}/transform", "takes the object out of the range of coordinates", "a size of 1e-30 to 1e30")]
    )


def smooth_normals(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Average the triangles' normals at each place, weighted by area.

    Vertices at the same place share their normal, though a seam of the texture may lie between them.

    Returns
    -------
    float64 (n_vertices, 3)
        Not normalised; zero where no triangle is, or where they cancel.
    """
    # The largest size is taken out, so that squares neither overflow nor underflow.
    scale = float(np.abs(positions).max()) or 1.0
    scaled = positions / scale
    a, b, c = scaled[faces[:, 0]], scaled[faces[:, 1]], scaled[faces[:, 2]]
    area_normals = np.cross(b - a, c - a)
    # -0.0 and 0.0 are one place.
    keys = np.ascontiguousarray(positions + 0.0).view([("", np.float64)] * 3).ravel()
    _, place = np.unique(keys, return_inverse=True)
    corner_place = place[faces]
    normals = np.empty((int(place.max()) + 1, 3))
    for axis in range(3):
        weights = np.repeat(area_normals[:, axis], 3)
        normals[:, axis] = np.bincount(corner_place.ravel(), weights=weights, minlength=len(normals))
    return normals[place]
