"""Parts of a model put into one mesh: checked, counted, and without what cannot be drawn."""

import numpy as np
import pytest
from loader_files import model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.mesh import MeshGroup, MeshPart, join_parts
from tracer.types import FACE_HAS_NORMALS, FACE_HAS_UVS

POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2]])


def part(positions=POSITIONS, faces=FACES, normals=None, uvs=None, colors=None, group=0):
    return MeshPart(np.array(positions, float), np.array(faces), normals, uvs, colors, group)


def join(tmp_path, *parts, limits=DEFAULT_LIMITS):
    groups = [MeshGroup((f"g{index}",)) for index in range(len(parts))]
    return join_parts(model_file(tmp_path, "a.obj", limits=limits), parts, groups)


def test_parts_keep_their_faces_and_groups(tmp_path):
    mesh = join(tmp_path, part(), part(POSITIONS + 5, group=1))
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert mesh.face_group.tolist() == [0, 1]
    assert mesh.positions[3].tolist() == [5, 5, 5]


def test_attributes_of_one_part_are_not_those_of_another(tmp_path):
    mesh = join(tmp_path, part(normals=np.array([[0, 0, 1.0]] * 3)), part(uvs=np.zeros((3, 2)), group=1))
    assert mesh.face_flags.tolist() == [FACE_HAS_NORMALS, FACE_HAS_UVS]
    assert (len(mesh.normals), len(mesh.uvs), mesh.colors) == (6, 6, None)


def test_what_cannot_be_drawn_is_left_out_and_told(tmp_path):
    positions = [*POSITIONS.tolist(), [np.nan, 0, 0], [1e31, 0, 0]]
    mesh = join(tmp_path, part(positions, [[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 1]]))
    assert len(mesh.faces) == 1
    assert np.isfinite(mesh.positions).all()
    assert [text.split(" ", 1)[0] for text in mesh.warnings] == ["2", "1"]
    assert "infinity or NaN" in mesh.warnings[0]
    assert "two corners at one place" in mesh.warnings[1]


def test_attributes_that_are_not_finite_are_not_used(tmp_path):
    normals = np.array([[0, 0, 1], [0, 0, 0], [0, 0, np.inf]])
    uvs = np.array([[0, 0], [1, 0], [np.nan, 0]])
    mesh = join(tmp_path, part(normals=normals, uvs=uvs, colors=np.array([[np.nan, 0, 0], [1, 1, 1], [0, 0, 0.0]])))
    assert mesh.face_flags[0] & (FACE_HAS_NORMALS | FACE_HAS_UVS) == 0
    assert mesh.colors[0].tolist() == [1, 1, 1]
    assert len(mesh.warnings) == 3


def test_attributes_of_another_length_are_ignored(tmp_path):
    mesh = join(tmp_path, part(normals=np.zeros((2, 3))))
    assert mesh.normals is None
    assert "normals are ignored" in mesh.warnings[0]


@pytest.mark.parametrize(
    ("parts", "reason", "mend"),
    [
        ([], "is empty", "at least one triangle"),
        ([part(faces=np.zeros((0, 3), int))], "is empty", "at least one triangle"),
        ([part(positions=[[0, 0, 0]] * 3)], "none of its triangles", "export it again"),
        ([part(faces=[[0, 1, 3]])], "vertex 3, and there are only 3", "export it again"),
        ([part(faces=[[0, -1, 2]])], "vertex -1", "export it again"),
        ([part(faces=[[0, 1]])], "do not come in threes", "export it again"),
        ([part(), part(), part()], "3 triangles and 9 vertices, more than", "simplify it"),
    ],
)
def test_what_is_wrong_with_a_whole_model_is_refused_with_a_mend(tmp_path, parts, reason, mend):
    with pytest.raises(LoadError) as caught:
        join(tmp_path, *parts, limits=DEFAULT_LIMITS._replace(faces=2))
    assert reason in caught.value.reason
    assert mend in caught.value.mend
