"""Wavefront OBJ.

Read here and not by trimesh, which cuts polygons into fans even when they are concave, counts relative indices from the
end of the file, takes index 0 for the first vertex, and drops the names of groups. Lines that are alike are parsed
together: 1 million triangles take 6 s and 0.7 GB.

Invariant: a corner is a triple (position, texture coordinate, normal); corners that are alike become one vertex.
Source: the OBJ format of Wavefront's Advanced Visualizer, polygonal part.
"""

import warnings
from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.colors import linear_colors
from tracer.loaders.files import CompanionError, ModelFile
from tracer.loaders.mesh import NEEDS_FACES, MeshData, MeshGroup, MeshPart, join_parts
from tracer.loaders.mtl import MaterialLibrary
from tracer.loaders.polygon import triangulate

_ABSENT = -1
_BEYOND = 2**62  # no index is as large, and int64 holds it
_NO_DIGITS = str.maketrans("", "", "0123456789")


class _Polygons(NamedTuple):
    """Polygons with the same number of corners; indices from 0, or `_ABSENT`."""

    corners: NDArray[np.int64]  # (m, n, 3) position, texture coordinate, normal
    face: NDArray[np.int64]  # (m,) number of the face line


class _Text(NamedTuple):
    """What the lines of a file say, still as text."""

    positions: list[str]
    uvs: list[str]
    normals: list[str]
    faces: list[str]
    face_lines: list[int]  # line number of each face
    face_sections: list[int]
    counts: dict[int, tuple[int, int, int]]  # of positions, uvs, normals before a face with relative indices
    sections: list[tuple[str, str, str]]  # group, object, material
    libraries: list[str]


def load_obj(file: ModelFile, data: bytes) -> MeshData:
    """Read a model and the material libraries that it names.

    Raises
    ------
    LoadError
    """
    text = _split(data)
    n_faces = len(text.faces)
    if n_faces > file.limits.faces:
        raise file.error(f"has {n_faces} faces, more than the {file.limits.faces} allowed", "simplify it")
    positions, colors = _parse_positions(file, text.positions)
    uvs = _parse_rows(file, text.uvs, 2, "vt")
    normals = _parse_rows(file, text.normals, 3, "vn")
    sizes = (len(positions), len(uvs), len(normals))
    corners, face = _triangles(file, _parse_faces(file, text, sizes), positions)
    library = MaterialLibrary(file)
    for name in dict.fromkeys(text.libraries):
        _read_library(file, library, name)
    groups = _groups(file, text, library)
    section = np.array(text.face_sections, np.int32)[face]

    has_uv = (corners[:, :, 1] != _ABSENT).all(axis=1) if len(uvs) else np.zeros(len(corners), bool)
    has_normal = (corners[:, :, 2] != _ABSENT).all(axis=1) if len(normals) else np.zeros(len(corners), bool)
    parts = []
    for with_uv in (False, True):
        for with_normal in (False, True):
            chosen = (has_uv == with_uv) & (has_normal == with_normal)
            if not chosen.any():
                continue
            triples = corners[chosen].reshape(-1, 3)
            first, index = _unique_corners(triples, sizes, with_uv, with_normal)
            position = triples[first, 0]
            parts.append(
                MeshPart(
                    positions[position],
                    index.reshape(-1, 3),
                    normals[triples[first, 2]] if with_normal else None,
                    uvs[triples[first, 1]] if with_uv else None,
                    None if colors is None else colors[position],
                    section[chosen],
                )
            )
    return join_parts(file, parts, groups, library.materials, library.images)


def _split(data: bytes) -> _Text:
    """Sort the lines by what they begin with."""
    text = _Text([], [], [], [], [], [], {}, [], [])
    group, thing, material = "", "", ""
    numbers: dict[tuple[str, str, str], int] = {}
    section = -1
    content = data.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    for number, raw in enumerate(content.split("\n"), 1):
        line = raw.strip()
        key, _, rest = line.partition(" ")
        if "\t" in key:
            key, _, rest = line.replace("\t", " ").partition(" ")
        if key == "v":
            text.positions.append(rest)
        elif key == "vt":
            text.uvs.append(rest)
        elif key == "vn":
            text.normals.append(rest)
        elif key == "f":
            if section < 0:
                section = numbers.setdefault((group, thing, material), len(numbers))
            if "-" in rest:
                text.counts[len(text.faces)] = (len(text.positions), len(text.uvs), len(text.normals))
            text.faces.append(rest.partition("#")[0].strip() if "#" in rest else rest)
            text.face_lines.append(number)
            text.face_sections.append(section)
        elif key in {"g", "o", "usemtl"}:
            name = rest.strip()
            group = name if key == "g" else group
            thing = name if key == "o" else thing
            material = name if key == "usemtl" else material
            section = -1
        elif key == "mtllib":
            text.libraries.append(rest.strip())
    text.sections.extend(numbers)
    return text


