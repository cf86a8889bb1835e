"""Which meshes share a tree, which are baked into one, and where each is placed.

* A mesh that is placed several times, and is large enough, is stored once, in its own space, with a tree of its own;
  each use is a placement. What a map would cost in accuracy decides, too: beyond `_MOST_SKEW` a use is baked.
* All else is baked into world space. One tree holds what one frame resolves: a tree's boxes are float32 numbers in a
  frame that spans it all, and packets resolve 2^-21 of that, so meshes of which the mean edge is below 2^-18 of the
  frame (an eighth of it would be lost) go to a tree of their own, or to one with their neighbours. Mostly that is one.

Invariants: the result depends on the meshes alone; a scene of which nothing is shared or parted has the arrays that it
would have if there were no placements: all meshes in their order, in one tree.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import Placement
from tracer.accel.placing import AffineMap, skewness
from tracer.accel.top import bounds_of
from tracer.render.geometry import check_range, is_mirroring, transform_normals, transform_points
from tracer.scene import IDENTITY, Matrix
from tracer.scene.limits import MAX_COORDINATE

_SHARED_TRIANGLES: Final = 4_096
"""From so many on a mesh may share a tree: below, moving 64 rays costs more than the smaller memory gains."""
_SAVED_TRIANGLES: Final = 2**18
"""So many must be saved by it, some 40 MB: below, one tree over everything is small enough, and faster."""
_MOST_SKEW: Final = 2.0**20
_RESOLVED: Final = 2.0**18
_GAP: Final = 0.25  # share of the frame: across wider gaps meshes are parted, and smaller ones taken from larger ones

_VERTEX_BYTES: Final = 88  # stored for each vertex and each face, by the kind of array
_FACE_BYTES: Final = 13
_MATERIAL_BYTES: Final = 4


class MeshRecord(NamedTuple):
    """One object's triangles in its own space."""

    positions: NDArray[np.float64]
    normals: NDArray[np.float64] | None
    uvs: NDArray[np.float64] | None
    colors: NDArray[np.float64] | None
    faces: NDArray[np.int32]
    flags: NDArray[np.uint8]
    face_material: NDArray[np.int32]
    rows: Matrix  # to the world
    pointer: str  # of the object, for faults


class Parts(NamedTuple):
    """The triangles of a scene."""

    arrays: dict[str, NDArray[Any]]  # vertex_*, face_* of CompiledScene
    trees: list[NDArray[np.int64]]
    placements: list[Placement]
    saved_bytes: int  # what was not stored again
    baked: list[MeshRecord]  # what is drawn once, in the world


def build_parts(meshes: Sequence[MeshRecord], build: Callable[..., NDArray[np.int64]]) -> Parts:
    """Bake, share and part the meshes of a scene, and build their trees.

    Parameters
    ----------
    meshes
        In the order of the document.
    build
        Makes a tree of (vertices, faces): :func:`tracer.accel.build_tree`, or a caching one.

    Raises
    ------
    SceneError
        A transform takes a mesh out of the range of coordinates.
    """
    groups = _shared_groups(meshes)
    shared = {index for group in groups for index in group}
    baked = [_baked(mesh) for index, mesh in enumerate(meshes) if index not in shared]
    clusters = _cluster(baked)
    if not clusters and not groups:
        clusters = [[]]
    stored = [[baked[index] for index in cluster] for cluster in clusters]
    stored += [[meshes[group[0]]] for group in groups]
    arrays = _join([mesh for part in stored for mesh in part])
    trees: list[NDArray[np.int64]] = []
    placements: list[Placement] = []
    materials = [np.empty(0, np.int32)]
    vertex = face = material = saved = 0
    for number, part in enumerate(stored):
        n_vertices, n_faces = sum(len(mesh.positions) for mesh in part), sum(len(mesh.faces) for mesh in part)
        vertices = arrays["vertex_positions"][vertex : vertex + n_vertices]
        faces = arrays["face_vertices"][face : face + n_faces]
        if vertex:
            faces = faces - np.int32(vertex)
        trees.append(build(vertices, faces))
        if number < len(clusters):
            placements.append(Placement(number, n_faces, face, material, bounds=bounds_of(vertices, faces)))
            materials += [mesh.face_material for mesh in part]
            material += n_faces
        else:
            uses = [meshes[index] for index in groups[number - len(clusters)]]
            choices: dict[bytes, int] = {}
            for use in uses:
                choice = hashlib.sha256(use.face_material.data).digest()
                if choice not in choices:
                    choices[choice] = material
                    materials.append(use.face_material)
                    material += n_faces
                there = None if use.rows == IDENTITY else AffineMap.of_rows(use.rows)
                placements.append(Placement(number, n_faces, face, choices[choice], there))
            each = trees[-1].nbytes + _VERTEX_BYTES * n_vertices + _FACE_BYTES * n_faces
            saved += (len(uses) - 1) * each + (len(uses) - len(choices)) * _MATERIAL_BYTES * n_faces
        vertex, face = vertex + n_vertices, face + n_faces
    return Parts({**arrays, "face_material": np.concatenate(materials)}, trees, placements, saved, baked)


