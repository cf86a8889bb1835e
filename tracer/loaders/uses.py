"""Meshes that a file draws several times: stored once, taken apart for the renderer, or put into the file's space.

Invariant: :func:`flattened` gives the triangles that the file draws, each by one product of its vertices with its use's
matrix, whichever of them were stored once.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.limits import MAX_COORDINATE
from tracer.loaders.mesh import MeshData, Rows

_MOST_SKEW: Final = 2.0**20  # beyond it the renderer bakes a use, too
_OPTIONAL: Final = ("normals", "uvs", "colors")


def bake(
    matrix: NDArray[np.float64], positions: NDArray[Any], normals: NDArray[Any] | None, faces: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[Any]]:
    """Put vertices, normals and faces into the space that a 4 x 4 matrix leads to.

    Normals go by the inverse transpose and change their lengths; under a mirroring matrix faces are turned round, so
    that the winding stays outward.
    """
    linear = matrix[:3, :3]
    # Cofactors are the inverse transpose times the determinant: right for singular maps, too.
    cofactors = _cofactors(linear)
    is_mirrored = float((linear[0] * cofactors[0]).sum()) < 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = positions.T
        placed = np.stack([row[0] * x + row[1] * y + row[2] * z + row[3] for row in matrix[:3]], axis=1)
        if normals is not None:
            sign = -1.0 if is_mirrored else 1.0
            nx, ny, nz = np.asarray(normals, np.float64).T
            normals = sign * np.stack([row[0] * nx + row[1] * ny + row[2] * nz for row in cofactors], axis=1)
    return placed, normals, faces[:, [0, 2, 1]] if is_mirrored else faces


def _cofactors(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])])


def rows_of(matrix: NDArray[np.float64]) -> Rows:
    """Return a 4 x 4 matrix as rows of numbers."""
    a, b, c, d = ((float(x), float(y), float(z), float(w)) for x, y, z, w in matrix)
    return a, b, c, d


def may_place(matrix: NDArray[np.float64], reach: float) -> bool:
    """Whether a use of a mesh with coordinates up to ``reach`` may be kept apart: all in range, M far from singular.

    An entry of M^-1 is at most 2 m^2 / abs(det M), with m the largest of M's, so 6 norm^3 / abs(det M) bounds the row
    sums of abs(M) abs(M^-1), which magnify a rounding error on the way there and back.
    """
    linear = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        norm = float(np.abs(linear).sum(axis=1).max())
        if not 0.0 < norm < MAX_COORDINATE:
            return False
        scaled = linear / norm
        determinant = abs(float((scaled[0] * _cofactors(scaled)[0]).sum()))
        farthest = norm * reach + float(np.abs(matrix[:3, 3]).max())
    return determinant * _MOST_SKEW > 6.0 and farthest <= MAX_COORDINATE


def separate(data: MeshData) -> list[tuple[MeshData, Rows | None]]:
    """Take a mesh apart: what is drawn as it is, with None, and each use of what is stored once, with its matrix.

    Uses of one stored mesh share its arrays.
    """
    if not data.uses:
        return [(data, None)]
    stored: dict[tuple[tuple[int, int], tuple[int, int]], MeshData] = {}
    first = min(use.vertices[0] for use in data.uses), min(use.faces[0] for use in data.uses)
    found: list[tuple[MeshData, Rows | None]] = []
    if first[1]:
        found.append((_part(data, (0, first[0]), (0, first[1])), None))
    for use in data.uses:
        if (use.vertices, use.faces) not in stored:
            stored[use.vertices, use.faces] = _part(data, use.vertices, use.faces)
        found.append((stored[use.vertices, use.faces]._replace(groups=data.groups[slice(*use.groups)]), use.rows))
    return found


def _part(data: MeshData, vertices: tuple[int, int], faces: tuple[int, int]) -> MeshData:
    """Cut some vertices and faces out."""
    optional: dict[str, Any] = {name: getattr(data, name) for name in _OPTIONAL}
    cut: dict[str, Any] = {
        name: None if values is None else values[slice(*vertices)] for name, values in optional.items()
    }
    return data._replace(
        positions=data.positions[slice(*vertices)],
        faces=data.faces[slice(*faces)] - np.int32(vertices[0]),
        face_flags=data.face_flags[slice(*faces)],
        face_group=data.face_group[slice(*faces)],
        uses=(),
        **cut,
    )


def flattened(data: MeshData) -> MeshData:
    """Put every use into the file's space, one behind the other: the mesh as if nothing were stored once."""
    if not data.uses:
        return data
    parts = separate(data)
    first_group = [0] * (len(parts) - len(data.uses)) + [use.groups[0] for use in data.uses]
    baked = []
    for (part, rows), group in zip(parts, first_group, strict=True):
        placed = part
        if rows is not None:
            positions, normals, faces = bake(np.array(rows), part.positions, part.normals, part.faces)
            placed = part._replace(positions=positions, normals=normals, faces=faces)
        baked.append(placed._replace(face_group=part.face_group + np.int32(group)))
    offsets = np.cumsum([0] + [len(part.positions) for part in baked])
    joined: dict[str, Any] = {
        name: None if getattr(data, name) is None else np.concatenate([getattr(part, name) for part in baked])
        for name in _OPTIONAL
    }
    return data._replace(
        positions=np.concatenate([part.positions for part in baked]),
        faces=np.concatenate([part.faces + np.int32(k) for part, k in zip(baked, offsets, strict=False)]),
        face_flags=np.concatenate([part.face_flags for part in baked]),
        face_group=np.concatenate([part.face_group for part in baked]),
        uses=(),
        **joined,
    )
