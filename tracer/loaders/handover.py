"""How arrays leave the guarded process: one array file for each mesh or image.

Invariant: what is read back has the shapes and types of `MeshData`; a broken hand-over is an error, never wrong arrays.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.arrayfile import ArrayFileError, load_arrays, save_arrays
from tracer.loaders.mesh import FileMaterial, MeshData, MeshGroup, MeshUse

_OPTIONAL = ("normals", "uvs", "colors")
_REQUIRED = ("positions", "faces", "face_flags", "face_group")


def save_mesh(path: Path, mesh: MeshData, *, durable: bool = False) -> None:
    """Write a mesh into one file."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(mesh, name) for name in _REQUIRED}
    arrays |= {name: getattr(mesh, name) for name in _OPTIONAL if getattr(mesh, name) is not None}
    arrays |= {f"image{index}": image for index, image in enumerate(mesh.images)}
    meta = {
        "groups": [[list(group.names), group.material] for group in mesh.groups],
        "materials": [material._asdict() for material in mesh.materials],
        "n_images": len(mesh.images),
        "warnings": list(mesh.warnings),
        "uses": [list(use) for use in mesh.uses],
    }
    save_arrays(path, arrays, meta, durable=durable)


def open_mesh(path: Path) -> MeshData:
    """Map a mesh that `save_mesh` wrote.

    Raises
    ------
    ArrayFileError
        When the file is damaged.
    """
    arrays, meta = load_arrays(path)
    try:
        fields: dict[str, Any] = {name: arrays[name] for name in _REQUIRED}
        fields |= {name: arrays.get(name) for name in _OPTIONAL}
        return MeshData(
            **fields,
            groups=tuple(MeshGroup(tuple(names), material) for names, material in meta["groups"]),
            materials=tuple(_material(row) for row in meta["materials"]),
            images=tuple(arrays[f"image{index}"] for index in range(meta["n_images"])),
            warnings=tuple(meta["warnings"]),
            uses=tuple(_use(*row) for row in meta["uses"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ArrayFileError(f"{path.name} is not a mesh: {error}") from error


def _use(vertices: list[int], faces: list[int], groups: list[int], rows: list[list[float]]) -> MeshUse:
    """Return a use from its JSON form, in which tuples are lists."""
    (v0, v1), (f0, f1), (g0, g1) = vertices, faces, groups
    a, b, c, d = ((x, y, z, w) for x, y, z, w in rows)
    return MeshUse((v0, v1), (f0, f1), (g0, g1), (a, b, c, d))


def _material(row: dict[str, Any]) -> FileMaterial:
    """Return a material from its JSON form, in which colours are lists."""
    fields: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
    return FileMaterial(**fields)


def save_image(path: Path, image: NDArray[np.uint8], *, durable: bool = False) -> None:
    """Write an image into one file."""
    save_arrays(path, {"image": image}, {}, durable=durable)


def open_image(path: Path) -> NDArray[np.uint8]:
    """Map an image that `save_image` wrote."""
    arrays, _ = load_arrays(path)
    return arrays["image"]