def _groups(file: ModelFile, text: _Text, library: MaterialLibrary) -> list[MeshGroup]:
    """Return a group for each section, known by its group's, its object's and its material's name."""
    groups = []
    for group, thing, material in text.sections:
        index = library.find(material)
        if material and index < 0:
            file.warn(f"material {material!r} is not defined: a default material is used")
        groups.append(MeshGroup(tuple(dict.fromkeys(name for name in (group, thing, material) if name)), index))
    return groups


def _read_library(file: ModelFile, library: MaterialLibrary, name: str) -> None:
    """Read `mtllib NAME`, where NAME may have spaces in it, or be several names."""
    if " " in name:
        try:
            file.read_companion(name)
        except CompanionError:
            for word in name.split():
                library.read(word)
            return
    library.read(name)


def _parse_numbers(lines: list[str]) -> NDArray[np.float64] | None:
    """Parse lines with the same count of numbers each, or return None."""
    width = len(lines[0].split())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(" ".join(lines), dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    return numbers.reshape(-1, width) if width and numbers.size == width * len(lines) else None


def _parse_rows(file: ModelFile, lines: list[str], width: int, key: str) -> NDArray[np.float64]:
    """Parse `vt` or `vn` lines; what is missing at a line's end is 0, what is no number is NaN."""
    if not lines:
        return np.zeros((0, width))
    rows = _parse_numbers(lines)
    if rows is not None and rows.shape[1] >= width:
        return rows[:, :width]
    out = np.zeros((len(lines), width))
    for index, line in enumerate(lines):
        for column, word in enumerate(line.split()[:width]):
            try:
                out[index, column] = float(word)
            except ValueError:
                file.warn(f"{key} {line[:40]!r} is not made of numbers")
                out[index, column] = np.nan
    return out


def _parse_positions(file: ModelFile, lines: list[str]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Parse `v` lines: x y z, then perhaps w or red green blue."""
    if not lines:
        raise file.error("is empty: there are no vertices in it", NEEDS_FACES)
    rows = _parse_numbers(lines)
    if rows is None or rows.shape[1] < 3:
        width = 6 if any(len(line.split()) >= 6 for line in lines) else 3
        rows = np.full((len(lines), width), np.nan)
        for index, line in enumerate(lines):
            words = line.partition("#")[0].split()
            if len(words) < 3:
                raise file.error(f"has a vertex with fewer than three numbers, v {line[:40]!r}", "export it again")
            for column, word in enumerate(words[: width if len(words) >= 6 else 3]):
                try:
                    rows[index, column] = float(word)
                except ValueError:
                    file.warn(f"v {line[:40]!r} is not made of numbers")
    return rows[:, :3], linear_colors(rows[:, 3:6]) if rows.shape[1] >= 6 else None


def _parse_faces(file: ModelFile, text: _Text, sizes: tuple[int, int, int]) -> list[_Polygons]:
    """Parse all face lines; lines of the same form together, odd ones one by one."""
    forms: dict[tuple[str, int], list[int]] = defaultdict(list)
    odd: list[int] = []
    for index, line in enumerate(text.faces):
        if index in text.counts:
            odd.append(index)
            continue
        # What is left without digits, "/ / /", is the form; only "1//2" and "1/2/3" look alike then.
        forms[line.translate(_NO_DIGITS), line.count("//")].append(index)
    polygons = []
    for (form, n_doubles), indices in forms.items():
        n = len(text.faces[indices[0]].split())
        columns = None
        if n >= 3 and len({word.count("/") for word in text.faces[indices[0]].split()}) == 1:
            columns = {
                (0, 0): (0,),
                (n, 0): (0, 1),
                (2 * n, n): (0, 2),
                (2 * n, 0): (0, 1, 2),
            }.get((form.count("/"), n_doubles))
        parsed = None
        if columns is not None:
            parsed = _parse_alike([text.faces[index] for index in indices], n, columns)
        if parsed is None:
            odd += indices
        else:
            polygons.append(_Polygons(parsed, np.array(indices)))
    polygons += _parse_odd(file, text, sorted(odd))
    for group in polygons:
        _check_indices(file, text, group, sizes)
    return polygons


def _parse_alike(lines: list[str], n: int, columns: tuple[int, ...]) -> NDArray[np.int64] | None:
    """Parse lines with n corners of the same form; None when they are not what they seemed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            flat = np.fromstring(" ".join(lines).replace("/", " "), dtype=np.int64, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    if flat.size != len(lines) * n * len(columns):
        return None
    corners = np.full((len(lines), n, 3), _ABSENT, np.int64)
    corners[:, :, list(columns)] = flat.reshape(len(lines), n, len(columns)) - 1
    corners[:, :, 0][corners[:, :, 0] < 0] = -2  # index 0 is wrong, not absent
    return corners


def _parse_odd(file: ModelFile, text: _Text, indices: list[int]) -> list[_Polygons]:
    """Parse face lines one by one: relative indices, corners of different forms, too few corners."""
    by_size: dict[int, tuple[list[list[list[int]]], list[int]]] = defaultdict(lambda: ([], []))
    for index in indices:
        counts = text.counts.get(index, (0, 0, 0))
        corners: list[list[int]] = []
        for word in text.faces[index].split():
            fields = [*word.split("/"), "", ""][:3]
            try:
                numbers = [min(max(int(field), -_BEYOND), _BEYOND) if field else None for field in fields]
            except ValueError:
                numbers = [None]
            if numbers[0] is None:
                corners = []
                break
            # Relative indices count back from the last line of their kind before this one.
            corners.append(
                [
                    _ABSENT if number is None else number - 1 if number > 0 else count + number if number else -2
                    for number, count in zip(numbers, counts, strict=True)
                ]
            )
        if len(corners) < 3:
            file.warn(f"line {text.face_lines[index]}: a face with fewer than three corners is left out")
            continue
        by_size[len(corners)][0].append(corners)
        by_size[len(corners)][1].append(index)
    return [_Polygons(np.array(corners, np.int64), np.array(faces)) for corners, faces in by_size.values()]


def _check_indices(file: ModelFile, text: _Text, polygons: _Polygons, sizes: tuple[int, int, int]) -> None:
    """Refuse positions that are not there; take texture coordinates and normals that are not there away."""
    position = polygons.corners[:, :, 0]
    wrong = (position < 0) | (position >= sizes[0])
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        number = int(position[row, column]) + 1
        raise file.error(
            f"line {text.face_lines[int(polygons.face[row])]}: a face uses vertex {max(number, 0)}, and there are "
            f"{sizes[0]} (1 to {sizes[0]})",
            "export it again",
        )
    for column, name in ((1, "texture coordinates"), (2, "normals")):
        values = polygons.corners[:, :, column]
        wrong = (values < _ABSENT) | (values >= sizes[column])
        if wrong.any():
            file.warn(f"{int(wrong.any(axis=1).sum())} faces use {name} that are not there: they are drawn without")
            values[wrong] = _ABSENT


def _triangles(
    file: ModelFile, polygons: list[_Polygons], positions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons into triangles, in the order of the file.

    Returns
    -------
    int64 (m, 3, 3), int64 (m,)
        Corners, and the face line that each comes from.
    """
    corners: list[NDArray[np.int64]] = [np.zeros((0, 3, 3), np.int64)]
    faces: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    total = 0
    for group in polygons:
        m, n = group.corners.shape[:2]
        total += m * (n - 2)
        if total > file.limits.faces:
            raise file.error(f"has more than the {file.limits.faces} triangles allowed", "simplify it")
        plain = np.ones(m, bool) if n == 3 else _is_fan(positions[group.corners[:, :, 0]])
        for i in range(1, n - 1):
            corners.append(group.corners[plain][:, [0, i, i + 1]])
            faces.append(group.face[plain])
        for row in np.flatnonzero(~plain):
            cut = np.array(triangulate(positions[group.corners[row, :, 0]]))
            corners.append(group.corners[row][cut])
            faces.append(np.full(len(cut), group.face[row]))
    face = np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return np.concatenate(corners)[order], face[order]


def _is_fan(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether cutting a polygon from its first corner is right, float64 (m, n, 3) -> (m,)."""
    with np.errstate(all="ignore"):
        relative = corners - corners[:, :1]
        normal = np.cross(relative, np.roll(relative, -1, axis=1)).sum(axis=1)
        turns = (np.cross(relative[:, 1:-1], relative[:, 2:]) * normal[:, np.newaxis]).sum(axis=2)
        return np.asarray((turns >= 0.0).all(axis=1))


def _unique_corners(
    triples: NDArray[np.int64], sizes: tuple[int, int, int], with_uv: bool, with_normal: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first place of each distinct corner, and each corner's number."""
    # Pairs are numbered first: the product of three counts would not fit 64 bits.
    key = triples[:, 0]
    if with_uv:
        key = np.unique(key * sizes[1] + triples[:, 1], return_inverse=True)[1]
    if with_normal:
        key = np.unique(key * sizes[2] + triples[:, 2], return_inverse=True)[1]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    return first, index
