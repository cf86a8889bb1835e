"""The vertex-data JSON format of the seed's models.

One object: `vertexdata`, a flat list of numbers, eight to a vertex (x y z nx ny nz u v, v upwards); `indexdata`, a flat
list of vertex numbers, three to a triangle; `groups`, name to [first, end) in triangles. Source: the seed's page
(`seed/README.md` in the data folder), which also tells where the original's loader misread it.
"""

import json
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.errors import LoadError
from tracer.loaders.files import ModelFile
from tracer.loaders.mesh import MeshData, MeshGroup, MeshPart, join_parts

STRIDE: Final = 8
_FORM: Final = "a mesh file in JSON is an object with vertexdata, indexdata and groups"


def load_vertexdata(file: ModelFile, data: bytes) -> MeshData:
    """Read a model.

    Raises
    ------
    LoadError
        When the text is not of this format.
    """
    try:
        document = json.loads(data)
    except (ValueError, RecursionError, MemoryError) as error:
        raise file.error(f"is not JSON ({str(error)[:100]})", _FORM) from None
    if not isinstance(document, dict) or not {"vertexdata", "indexdata"} <= set(document):
        raise file.error("is JSON without vertexdata and indexdata", _FORM)
    vertices = _numbers(file, "vertexdata", document["vertexdata"], STRIDE, float)
    indices = _numbers(file, "indexdata", document["indexdata"], 3, int)
    groups, face_group = _groups(file, document.get("groups", {}), len(indices))
    part = MeshPart(vertices[:, 0:3], indices, vertices[:, 3:6], vertices[:, 6:8], None, face_group)
    return join_parts(file, [part], groups)


def _numbers(file: ModelFile, key: str, values: Any, width: int, kind: type) -> NDArray[Any]:
    """Return a flat list of numbers as rows."""
    what = "vertex numbers, three to a triangle" if kind is int else "numbers, eight to a vertex: x y z nx ny nz u v"
    expected = f"{key} is a flat list of {what}"
    if not isinstance(values, list):
        raise file.error(f"has {key} that is not a list of numbers", expected)
    kinds = set(map(type, values))
    if not kinds <= ({int} if kind is int else {int, float}):
        raise file.error(f"has something else than {'whole numbers' if kind is int else 'numbers'} in {key}", expected)
    if len(values) % width:
        raise file.error(f"has {len(values)} numbers in {key}, not a multiple of {width}", expected)
    try:
        return np.array(values, dtype=np.int64 if kind is int else np.float64).reshape(-1, width)
    except OverflowError:
        raise file.error(f"has a number in {key} that is too large", "numbers are those of float64 or int64") from None


def _groups(file: ModelFile, values: Any, n_faces: int) -> tuple[list[MeshGroup], NDArray[np.int32]]:
    """Return the groups and each triangle's group; triangles in none get a group without a name."""
    if not isinstance(values, dict):
        raise file.error(
            "has groups that are not an object", "groups is an object of name to [first, end), in triangles"
        )
    face_group = np.full(n_faces, -1, np.int32)
    groups: list[MeshGroup] = []
    for name, value in values.items():
        if (
            not isinstance(value, list)
            or len(value) != 2
            or not all(type(bound) is int for bound in value)
            or not 0 <= value[0] <= value[1] <= n_faces
        ):
            raise _group_error(file, name, value, n_faces)
        if (face_group[value[0] : value[1]] >= 0).any():
            raise file.error(f"has a group {name!r} that overlaps another", "a triangle belongs to at most one group")
        face_group[value[0] : value[1]] = len(groups)
        groups.append(MeshGroup((name,)))
    if (face_group < 0).any():
        face_group[face_group < 0] = len(groups)
        groups.append(MeshGroup(()))
    return groups, face_group


def _group_error(file: ModelFile, name: str, value: Any, n_faces: int) -> LoadError:
    """Return the error of a group whose range is wrong."""
    return file.error(
        f"has a group {name!r} of {str(value)[:60]}",
        f"a group is [first, end) in triangles, within 0 and {n_faces}",
    )
