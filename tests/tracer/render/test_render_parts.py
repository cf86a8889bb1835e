"""Which meshes share a tree, and which are parted."""

import numpy as np
import pytest
from compile_scenes import TRIANGLE, document, vertexdata

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import random_turn, rows_of
from tracer.accel import build_tree
from tracer.accel.wide import WideBvh
from tracer.render import parts
from tracer.render.compile import compile_scene
from tracer.scene import IDENTITY, SceneError
from tracer.types import (
    PLACED_AS_IS,
    PLACED_MIRRORED,
    PLACED_MOVED,
    PLACEMENT_END,
    PLACEMENT_FACE,
    PLACEMENT_FIRST,
    PLACEMENT_KIND,
    PLACEMENT_MATERIAL,
)


def record(mesh, rows=IDENTITY, material=0):
    """A mesh of one material."""
    vertices, faces = mesh
    flags = np.zeros(len(faces), np.uint8)
    own = np.full(len(faces), material, np.int32)
    return parts.MeshRecord(vertices, None, None, None, faces, flags, own, rows, "/objects/0")


@pytest.fixture
def _share_early(monkeypatch):
    monkeypatch.setattr(parts, "_SHARED_TRIANGLES", 20)
    monkeypatch.setattr(parts, "_SAVED_TRIANGLES", 40)


def n_in_trees(found):
    return [WideBvh(tree).n_triangles for tree in found.trees]


def test_near_meshes_of_like_size_are_one_tree_in_their_order():
    rng = np.random.default_rng(1)
    meshes = [record(icosphere(k % 3), rows_of(np.eye(3) * 2.0, rng.uniform(-9, 9, 3)), k) for k in range(6)]
    found = parts.build_parts(meshes, build_tree)
    assert len(found.trees) == len(found.placements) == 1
    assert found.placements[0].there is None
    assert found.saved_bytes == 0
    vertices = np.concatenate([2.0 * mesh.positions + np.array(mesh.rows)[:3, 3] for mesh in meshes])
    np.testing.assert_allclose(found.arrays["vertex_positions"], vertices, rtol=1e-15, atol=1e-14)
    assert found.arrays["face_material"].tolist() == [k for k, mesh in enumerate(meshes) for _ in mesh.faces]
    np.testing.assert_array_equal(
        found.trees[0], build_tree(found.arrays["vertex_positions"], found.arrays["face_vertices"])
    )


def test_no_mesh_at_all_is_one_empty_tree():
    found = parts.build_parts([], build_tree)
    assert n_in_trees(found) == [0]
    assert found.placements[0].n_faces == 0
    nothing = record((np.zeros((3, 3)), np.zeros((0, 3), np.int32)))
    assert n_in_trees(parts.build_parts([nothing, nothing], build_tree)) == [0]


@pytest.mark.usefixtures("_share_early")
def test_equal_meshes_share_a_tree():
    """By content, not by name; each choice of materials is stored once; the others come first."""
    rng = np.random.default_rng(2)
    ball = icosphere(1)
    copy = (ball[0].copy(), ball[1].copy())
    other = (ball[0] * 1.01, ball[1])
    meshes = [
        record(ball, rows_of(random_turn(rng), [3, 0, 0]), 1),
        record(other, rows_of(random_turn(rng), [-3, 0, 0]), 2),
        record(copy, IDENTITY, 3),
        record(ball, rows_of(np.diag([1.0, -1.0, 1.0]), [0, 5, 0]), 1),
        record(icosphere(0), IDENTITY, 4),
    ]
    found = parts.build_parts(meshes, build_tree)
    assert n_in_trees(found) == [100, 80]
    assert [placement.tree for placement in found.placements] == [0, 1, 1, 1]
    assert [placement.there is None for placement in found.placements] == [True, False, True, False]
    assert [placement.first_face for placement in found.placements] == [0, 100, 100, 100]
    assert [placement.first_material for placement in found.placements] == [0, 100, 180, 100]
    materials = found.arrays["face_material"]
    assert len(found.arrays["face_vertices"]) == 180
    assert materials.tolist() == [2] * 80 + [4] * 20 + [1] * 80 + [3] * 80
    np.testing.assert_array_equal(found.arrays["vertex_positions"][-42:], ball[0])
    n = found.trees[1].nbytes + 42 * (3 + 3 + 2 + 3) * 8 + 80 * (12 + 1)
    assert found.saved_bytes == 2 * n + 80 * 4


