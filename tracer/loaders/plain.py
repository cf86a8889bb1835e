"""PLY, STL and OFF: trimesh reads them, after the counts in their headers are held against the files' sizes.

Invariant: nothing is allocated for what a header claims and the file cannot hold.
"""

import io
import re
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.colors import linear_colors
from tracer.loaders.files import ModelFile
from tracer.loaders.mesh import NEEDS_FACES, MeshData, MeshGroup, MeshPart, join_parts

_PLY_SIZES: Final = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}


def load_ply(file: ModelFile, data: bytes) -> MeshData:
    """Read a PLY file, ASCII or binary."""
    _check_ply_header(file, data)
    from trimesh.exchange.ply import load_ply as read

    loaded = read(io.BytesIO(data), skip_materials=True)
    if loaded.get("faces") is None or not len(loaded["faces"]):
        raise file.error("is empty: there are no faces in it", f"{NEEDS_FACES}; point clouds cannot be rendered")
    return _join(file, [loaded], [MeshGroup(())])


def load_stl(file: ModelFile, data: bytes) -> MeshData:
    """Read an STL file, ASCII or binary; each solid of an ASCII file is a group."""
    n_claimed = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    is_binary = len(data) == 84 + 50 * n_claimed
    if not is_binary and data.lstrip()[:5].lower() != b"solid":
        if len(data) < 84:
            raise file.error(
                "is neither ASCII nor binary STL: it is too short",
                "export it again: text beginning with solid, or 84 bytes and 50 for each triangle",
            )
        raise file.error(
            f"says that it has {n_claimed} triangles, and has room for {(len(data) - 84) // 50}",
            "it was cut short or is damaged: export it again",
        )
    from trimesh.exchange.stl import load_stl_ascii, load_stl_binary

    if is_binary:
        if n_claimed == 0:
            raise file.error("is empty: there are no triangles in it", NEEDS_FACES)
        return _join(file, [load_stl_binary(io.BytesIO(data))], [MeshGroup(())])
    loaded = load_stl_ascii(io.BytesIO(data))
    solids: dict[str, Any] = loaded.get("geometry", {"": loaded})
    solids = {name: solid for name, solid in solids.items() if isinstance(solid, dict) and "faces" in solid}
    if not solids:
        raise file.error("is empty: there are no triangles in it", NEEDS_FACES)
    return _join(file, list(solids.values()), [MeshGroup((name,) if name else ()) for name in solids])


def load_off(file: ModelFile, data: bytes) -> MeshData:
    """Read an OFF file."""
    text = re.sub(rb"#[^\n]*", b"", data).split(None, 3)
    if len(text) < 3 or text[0].upper() not in {b"OFF", b"COFF"}:
        raise file.error("does not begin as OFF files do", "export it again")
    try:
        n_vertices, n_faces = int(text[1]), int(text[2])
    except ValueError:
        raise file.error(
            "has no counts of vertices and faces", "after OFF come the numbers of vertices, faces and edges"
        ) from None
    # A vertex takes at least three digits and three separators, and a face four.
    if min(n_vertices, n_faces) < 0 or 6 * n_vertices + 8 * n_faces > len(data) + 16:
        raise file.error(
            f"says that it has {n_vertices} vertices and {n_faces} faces, more than its {len(data)} bytes can hold",
            "it was cut short or is damaged: export it again",
        )
    from trimesh.exchange.off import load_off as read

    return _join(file, [read(io.BytesIO(data))], [MeshGroup(())])


def _join(file: ModelFile, loaded: list[dict[str, Any]], groups: list[MeshGroup]) -> MeshData:
    """Turn what trimesh read into a mesh."""
    parts = []
    for index, kwargs in enumerate(loaded):
        faces = np.asarray(kwargs["faces"])
        positions = np.asarray(kwargs["vertices"])
        if faces.ndim == 2 and faces.shape[1] == 4:  # quads
            faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [2, 3, 0]]])
        colors = kwargs.get("vertex_colors")
        parts.append(
            MeshPart(
                positions,
                faces,
                _fitting(kwargs.get("vertex_normals"), positions),
                _fitting(getattr(kwargs.get("visual"), "uv", None), positions),
                None if colors is None or len(colors) != len(positions) else linear_colors(np.asarray(colors)),
                index,
            )
        )
    return join_parts(file, parts, groups)


def _fitting(values: Any, positions: NDArray[Any]) -> NDArray[Any] | None:
    """Return an attribute when there is one for each vertex; trimesh splits vertices at seams of the texture."""
    return None if values is None or len(values) != len(positions) else np.asarray(values)


def _check_ply_header(file: ModelFile, data: bytes) -> None:
    """Hold the counts of a PLY header against the size of what follows."""
    end = data.find(b"end_header")
    if data[:3].lower() != b"ply" or end < 0 or end > 1 << 20:
        raise file.error("does not begin as PLY files do", "export it again")
    header = data[:end].decode("ascii", "replace").splitlines()
    body = len(data) - end - len(b"end_header")
    is_ascii = any(line.split()[:2] == ["format", "ascii"] for line in header)
    elements: list[list[Any]] = []  # name, count, least bytes of one
    for line in header:
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdigit():
                raise file.error(
                    f"has a header line {line[:60]!r} that is not understood",
                    "such a line is: element, its name, and how many there are",
                )
            elements.append([words[1], int(words[2]), 0])
        elif words[:1] == ["property"] and elements:
            kind = words[2] if words[1:2] == ["list"] and len(words) > 2 else words[1] if len(words) > 1 else ""
            if kind not in _PLY_SIZES:
                raise file.error(
                    f"has a property of the unknown type {kind[:40]!r}",
                    f"the types are {', '.join(sorted(_PLY_SIZES))}",
                )
            elements[-1][2] += 2 if is_ascii else _PLY_SIZES[kind]
    least = sum(count * size for _, count, size in elements)
    if least > body + 2:  # the last line may end without a newline
        claimed = ", ".join(f"{count} of {name}" for name, count, _ in elements)
        raise file.error(
            f"says that it has {claimed}, which takes at least {least} bytes, and has {body}",
            "it was cut short or is damaged: export it again",
        )
