"""Faces that are left out, no mesh at all, rays that are none (N6, one by one), and directions of extreme lengths."""

import numpy as np
import pytest

from tests.numerics.closed_meshes import sphere
from tracer.rays import RayCaster


def test_unusable_faces_are_left_out():
    vertices, faces = sphere(6, 6)
    spoiled = np.concatenate([vertices, [[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -1e200]]])
    n = len(vertices)
    extra = np.array([[0, 1, n], [n + 1, 2, 3], [4, n + 2, 5]], np.int32)
    caster = RayCaster(spoiled, np.concatenate([extra, faces]))
    assert caster.bvh.n_triangles == len(faces)
    rng = np.random.default_rng(32)
    origins, directions = rng.normal(size=(200, 3)) * 0.3, rng.normal(size=(200, 3))
    clean = RayCaster(vertices, faces).closest_hit(origins, directions)
    hits = caster.closest_hit(origins, directions)
    np.testing.assert_array_equal(hits.primitive, clean.primitive + 3)
    np.testing.assert_array_equal(hits.t, clean.t)


def test_a_far_vertex_that_no_face_uses_costs_no_precision():
    vertices, faces = sphere(6, 6)
    caster = RayCaster(np.concatenate([vertices, [[1e30, 0, 0]]]), faces)
    rng = np.random.default_rng(33)
    origins, directions = rng.normal(size=(200, 3)) * 0.3, rng.normal(size=(200, 3))
    np.testing.assert_array_equal(
        caster.closest_hit(origins, directions).t, RayCaster(vertices, faces).closest_hit(origins, directions).t
    )


def test_no_mesh_at_all():
    caster = RayCaster(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    assert caster.closest_hit([[0, 0, 0]], [[0, 0, 1]]).primitive.tolist() == [-1]
    assert caster.count_hits([[0, 0, 0]], [[0, 0, 1]]).tolist() == [0]
    assert RayCaster([[0, 0, 0]], np.array([[0, 0, 0]])).any_hit([[0, 0, -1]], [[0, 0, 1]]).tolist() == [False]


INF, NAN = np.inf, np.nan


@pytest.mark.parametrize(
    ("origin", "direction", "tmin", "tmax"),
    [
        ((NAN, 0, 0), (0, 0, 1), 0, INF),
        ((INF, 0, 0), (0, 0, 1), 0, INF),
        ((0, 1e101, 0), (0, -1, 0), 0, INF),
        ((0, 0, 0), (NAN, 0, 1), 0, INF),
        ((0, 0, 0), (0, INF, 1), 0, INF),
        ((0, 0, 0), (0, 0, 0), 0, INF),
        ((0, 0, 0), (-0.0, 0, 0), 0, INF),
        ((0, 0, 0), (0, 0, 1), 2, 1),
        ((0, 0, 0), (0, 0, 1), 1, 1),
        ((0, 0, 0), (0, 0, 1), NAN, INF),
        ((0, 0, 0), (0, 0, 1), 0, NAN),
        ((0, 0, 0), (0, 0, 1), INF, INF),
        ((0, 0, 0), (0, 0, 1), 0, -1),
        ((0, 0, 0), (0, 0, 1), -5, 0),
    ],
)
def test_what_is_no_ray_misses(origin, direction, tmin, tmax):
    """N6."""
    caster = RayCaster(*sphere(6, 6))
    ray = np.array([origin], float), np.array([direction], float)
    hits = caster.closest_hit(*ray, tmin, tmax)
    assert [float(column[0]) for column in hits] == [INF, -1, 0, 0]
    assert not caster.any_hit(*ray, tmin, tmax)[0]
    assert caster.count_hits(*ray, tmin, tmax)[0] == 0


def test_extreme_lengths_of_direction():
    """The same points are hit whatever the direction's length; a t beyond float64 is a miss."""
    vertices, faces = sphere(6, 6)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(35)
    origins, directions = rng.normal(size=(100, 3)) * 0.1, rng.normal(size=(100, 3))
    reference = caster.closest_hit(origins, directions)
    for k in (-900, -300, 300, 1000):
        hits = caster.closest_hit(origins, directions * 2.0**k)
        np.testing.assert_array_equal(hits.primitive, reference.primitive)
        np.testing.assert_allclose(hits.t * 2.0**k, reference.t, rtol=1e-15)
    assert (caster.closest_hit(origins, directions * 1e-310).primitive == -1).all()
    assert caster.any_hit(origins, np.sign(directions) * 1e308).all()


def test_negative_tmin_counts_as_zero():
    vertices, faces = sphere(6, 6)
    caster = RayCaster(vertices, faces)
    counts = caster.count_hits([[0.1, 0.2, 0.3]], [[0.3, 0.2, 1.0]], -100.0)
    assert counts.tolist() == caster.count_hits([[0.1, 0.2, 0.3]], [[0.3, 0.2, 1.0]]).tolist()