@pytest.mark.usefixtures("_share_early")
@pytest.mark.parametrize("what", ["too few", "too small", "skewed", "out of range"])
def test_what_does_not_pay_or_cannot_move_is_baked(what):
    mesh = (icosphere(0)[0], icosphere(0)[1][:10]) if what == "too small" else icosphere(0)
    n = 2 if what == "too few" else 4
    linear = np.eye(3)
    if what == "skewed":
        linear[0, 1] = 1e8
    if what == "out of range":
        linear *= 9e29
    meshes = [record(mesh, rows_of(linear, [k, 0, 0])) for k in range(n)]
    if what == "out of range":
        with pytest.raises(SceneError, match="range of coordinates"):
            parts.build_parts([mesh._replace(positions=mesh.positions * 2) for mesh in meshes], build_tree)
    else:
        found = parts.build_parts(meshes, build_tree)
        assert len(found.trees) == 1
        assert all(placement.there is None for placement in found.placements)


def test_far_meshes_are_parted():
    """Two groups 1e9 apart, and something small in a large room: each tree resolves its meshes."""
    ball = icosphere(2)
    meshes = [record(ball, rows_of(np.eye(3), [x, 0, 0])) for x in (0, 1e9, 5, 1e9 + 5)]
    found = parts.build_parts(meshes, build_tree)
    assert n_in_trees(found) == [640, 640]
    np.testing.assert_array_equal(found.arrays["vertex_positions"][162:324, 0], ball[0][:, 0] + 5)
    room = record((ball[0] * 1e8, ball[1]))
    found = parts.build_parts([record(ball), room, record(ball, rows_of(np.eye(3), [3, 0, 0]))], build_tree)
    assert n_in_trees(found) == [640, 320]
    # evenly strewn, no gap and nothing large: parted by place until each is resolved
    meshes = [record(ball, rows_of(np.eye(3), [1e6 * k, 0, 0])) for k in range(64)]
    found = parts.build_parts(meshes, build_tree)
    assert len(found.trees) > 1
    for placement in found.placements:
        extent = (placement.bounds[3:] - placement.bounds[:3]).max()
        assert extent <= 2.0**18 * 2.0 / np.sqrt(320) or placement.n_faces == 320
    assert sum(n_in_trees(found)) == 64 * 320


def test_points_and_empty_meshes_part_nothing():
    point = (np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    nothing = (np.full((3, 3), 1e20), np.zeros((0, 3), np.int32))
    found = parts.build_parts([record(nothing), record(icosphere(2)), record(point)], build_tree)
    assert len(found.placements) == 1
    assert found.placements[0].n_faces == 321
    assert len(found.arrays["vertex_positions"]) == 3 + 162 + 3


@pytest.mark.usefixtures("_share_early")
def test_a_document_with_placements(tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "_SHARED_TRIANGLES", 2)
    monkeypatch.setattr(parts, "_SAVED_TRIANGLES", 2)
    asset = {"type": "mesh_asset", "asset": "m"}
    mirror = [{"type": "scale", "by": [1, 1, -1]}, {"type": "translate", "by": [0, 0, 3]}]
    scene, stats = compile_scene(
        document(
            {**asset, "transform": mirror, "materials": {"Roof": "a"}},
            TRIANGLE,
            {**asset, "transform": [{"type": "scale", "by": 2}]},
            asset,
            {**asset, "normals": "flat"},
            assets={"m": vertexdata(tmp_path)},
            materials={"a": {}},
        ),
        lambda ref: tmp_path / ref.file,
    )
    assert (stats.n_triangles, stats.n_trees, stats.n_placements) == (9, 2, 4)
    assert stats.n_bytes_saved > 0
    table = scene.placements
    assert table[:, PLACEMENT_KIND].tolist() == [PLACED_AS_IS, PLACED_MIRRORED, PLACED_MOVED, PLACED_AS_IS]
    assert table[:, PLACEMENT_FIRST].tolist() == [0, 3, 5, 7]  # a triangle and a flat mesh are baked
    assert table[:, PLACEMENT_END].tolist() == [3, 5, 7, 9]
    assert table[:, PLACEMENT_FACE].tolist() == [0, 3, 3, 3]
    assert table[:, PLACEMENT_MATERIAL].tolist() == [0, 3, 5, 5]
    assert scene.face_material.tolist() == [0, 0, 0, 0, 1, 0, 0]
    assert len(scene.face_vertices) == 5
