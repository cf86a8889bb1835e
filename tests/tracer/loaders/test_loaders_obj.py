"""OBJ and MTL: what every exporter writes, and what some of them should not."""

import numpy as np
import pytest
from loader_files import model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.obj import load_obj
from tracer.types import FACE_HAS_NORMALS, FACE_HAS_UVS

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _load(tmp_path, text, companions=None, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.obj", text, companions, limits)
    return load_obj(file, file.read())


def test_groups_objects_materials(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red paint\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    mesh = _load(
        tmp_path,
        f"mtllib a.mtl\n{_SQUARE}o Car\ng Door\nusemtl red paint\nf 1 2 3\ng Roof\nusemtl blue\nf 1 3 4\n"
        "g Door\nusemtl red paint\nf 1 2 4\n",
    )
    assert [group.names for group in mesh.groups] == [("Door", "Car", "red paint"), ("Roof", "Car", "blue")]
    assert mesh.face_group.tolist() == [0, 1, 0]
    assert [mesh.materials[group.material].kd for group in mesh.groups] == [(1, 0, 0), (0, 0, 1)]
    assert mesh.warnings == ()


def test_corners_with_the_same_three_indices_are_one_vertex(tmp_path):
    mesh = _load(
        tmp_path,
        _SQUARE + "vt 0 0\nvt 1 1\nvn 0 0 1\nvn 0 0 3\nf 1/1/1 2/1/1 3/1/1\nf 1/1/1 3/1/1 4/1/2\nf 1/2/1 2/1/1 3/1/1\n",
    )
    assert len(mesh.positions) == 5  # 1/1/1 is shared, 1/2/1 is one of its own
    assert np.array_equal(mesh.positions[mesh.faces][1], [[0, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert mesh.uvs[mesh.faces][2, 0].tolist() == [1, 1]
    assert mesh.normals[mesh.faces][1, 2].tolist() == [0, 0, 3]  # its length is kept
    assert (mesh.face_flags == FACE_HAS_NORMALS | FACE_HAS_UVS).all()


@pytest.mark.parametrize(
    ("line", "flags"),
    [
        ("f 1 2 3", 0),
        ("f 1/1 2/1 3/1", FACE_HAS_UVS),
        ("f 1//1 2//1 3//1", FACE_HAS_NORMALS),
        ("f 1/1/1 2/1/1 3/1/1", FACE_HAS_NORMALS | FACE_HAS_UVS),
        ("f 1// 2// 3//", 0),
        ("f 1/1/ 2/1/ 3/1/", FACE_HAS_UVS),
        ("f -4//-1 2//1 3//1", FACE_HAS_NORMALS),
        ("f 1 2/1 3/1/1", 0),
        ("f\t1   2 3  # comment", 0),
        ("f 1 2 \\\n3", 0),
    ],
)
def test_forms_of_a_face_line(tmp_path, line, flags):
    # A second face of another form checks that forms do not mix.
    mesh = _load(tmp_path, _SQUARE + f"vt 0 0\nvn 0 0 1\n{line}\nf 1/1/1 3/1/1 4/1/1\n")
    assert len(mesh.faces) == 2
    assert mesh.positions[mesh.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert mesh.face_flags.tolist() == [flags, FACE_HAS_NORMALS | FACE_HAS_UVS]
    assert mesh.warnings == ()


def test_relative_indices_count_from_their_line(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n")
    assert mesh.positions[mesh.faces][:, 0, 0].tolist() == [0, 5]


@pytest.mark.parametrize(
    ("face", "vertex"),
    [
        ("f 1 2 9", 9),
        ("f 0 1 2", 0),
        ("f -9 1 2", 0),
        ("f 1/1 2/1 99999999999/1", 99999999999),
        ("f 1 2/1 99999999999999999999", 2**62),
        ("f -99999999999999999999 1 2", 0),
    ],
)
def test_positions_that_are_not_there(tmp_path, face, vertex):
    with pytest.raises(LoadError, match=f"a.obj: line 5: a face uses vertex {vertex}, and there are 4"):
        _load(tmp_path, _SQUARE + face)


def test_uvs_and_normals_that_are_not_there_are_left_out(tmp_path):
    mesh = _load(tmp_path, _SQUARE + "vt 0 0\nf 1/1 2/1 3/7\nf 1/1 3/1 4/1\nf 1//5 3//5 4//5\n")
    assert sorted(mesh.face_flags.tolist()) == [0, 0, FACE_HAS_UVS]
    assert any("texture coordinates that are not there" in text for text in mesh.warnings)
    assert any("normals that are not there" in text for text in mesh.warnings)


def test_vertex_colours_are_taken_as_srgb(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0 1 0.5 0\nv 1 0 0 1 1 1\nv 0 1 0 nan 0 0\nf 1 2 3\n")
    assert np.allclose(mesh.colors, [[1, 0.21404114, 0], [1, 1, 1], [1, 1, 1]])
    assert "1 vertex colours are not finite" in mesh.warnings[0]
    mesh = _load(tmp_path, "v 0 0 0 255 0 0\nv 1 0 0 128 0 0\nv 0 1 0\nf 1 2 3\n")
    assert np.allclose(mesh.colors[:, 0], [1, 0.21586, 1], atol=1e-5)  # the third has none: white


def test_odd_vertex_lines(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0 1.0\nv 1 0 0\nv 0 1e0 -0.0e-3\nvt 0.5\nvt 1 2 3\nf 1/1 2/2 3/1\n")
    assert mesh.positions[mesh.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.uvs[mesh.faces[0]].tolist() == [[0.5, 0], [1, 2], [0.5, 0]]
    with pytest.raises(LoadError, match="fewer than three numbers"):
        _load(tmp_path, "v 0 0\nf 1 1 1\n")


@pytest.mark.parametrize("text", ["", "# nothing\n", "v 0 0 0\n", "v 0 0 0\nf 1 1 1\n", "v 0 0 0\nv 1 0 0\nl 1 2\n"])
def test_empty_models_are_refused(tmp_path, text):
    with pytest.raises(LoadError, match="empty"):
        _load(tmp_path, text)


def test_more_than_allowed_is_refused(tmp_path):
    limits = DEFAULT_LIMITS._replace(faces=1)
    with pytest.raises(LoadError, match="more than the 1"):
        _load(tmp_path, _SQUARE + "f 1 2 3 4\n", limits=limits)
    with pytest.raises(LoadError, match="more than the 1"):
        _load(tmp_path, _SQUARE + "f 1 2 3\nf 1 3 4\n", limits=limits)
    with pytest.raises(LoadError, match="bytes"):
        _load(tmp_path, _SQUARE, limits=DEFAULT_LIMITS._replace(file_bytes=10))
