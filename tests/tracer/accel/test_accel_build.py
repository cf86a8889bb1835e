"""The hierarchy's invariants, on ordinary and on hostile input."""

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere, scene_of
from tracer.accel import build_bvh
from tracer.accel.build import MAX_DEPTH, MAX_LEAF, shape_bounds
from tracer.accel.wide import WideBvh, build_wide
from tracer.rays import RayCaster
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_DISK, SHAPE_SPHERE


def build(vertices, faces):
    """The hierarchies of triangles alone."""
    none = np.zeros((0, 3, 3))
    return build_bvh(np.asarray(vertices, float), np.asarray(faces, np.int32), np.zeros(0, np.int32), none[:, 0], none)


def build_spheres(centres, radii):
    """The hierarchies of spheres alone, and the bounds (n, 6) that the tree is built of."""
    matrices = np.eye(3) * np.asarray(radii, float).reshape(-1, 1, 1)
    kinds = np.full(len(centres), SHAPE_SPHERE, np.int32)
    centres = np.asarray(centres, float).reshape(-1, 3)
    bvh = build_bvh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), kinds, centres, matrices)
    return bvh, shape_bounds(kinds, centres, matrices)


def check(bvh, bounds):
    """Every shape in one leaf, every box exactly around what is below it; returns the depth."""
    low, high = bounds[:, :3], bounds[:, 3:]
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
    assert sorted(seen) == list(range(len(bounds)))
    return deepest


def test_many_spheres():
    rng = np.random.default_rng(2)
    bvh, bounds = build_spheres(rng.standard_normal((3000, 3)), 10.0 ** rng.uniform(-4, 0, 3000))
    assert check(bvh, bounds) < 25
    np.testing.assert_array_equal(bvh.bvh_root, [bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])
    assert RayCaster.from_bvh(WideBvh(bvh.trees)).any_hit([[9.0, 0, 0]], [[-1.0, 0, 0]]).tolist() == [False]


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_few(n):
    bvh, bounds = build_spheres(np.random.default_rng(n).random((n, 3)), np.ones(n))
    check(bvh, bounds)
    assert np.isinf(bvh.bvh_root).all() == (n == 0)


def test_identical_spheres_end():
    """Twenty thousand times the same: no centroid differs, ranges are halved."""
    assert check(*build_spheres(np.tile([1.0, 2.0, 3.0], (20_000, 1)), np.ones(20_000))) <= 15


def test_geometric_series_stays_shallow_enough():
    """Centroids at 2^-k: each binned split takes off one; the depth limit must hold."""
    x = 2.0 ** -np.arange(0, 900, 0.05)
    centres = np.zeros((len(x), 3))
    centres[:, 0] = x
    assert 20 < check(*build_spheres(centres, x / 3)) <= MAX_DEPTH


def test_triangles_have_the_wide_tree():
    """The same buffer as the caster's, and bounds of all primitives."""
    vertices, faces = icosphere(3)
    bvh = build(vertices, faces)
    np.testing.assert_array_equal(bvh.trees, build_wide(vertices, faces).buffer)
    np.testing.assert_array_equal(bvh.bvh_root, [vertices.min(axis=0), vertices.max(axis=0)])
    assert len(bvh.bvh_slots) == 0


def test_result_depends_on_the_input_alone():
    vertices, faces = icosphere(3)
    rng = np.random.default_rng(4)
    spheres = rng.standard_normal((500, 3)), rng.random(500)
    for a, b in zip(build(vertices, faces), build(vertices.copy(), faces.copy()), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(build_spheres(*spheres)[0], build_spheres(*spheres)[0], strict=True):
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
    assert scene.bvh_slots.tolist() == [0]
