"""The vertex-data JSON of the seed's models."""

import json

import numpy as np
import pytest
from loader_files import TRIANGLE, data_folder, model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.files import ModelFile
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.load import load_mesh


def _load(tmp_path, name, content):
    return load_mesh(model_file(tmp_path, name, content))


def _vertexdata(**changes):
    vertices = [number for x, y, z in TRIANGLE.tolist() for number in (x, y, z, 0, 0, 2, x, y)]
    document = {
        "vertexdata": vertices,
        "indexdata": [0, 1, 2, 2, 1, 0],
        "groups": {"Front": [0, 1], "Back": [1, 2]},
    }
    return json.dumps({**document, **changes})


def test_vertexdata(tmp_path):
    mesh = _load(tmp_path, "a.json", _vertexdata())
    assert mesh.positions.tolist() == TRIANGLE.tolist()
    assert mesh.normals.tolist() == [[0, 0, 2]] * 3  # not made unit: they are normalised after interpolation
    assert mesh.uvs.tolist() == TRIANGLE[:, :2].tolist()
    assert [group.names for group in mesh.groups] == [("Front",), ("Back",)]
    assert mesh.face_group.tolist() == [0, 1]


def test_triangles_outside_all_groups(tmp_path):
    mesh = _load(tmp_path, "a.json", _vertexdata(groups={"Back": [1, 2]}))
    assert [mesh.groups[index].names for index in mesh.face_group] == [(), ("Back",)]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "without vertexdata"),
        (_vertexdata(vertexdata=[1, 2, 3]), "not a multiple of 8"),
        (_vertexdata(vertexdata="x"), "not a list"),
        (_vertexdata(vertexdata=[[0] * 8] * 8), "something else than numbers"),
        (_vertexdata(vertexdata=[True] * 24), "something else than numbers"),
        (_vertexdata(vertexdata=[10**400] * 24), "too large"),
        (_vertexdata(indexdata=[0, 1, 3], groups={}), "vertex 3"),
        (_vertexdata(indexdata=[0, 1, -1], groups={}), "vertex -1"),
        (_vertexdata(indexdata=[0.0, 1.0, 2.0]), "whole numbers"),
        (_vertexdata(indexdata=[10**30, 1, 2]), "too large"),
        (_vertexdata(indexdata=[], groups={}), "empty"),
        (_vertexdata(groups={"Front": [0, 3]}), r"group 'Front' of \[0, 3\]"),
        (_vertexdata(groups={"Front": [0, 2], "Back": [1, 2]}), "overlaps"),
        (_vertexdata(groups=[1]), "not an object"),
        (_vertexdata().replace("[0.0, 0.0, 0.0", "[NaN, 0.0, 0.0"), "empty: none of its triangles"),
    ],
)
def test_vertexdata_that_lies(tmp_path, content, reason):
    with pytest.raises(LoadError, match=reason):
        _load(tmp_path, "a.json", content)


def test_the_mini():
    folder = data_folder("seed")
    mesh = load_mesh(ModelFile(folder / "mini_geometry.json", "mini_geometry.json", None, DEFAULT_LIMITS))
    assert (len(mesh.faces), len(mesh.positions), len(mesh.groups)) == (4511, 3966, 32)
    assert np.allclose(mesh.positions.min(axis=0), [-96.684, -179.499, -1.551], atol=1e-3)
    assert np.allclose(mesh.positions.max(axis=0), [96.684, 180.660, 162.657], atol=1e-3)
    assert np.bincount(mesh.face_group)[0] == 881  # Body
    corners = mesh.positions[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agree = (normals * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=1) > 0
    assert agree.sum() == 4510
    area = 0.5 * np.sqrt((normals**2).sum(axis=1)).sum()
    assert area == pytest.approx(357_193, abs=1)
