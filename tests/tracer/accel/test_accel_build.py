"""The hierarchy's invariants, on ordinary and on hostile input."""

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere, scene_of
from tracer.accel import build_bvh
from tracer.accel.build import MAX_DEPTH, MAX_LEAF, shape_bounds
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_DISK, SHAPE_SPHERE


def build(vertices, faces):
    none = np.zeros((0, 3, 3))
    return build_bvh(np.asarray(vertices, float), np.asarray(faces, np.int32), np.zeros(0, np.int32), none[:, 0], none)


def check(bvh, vertices, faces):
    """Every primitive in one leaf, every box exactly around what is below it; returns the depth."""
    corners = np.asarray(vertices)[np.asarray(faces)]
    low, high = corners.min(axis=1), corners.max(axis=1)
    seen, deepest = [], 0
    pending = [(0, 1)]
    while pending:
        node, depth = pending.pop()
        deepest = max(deepest, depth)
        for child in range(2):
            index, count = bvh.bvh_children[node, 2 * child : 2 * child + 2]
            box = bvh.bvh_bounds[node].reshape(3, 2, 2)[:, :, child]
            if count < 0:
                assert (box[:, 0] > box[:, 1]).all()
                continue
            if count > 0:
                ids = bvh.bvh_slots[index : index + count]
                assert count <= MAX_LEAF
                assert (np.diff(ids) > 0).all()
                seen += ids.tolist()
                below_low, below_high = low[ids].min(axis=0), high[ids].max(axis=0)
            else:
                boxes = bvh.bvh_bounds[index].reshape(3, 2, 2)
                below_low, below_high = boxes[:, 0].min(axis=1), boxes[:, 1].max(axis=1)
                pending.append((int(index), depth + 1))
            np.testing.assert_array_equal(box, np.stack([below_low, below_high], axis=1))
    assert sorted(seen) == list(range(len(faces)))
    return deepest


def test_sphere():
    vertices, faces = icosphere(4)
    bvh = build(vertices, faces)
    assert check(bvh, vertices, faces) < 25
    np.testing.assert_array_equal(bvh.bvh_root, [vertices.min(axis=0), vertices.max(axis=0)])


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_few(n):
    vertices = np.random.default_rng(n).random((3 * n + 1, 3))
    faces = np.arange(3 * n).reshape(n, 3)
    bvh = build(vertices, faces)
    check(bvh, vertices, faces)
    assert np.isinf(bvh.bvh_root).all() == (n == 0)


def test_identical_triangles_end():
    """100,000 times the same: no centroid differs, ranges are halved."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    faces = np.tile(np.arange(3), (100_000, 1))
    assert check(build(vertices, faces), vertices, faces) <= 17


def test_geometric_series_stays_shallow_enough():
    """Centroids at 2^-k: each binned split takes off one; the depth limit must hold."""
    x = 2.0 ** -np.arange(0, 900, 0.05)
    vertices = np.zeros((3 * len(x), 3))
    vertices[:, 0] = np.repeat(x, 3)
    vertices[1::3, 1] = vertices[:, 0][1::3]
    vertices[2::3, 2] = vertices[:, 0][2::3]
    faces = np.arange(len(vertices)).reshape(-1, 3)
    depth = check(build(vertices, faces), vertices, faces)
    assert 20 < depth <= MAX_DEPTH


def test_slots_hold_sorted_vertices_and_their_corners():
    rng = np.random.default_rng(3)
    vertices = rng.integers(0, 3, (40, 3)).astype(float)
    faces = rng.integers(0, 40, (100, 3)).astype(np.int32)
    bvh = build(vertices, faces)
    for slot, face in enumerate(bvh.bvh_slots):
        corners = bvh.bvh_corners[slot]
        assert sorted(corners) == [0, 1, 2]
        rows = vertices[faces[face][corners]]
        np.testing.assert_array_equal(bvh.bvh_vertices[slot].reshape(3, 3), rows)
        assert rows.tolist() == sorted(rows.tolist())


def test_result_depends_on_the_input_alone():
    vertices, faces = icosphere(3)
    for a, b in zip(build(vertices, faces), build(vertices.copy(), faces.copy()), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("fault", ["nan", "inf", "index", "negative"])
def test_faults_are_refused(fault):
    vertices = np.random.default_rng(0).random((6, 3))
    faces = np.arange(6).reshape(2, 3)
    if fault in {"nan", "inf"}:
        vertices[4, 1] = float(fault)
    else:
        faces[1, 1] = 6 if fault == "index" else -1
    with pytest.raises(ValueError, match="finite" if fault in {"nan", "inf"} else "does not exist"):
        build(vertices, faces)


@pytest.mark.parametrize("kind", [SHAPE_SPHERE, SHAPE_BOX, SHAPE_DISK, SHAPE_CYLINDER_CAPPED])
def test_shape_bounds_are_tight(kind):
    """Against a million points of the surface."""
    rng = np.random.default_rng(kind)
    matrix, origin = rng.standard_normal((3, 3)), rng.standard_normal(3)
    p = rng.standard_normal((100_000, 3))
    if kind == SHAPE_SPHERE:
        p /= np.linalg.norm(p, axis=1)[:, None]
    elif kind == SHAPE_BOX:
        p = np.sign(p)
    else:
        p[:, :2] /= np.linalg.norm(p[:, :2], axis=1)[:, None]
        p[:, 2] = 0 if kind == SHAPE_DISK else p[:, 2] > 0
    world = origin + p @ matrix.T
    bounds = shape_bounds(np.array([kind]), origin[None], matrix[None])[0]
    assert (world.min(axis=0) >= bounds[:3] - 1e-12).all()
    assert (world.max(axis=0) <= bounds[3:] + 1e-12).all()
    assert world.min(axis=0) == pytest.approx(bounds[:3], abs=0.01)
    assert world.max(axis=0) == pytest.approx(bounds[3:], abs=0.01)


def test_one_shape_among_triangles():
    vertices, faces = icosphere(1)
    scene = scene_of(vertices, faces, spheres=[((5.0, 0.0, 0.0), 1.0)])
    assert scene.bvh_root[1, 0] == 6.0
    assert len(faces) in scene.bvh_slots
