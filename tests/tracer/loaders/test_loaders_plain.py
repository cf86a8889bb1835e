"""PLY, STL, OFF and the vertex-data JSON."""

import struct

import numpy as np
import pytest
from loader_files import TRIANGLE, model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.load import load_mesh
from tracer.types import FACE_HAS_NORMALS, FACE_HAS_UVS


def _load(tmp_path, name, content):
    return load_mesh(model_file(tmp_path, name, content))


# --- PLY --------------------------------------------------------------------------------------------------------------

_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{more}element face {n}
property list uchar int vertex_indices
end_header
"""


def test_ply_triangles_and_quads(tmp_path):
    vertices = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    mesh = _load(tmp_path, "a.ply", _PLY.format(more="", n=1) + vertices + "4 0 1 2 3\n")
    assert len(mesh.faces) == 2
    mesh = _load(tmp_path, "a.ply", _PLY.format(more="", n=2) + vertices + "4 0 1 2 3\n3 0 1 2\n")
    assert len(mesh.faces) == 3
    corners = mesh.positions[mesh.faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def test_ply_colours_are_srgb(tmp_path):
    more = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    vertices = "0 0 0 255 0 0\n1 0 0 128 0 0\n1 1 0 0 0 0\n0 1 0 0 0 0\n"
    mesh = _load(tmp_path, "a.ply", _PLY.format(more=more, n=1) + vertices + "3 0 1 2\n")
    assert np.allclose(mesh.colors[:3, 0], [1, 0.2158605, 0], atol=1e-6)


def test_ply_normals_and_uvs(tmp_path):
    more = "property float nx\nproperty float ny\nproperty float nz\nproperty float s\nproperty float t\n"
    vertices = "0 0 0 0 0 2 0 0\n1 0 0 0 0 1 1 0\n1 1 0 0 0 1 1 1\n0 1 0 0 0 1 0 1\n"
    mesh = _load(tmp_path, "a.ply", _PLY.format(more=more, n=2) + vertices + "3 0 1 2\n3 0 2 3\n")
    assert mesh.face_flags.tolist() == [FACE_HAS_NORMALS | FACE_HAS_UVS] * 2
    places = mesh.positions[mesh.faces].reshape(-1, 3)
    assert np.allclose(mesh.uvs[mesh.faces].reshape(-1, 2), places[:, :2])
    assert mesh.normals.max() == 2


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (
            "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
            "at least",
        ),
        ("ply\nformat ascii 1.0\nelement vertex 1000\nproperty float x\nend_header\n1\n2\n", "at least 2000 bytes"),
        ("ply\nformat ascii 1.0\nelement vertex x\nend_header\n", "not understood"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty quux x\nend_header\n1 2\n", "unknown type"),
        (_PLY.format(more="", n=0) + "0 0 0\n" * 4, "no faces"),
        ("plyformat", "does not begin"),
        (_PLY.format(more="", n=1) + "0 0 0\n" * 4 + "3 0 1 7\n", "vertex 7"),
        (_PLY.format(more="", n=1) + "0 0 0\n" * 4 + "3 0 1 -1\n", "vertex -1"),
    ],
)
def test_ply_that_lies(tmp_path, content, reason):
    with pytest.raises(LoadError, match=reason):
        _load(tmp_path, "a.ply", content)


# --- STL --------------------------------------------------------------------------------------------------------------


def _binary_stl(n=1, header=b""):
    record = struct.pack("<12fH", 0, 0, 1, *TRIANGLE.ravel(), 0)
    return header.ljust(80, b" ") + struct.pack("<I", n) + record * n


@pytest.mark.parametrize("header", [b"", b"solid that is binary all the same"])
def test_binary_stl(tmp_path, header):
    mesh = _load(tmp_path, "A.STL", _binary_stl(2, header))
    assert mesh.positions[mesh.faces].tolist() == [TRIANGLE.tolist()] * 2
    assert mesh.normals is None


def test_ascii_stl_has_its_solids_as_groups(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    mesh = _load(tmp_path, "a.stl", f"solid left\n{facet}endsolid left\nsolid right\n{facet}{facet}endsolid right\n")
    assert [group.names for group in mesh.groups] == [("left",), ("right",)]
    assert mesh.face_group.tolist() == [0, 1, 1]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (_binary_stl(1)[:-50] + b"", "room for 0"),
        (b" " * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 50, "says that it has 4000000000 triangles"),
        (b" " * 80 + struct.pack("<I", 0), "empty"),
        (b"solid nothing\nendsolid nothing\n", "empty"),
        (b"\x89PNG", "too short"),
    ],
)
def test_stl_that_lies(tmp_path, content, reason):
    with pytest.raises(LoadError, match=reason):
        _load(tmp_path, "a.stl", content)


# --- OFF --------------------------------------------------------------------------------------------------------------


def test_off(tmp_path):
    mesh = _load(tmp_path, "a.off", "OFF\n# a square\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n")
    assert len(mesh.faces) == 2


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("OFF\n99999999999 1 0\n0 0 0\n", "can hold"),
        ("OFF\n-1 2 0\n", "can hold"),
        ("NOFF\n", "begin"),
        ("OFF x y z", "counts"),
    ],
)
def test_off_that_lies(tmp_path, content, reason):
    with pytest.raises(LoadError, match=reason):
        _load(tmp_path, "a.off", content)
