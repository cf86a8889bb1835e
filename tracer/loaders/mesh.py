"""What every loader returns, and the checks that every mesh passes.

Invariants of a `MeshData` from `join_parts`: at least one face; indices in range; positions finite and within the
scene's bounds; normals, texture coordinates and colours finite where `face_flags` says that a face has them;
no face with two corners at one place. Normals keep their length: they are normalised after interpolation.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.files import ModelFile
from tracer.loaders.limits import MAX_COLOR, MAX_COORDINATE, MAX_TEXTURE_COORDINATE
from tracer.types import FACE_HAS_COLORS, FACE_HAS_NORMALS, FACE_HAS_UVS

NEEDS_FACES: Final = "a mesh needs at least one triangle"


class FileMaterial(NamedTuple):
    """A material as a file has it, already in the terms of the report's equation 9; linear RGB."""

    name: str
    kd: tuple[float, float, float] = (0.8, 0.8, 0.8)
    ks: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exponent: float = 100.0
    ke: tuple[float, float, float] = (0.0, 0.0, 0.0)
    kr: tuple[float, float, float] = (0.0, 0.0, 0.0)
    eta: float = 1.0
    opacity: float = 1.0  # kt = 1 - opacity
    image: int = -1  # index of `MeshData.images`, or -1
    wrap: str = "repeat"  # or "clamp"
    filter: str = "bilinear"  # or "nearest"


class MeshGroup(NamedTuple):
    """A part of the faces that has one material."""

    names: tuple[str, ...]  # by which the scene may give it a material, the most particular first
    material: int = -1  # index of `MeshData.materials`, or -1


Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row, Row]


class MeshUse(NamedTuple):
    """One use of a mesh that a file draws several times, and that is stored once, in a space of its own.

    Ranges are half open. What is stored so comes behind all that is drawn as it is, and is drawn by its uses alone.
    """

    vertices: tuple[int, int]
    faces: tuple[int, int]
    groups: tuple[int, int]  # of this use; the stored faces count from the first of these
    rows: Rows  # affine, to the file's space


class MeshData(NamedTuple):
    """A mesh in its file's own space; `nv` vertices, `nf` triangles."""

    positions: NDArray[np.float64]  # (nv, 3)
    faces: NDArray[np.int32]  # (nf, 3)
    normals: NDArray[np.float64] | None  # (nv, 3), not normalised; 0 where a part has none
    uvs: NDArray[np.float64] | None  # (nv, 2), v upwards
    colors: NDArray[np.float64] | None  # (nv, 3), linear RGB
    face_flags: NDArray[np.uint8]  # (nf,) FACE_HAS_*
    face_group: NDArray[np.int32]  # (nf,) index of `groups`
    groups: tuple[MeshGroup, ...]
    materials: tuple[FileMaterial, ...]
    images: tuple[NDArray[np.uint8], ...]  # each (height, width, 3), sRGB, row 0 at the top
    warnings: tuple[str, ...]
    uses: tuple[MeshUse, ...] = ()


class MeshPart(NamedTuple):
    """What a loader read for one group: arrays of any numeric dtype, unchecked."""

    positions: NDArray[Any]  # (nv, 3)
    faces: NDArray[Any]  # (nf, 3)
    normals: NDArray[Any] | None
    uvs: NDArray[Any] | None
    colors: NDArray[Any] | None
    face_group: NDArray[Any] | int


class PartUse(NamedTuple):
    """One use of parts that are stored once; ranges are half open."""

    parts: tuple[int, int]
    groups: tuple[int, int]
    rows: Rows