def _baked(mesh: MeshRecord) -> MeshRecord:
    """Bake the transform into the vertices."""
    if mesh.rows == IDENTITY:
        return mesh
    normals = mesh.normals
    with np.errstate(over="ignore", invalid="ignore"):
        positions = transform_points(mesh.rows, mesh.positions)
        if normals is not None:
            normals = transform_normals(mesh.rows, normals)
    check_range(positions, mesh.pointer)
    faces = mesh.faces
    if is_mirroring(mesh.rows):  # keeps the winding outward
        faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
    return mesh._replace(positions=positions, normals=normals, faces=faces, rows=IDENTITY)


def _join(meshes: Sequence[MeshRecord]) -> dict[str, NDArray[Any]]:
    """Concatenate vertices and faces; absent attributes are filled as `CompiledScene` says."""
    offsets = np.cumsum([0] + [len(mesh.positions) for mesh in meshes])

    def joined(values: list[NDArray[np.float64] | None], width: int, absent: float) -> NDArray[np.float64]:
        out = np.full((int(offsets[-1]), width), absent)
        for mesh, value, offset in zip(meshes, values, offsets, strict=False):
            if value is not None:
                out[offset : offset + len(mesh.positions)] = value
        return out

    return {
        "vertex_positions": joined([mesh.positions for mesh in meshes], 3, 0.0),
        "vertex_normals": joined([mesh.normals for mesh in meshes], 3, 0.0),
        "vertex_uvs": joined([mesh.uvs for mesh in meshes], 2, 0.0),
        "vertex_colors": joined([mesh.colors for mesh in meshes], 3, 1.0),
        "face_vertices": np.concatenate(
            [
                np.empty((0, 3), np.int32),
                *(mesh.faces + np.int32(offset) for mesh, offset in zip(meshes, offsets, strict=False)),
            ]
        ),
        "face_flags": np.concatenate([np.empty(0, np.uint8), *(mesh.flags for mesh in meshes)]),
    }


# --- what is shared ---------------------------------------------------------------------------------------------------


def _digest(mesh: MeshRecord) -> bytes:
    """Name a mesh's geometry by its content; materials and transform apart."""
    digest = hashlib.sha256()
    for array in (mesh.positions, mesh.normals, mesh.uvs, mesh.colors, mesh.faces, mesh.flags):
        digest.update(b"none" if array is None else f"{array.shape}".encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _may_move(mesh: MeshRecord) -> bool:
    """Whether a use of a mesh may be a placement: within range, and not too skewed."""
    if mesh.rows == IDENTITY:
        return True
    there = AffineMap.of_rows(mesh.rows)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    reach = np.abs(there.linear) @ np.maximum(np.abs(low), np.abs(high)) + np.abs(there.origin)
    return bool((reach <= MAX_COORDINATE).all()) and skewness(there) <= _MOST_SKEW


def _shared_groups(meshes: Sequence[MeshRecord]) -> list[list[int]]:
    """Find the equal meshes that are worth a tree of their own: lists of their numbers."""
    sizes: dict[tuple[int, int], list[int]] = {}
    for index, mesh in enumerate(meshes):
        if len(mesh.faces) >= _SHARED_TRIANGLES:
            sizes.setdefault((len(mesh.positions), len(mesh.faces)), []).append(index)
    groups: dict[bytes, list[int]] = {}
    digests: dict[tuple[int, ...], bytes] = {}  # by the arrays' identities: a mesh that is used often is read once
    for alike in sizes.values():
        if len(alike) < 2:
            continue
        for index in alike:
            mesh = meshes[index]
            if not _may_move(mesh):
                continue
            key = tuple(id(array) for array in mesh[:6])
            if key not in digests:
                digests[key] = _digest(mesh)
            groups.setdefault(digests[key], []).append(index)
    return [
        group
        for group in groups.values()
        if len(group) > 1 and (len(group) - 1) * len(meshes[group[0]].faces) >= _SAVED_TRIANGLES
    ]


# --- what is parted ---------------------------------------------------------------------------------------------------


def _cluster(meshes: Sequence[MeshRecord]) -> list[list[int]]:
    """Part meshes so that each tree's frame resolves all of its meshes; lists of their numbers, in order."""
    if len(meshes) <= 1:
        return [[0]] if len(meshes) else []
    bounds = np.array([bounds_of(mesh.positions, mesh.faces) for mesh in meshes])
    filled = np.flatnonzero([len(mesh.faces) > 0 for mesh in meshes])
    empty = np.flatnonzero([len(mesh.faces) == 0 for mesh in meshes])
    if len(filled) == 0:
        return [list(range(len(meshes)))]
    low, high = bounds[:, :3], bounds[:, 3:]
    with np.errstate(invalid="ignore"):
        size = (high - low).max(axis=1)
    edge = np.array([s / math.sqrt(max(1, len(mesh.faces))) for s, mesh in zip(size, meshes, strict=True)])
    edge[~(size > 0.0)] = np.inf  # a point is resolved anywhere
    clusters: list[list[int]] = []
    pending = [filled]
    while pending:
        some = pending.pop()
        extent = float((high[some].max(axis=0) - low[some].min(axis=0)).max())
        if len(some) == 1 or edge[some].min() * _RESOLVED >= extent:
            clusters.append(some.tolist())
        else:
            pending += _parted(some, low, high, size, extent)
    clusters.sort()
    clusters[0] = sorted(clusters[0] + empty.tolist())
    return clusters


def _parted(
    some: NDArray[np.int64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    size: NDArray[np.float64],
    extent: float,
) -> list[NDArray[np.int64]]:
    """Part meshes in two: across the widest gap, else the large from the small, else by their places."""
    widest, side = 0.0, some[:0]
    for axis in range(3):
        order = some[np.argsort(low[some, axis], kind="stable")]
        gaps = low[order[1:], axis] - np.maximum.accumulate(high[order, axis])[:-1]
        k = int(gaps.argmax())
        if gaps[k] > widest:
            widest, side = float(gaps[k]), order[: k + 1]
    large = some[size[some] >= _GAP * extent]
    if widest < _GAP * extent:
        side = large
    if len(side) == 0 or len(side) == len(some):
        middle = 0.5 * low[some] + 0.5 * high[some]
        axis = int((middle.max(axis=0) - middle.min(axis=0)).argmax())
        side = some[np.argsort(middle[:, axis], kind="stable")[: len(some) // 2]]
    return [np.sort(side), np.setdiff1d(some, side)]