def join_parts(
    file: ModelFile,
    parts: Sequence[MeshPart],
    groups: Sequence[MeshGroup],
    materials: Sequence[FileMaterial] = (),
    images: Sequence[NDArray[np.uint8]] = (),
    uses: Sequence[PartUse] = (),
) -> MeshData:
    """Check the parts of a model and put them into one mesh.

    Parts that ``uses`` names come behind all others.

    Raises
    ------
    LoadError
        When an index points nowhere, the model is too large, or nothing is left to draw.
    """
    limits = file.limits
    n_faces = sum(len(part.faces) for part in parts)
    n_vertices = sum(len(part.positions) for part in parts)
    if n_faces == 0:
        raise file.error("is empty: there are no triangles in it", NEEDS_FACES)
    if n_faces > limits.faces or n_vertices > limits.vertices:
        raise file.error(
            f"has {n_faces} triangles and {n_vertices} vertices, more than the {limits.faces} and {limits.vertices} "
            "allowed",
            "simplify it",
        )
    checked = [_check_part(file, part) for part in parts]
    offsets = np.cumsum([0] + [len(part.positions) for part in checked])
    first_faces = np.cumsum([0] + [len(part.faces) for part in checked])
    faces = np.concatenate([part.faces + offset for part, offset in zip(checked, offsets, strict=False)])
    flags = np.concatenate([_part_flags(part) for part in checked])
    face_group = np.concatenate([np.broadcast_to(np.int32(0) + part.face_group, len(part.faces)) for part in checked])
    positions = np.concatenate([part.positions for part in checked])
    normals = _join_optional([part.normals for part in checked], checked, 3, 0.0)
    uvs = _join_optional([part.uvs for part in checked], checked, 2, 0.0)
    colors = _join_optional([part.colors for part in checked], checked, 3, 1.0)

    keep = np.ones(len(faces), bool)
    bad = ~_in_range(positions, MAX_COORDINATE)
    if bad.any():
        touched = bad[faces].any(axis=1)
        positions[bad] = 0.0
        if touched.any():
            file.warn(f"{int(touched.sum())} triangles with a corner at infinity or NaN were left out")
            keep &= ~touched
    corners = positions[faces]
    collapsed = (
        (corners[:, 0] == corners[:, 1]).all(axis=1)
        | (corners[:, 1] == corners[:, 2]).all(axis=1)
        | (corners[:, 2] == corners[:, 0]).all(axis=1)
    )
    del corners
    if (collapsed & keep).any():
        file.warn(f"{int((collapsed & keep).sum())} triangles with two corners at one place were left out")
        keep &= ~collapsed
    if not keep.all():
        faces, flags, face_group = faces[keep], flags[keep], face_group[keep]
        first_faces = np.concatenate([[0], np.cumsum(keep)])[first_faces]
    if len(faces) == 0:
        raise file.error("is empty: none of its triangles has an area and finite corners", "export it again")

    if normals is not None:
        usable = _in_range(normals, MAX_COORDINATE) & np.asarray((normals != 0.0).any(axis=1))
        normals[~usable] = 0.0
        without = (flags & FACE_HAS_NORMALS).astype(bool) & ~usable[faces].all(axis=1)
        if without.any():
            file.warn(f"{int(without.sum())} triangles have a normal that is zero or not finite: they are drawn flat")
            flags[without] &= np.uint8(0xFF ^ FACE_HAS_NORMALS)
    if uvs is not None:
        usable = _in_range(uvs, MAX_TEXTURE_COORDINATE)
        uvs[~usable] = 0.0
        without = (flags & FACE_HAS_UVS).astype(bool) & ~usable[faces].all(axis=1)
        if without.any():
            file.warn(f"{int(without.sum())} triangles have texture coordinates that are not finite: no texture there")
            flags[without] &= np.uint8(0xFF ^ FACE_HAS_UVS)
    if colors is not None:
        unknown = ~np.isfinite(colors).all(axis=1)
        if unknown.any():
            file.warn(f"{int(unknown.sum())} vertex colours are not finite: white is used")
            colors[unknown] = 1.0
        np.clip(colors, 0.0, MAX_COLOR, out=colors)
    return MeshData(
        positions=positions,
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        normals=normals,
        uvs=uvs,
        colors=colors,
        face_flags=flags,
        face_group=np.ascontiguousarray(face_group, dtype=np.int32),
        groups=tuple(groups),
        materials=tuple(materials),
        images=tuple(images),
        warnings=tuple(file.warnings),
        uses=tuple(
            MeshUse(_between(offsets, use.parts), _between(first_faces, use.parts), use.groups, use.rows)
            for use in uses
        ),
    )


def _between(firsts: NDArray[np.int64], parts: tuple[int, int]) -> tuple[int, int]:
    """Return where a range of parts begins and ends."""
    return int(firsts[parts[0]]), int(firsts[parts[1]])


def _in_range(rows: NDArray[np.float64], bound: float) -> NDArray[np.bool_]:
    """Whether all numbers of each row are within the bound; NaN is not."""
    return np.asarray((np.abs(rows) <= bound).all(axis=1))


def _check_part(file: ModelFile, part: MeshPart) -> MeshPart:
    """Bring a part's arrays to their types, and refuse indices that point nowhere."""
    positions = np.array(part.positions, dtype=np.float64)
    faces = np.asarray(part.faces, dtype=np.int64)
    if positions.ndim != 2 or positions.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise file.error("has positions or faces that do not come in threes", "export it again")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(positions)):
        wrong = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise file.error(
            f"has a face that uses vertex {wrong}, and there are only {len(positions)} (0 to {len(positions) - 1})",
            "export it again",
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return part._replace(
            positions=positions,
            faces=faces,
            normals=_check_attribute(file, "normals", part.normals, len(positions), 3),
            uvs=_check_attribute(file, "texture coordinates", part.uvs, len(positions), 2),
            colors=_check_attribute(file, "colours", part.colors, len(positions), 3),
        )


def _check_attribute(
    file: ModelFile, name: str, values: NDArray[Any] | None, n_vertices: int, width: int
) -> NDArray[np.float64] | None:
    """Return an attribute as float64, or None (and a warning) when there are not as many as vertices."""
    if values is None:
        return None
    if values.shape != (n_vertices, width):
        file.warn(f"{name} are ignored: there are {values.shape} numbers for {n_vertices} vertices")
        return None
    return np.array(values, dtype=np.float64)


def _part_flags(part: MeshPart) -> NDArray[np.uint8]:
    """Return FACE_HAS_* of each face of a part."""
    bits = FACE_HAS_NORMALS * (part.normals is not None)
    bits |= FACE_HAS_UVS * (part.uvs is not None)
    bits |= FACE_HAS_COLORS * (part.colors is not None)
    return np.full(len(part.faces), bits, np.uint8)


def _join_optional(
    values: Sequence[NDArray[Any] | None], parts: Sequence[MeshPart], width: int, absent: float
) -> NDArray[np.float64] | None:
    """Concatenate an attribute that some parts may lack; None when all do."""
    if all(value is None for value in values):
        return None
    filled = [
        np.full((len(part.positions), width), absent) if value is None else value
        for value, part in zip(values, parts, strict=True)
    ]
    return np.concatenate(filled)
