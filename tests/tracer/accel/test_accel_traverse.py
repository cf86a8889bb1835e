"""Whole scenes, triangles and shapes together, against brute force and topology: bit-equal hits, no misses."""

import math

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere, scene_of, trace_brute
from tests.tracer.rays.packets import brute_light, find_closest, find_light


def aimed_rays(vertices, faces, rng, n):
    """From inside: at random, at vertices, at points of edges, at midpoints of edges."""
    center, size = vertices.mean(axis=0), np.ptp(vertices, axis=0).max()
    origins = center + 0.1 * size * rng.uniform(-1, 1, (n, 3))
    which = faces[rng.integers(0, len(faces), n)]
    a, b, c = (vertices[which[:, k]] for k in range(3))
    s = rng.random((n, 1))
    targets = [a, (a + b) / 2, a + s * (b - a), (a + b + c) / 3]
    targets = np.choose(rng.integers(0, 4, (n, 1)), targets)
    return origins, np.ascontiguousarray(targets - origins)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1.5e5, 1e7])
def test_closed_mesh_has_no_leaks(scale, offset):
    """N1: 0 misses, odd crossing counts, the hierarchy equal to brute force bit for bit."""
    rng = np.random.default_rng(7)
    vertices, faces = icosphere(2, rng, 0.1)
    vertices = (vertices + offset * np.array([1.0, -0.7, 0.3])) * scale
    scene = scene_of(vertices, faces)
    origins, directions = aimed_rays(vertices, faces, rng, 8000)
    n_hits, t, primitive = trace_brute(scene, origins, directions)
    assert (n_hits % 2 == 1).all()
    hits = find_closest(scene, origins, directions)
    np.testing.assert_array_equal(hits.t, t)
    np.testing.assert_array_equal(hits.primitive, primitive)
    blocked = find_light(scene, origins, directions)
    assert not blocked.any()


def test_axis_aligned_rays_in_face_planes_of_a_grid():
    """A closed box of many coplanar triangles: axis-aligned rays through its grid points, from inside."""
    n = 4
    grid = np.arange(n + 1) / n
    vertices, faces = [], []
    for axis in range(3):
        for side in (0.0, 1.0):
            start = len(vertices)
            vertices += [np.roll([x, y, side], axis) for x in grid for y in grid]
            for i in range(n):
                for j in range(n):
                    k = start + i * (n + 1) + j
                    faces += [(k, k + 1, k + n + 2), (k, k + n + 2, k + n + 1)]
    scene = scene_of(np.array(vertices), faces)
    inner = grid[1:-1]
    origins = np.stack(np.meshgrid(inner, inner, inner), axis=-1).reshape(-1, 3)
    for axis in range(3):
        for sign in (1.0, -1.0):
            for zero in (0.0, -0.0):
                direction = np.full(3, zero)
                direction[axis] = sign
                hits = find_closest(scene, origins, np.tile(direction, (len(origins), 1)))
                np.testing.assert_array_equal(hits.t, np.where(sign > 0, 1 - origins[:, axis], origins[:, axis]))


def soup(rng, n):
    centers = rng.uniform(-1, 1, (n, 1, 3))
    size = 10.0 ** rng.uniform(-3, 0, (n, 1, 1))
    corners = centers + size * rng.standard_normal((n, 3, 3))
    corners[: n // 8, 2] = corners[: n // 8, 0] + 1e-9 * rng.standard_normal((n // 8, 3))  # slivers
    corners[n // 8 : n // 4, :, 1] = np.round(corners[n // 8 : n // 4, :1, 1], 1)  # flat boxes, coplanar overlaps
    return corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def test_soup_equals_brute_force():
    rng = np.random.default_rng(8)
    vertices, faces = soup(rng, 600)
    scene = scene_of(vertices, faces)
    origins = rng.uniform(-2, 2, (6000, 3))
    directions = rng.uniform(-1, 1, (6000, 3)) - origins
    directions[:500, 0] = 0.0
    directions[500:800, 1:] = -0.0
    origins[800:1500, 1] = np.round(origins[800:1500, 1], 1)  # in the plane of flat boxes
    directions[800:1500, 1] = 0.0
    origins[1500:2000] = vertices[rng.integers(0, len(vertices), 500)]  # at vertices
    _, t, primitive = trace_brute(scene, origins, directions)
    hits = find_closest(scene, origins, directions)
    np.testing.assert_array_equal(hits.t, t)
    np.testing.assert_array_equal(hits.primitive, primitive)
    assert (primitive >= 0).mean() > 0.5


def test_duplicates_tie_to_the_lowest_id_whatever_their_vertex_order():
    rng = np.random.default_rng(9)
    vertices, faces = icosphere(1, rng, 0.2)
    turned = np.concatenate([np.roll(faces, 1, axis=1), faces[:, ::-1], faces])
    every = np.concatenate([turned, faces])
    scene = scene_of(vertices, every[rng.permutation(len(every))])
    origins, directions = aimed_rays(vertices, faces, rng, 2000)
    hits = find_closest(scene, origins, directions)
    sets = np.sort(scene.face_vertices, axis=1)
    first = {}
    for face, key in enumerate(map(tuple, sets.tolist())):
        first.setdefault(key, face)
    for face in hits.primitive.tolist():
        assert first[tuple(sets[face].tolist())] == face


def test_weights_belong_to_the_corners_as_given():
    rng = np.random.default_rng(10)
    vertices, faces = icosphere(1, rng, 0.2)
    scene = scene_of(vertices, faces)
    origins, directions = aimed_rays(vertices, faces, rng, 1000)
    hits = find_closest(scene, origins, directions)
    a, b, c = (vertices[faces[hits.primitive, k]] for k in range(3))
    u, v = hits.uv.T[..., None]
    np.testing.assert_allclose((1 - u - v) * a + u * b + v * c, origins + hits.t[:, None] * directions, atol=1e-12)


def test_spheres_and_triangles_in_one_hierarchy():
    """A sphere in front of a triangle, behind it, and one inside another."""
    triangle = np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], float)
    spheres = [((0, 0, 5), 1.0), ((0, 0, -5), 2.0), ((0, 0, -5), 1.0), ((3, 0, -5), 1.0)]
    scene = scene_of(triangle, [[0, 1, 2]], spheres=spheres)
    origins = np.array([[0, 0, 10], [0, 0, 3], [0, 0, -1], [0, 0, -5], [0, 0, -6.5], [3, 0, -10], [0, 0, 5]], float)
    directions = np.tile([0.0, 0.0, -1.0], (7, 1))
    directions[5, 2] = 2.0
    hits = find_closest(scene, origins, directions)
    assert hits.primitive.tolist() == [1, 0, 2, 3, 2, 4, 1]
    np.testing.assert_allclose(hits.t, [4, 3, 2, 1, 0.5, 2, 1], rtol=1e-15)


def test_skip_leaves_out_one_primitive():
    triangles = np.array([[-9, -9, z, 9, -9, z, 0, 9, z] for z in (0, -1)], float).reshape(-1, 3)
    scene = scene_of(triangles, [[0, 1, 2], [3, 4, 5]])
    down = np.array([[0.0, 0.0, -1.0]])
    assert find_closest(scene, np.array([[0.0, 0.0, 1.0]]), down).primitive[0] == 0
    assert find_closest(scene, np.array([[0.0, 0.0, 1.0]]), down, skips=0).primitive[0] == 1


@pytest.mark.parametrize(
    ("o", "d"),
    [
        ((math.nan, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, math.nan, 1)),
        ((0, math.inf, 0), (0, 0, 1)),
        ((0, 0, 0), (math.inf, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
    ],
)
def test_rays_that_are_none_miss(o, d):
    vertices, faces = icosphere(1)
    scene = scene_of(vertices, faces, spheres=[((0, 0, 0), 0.5)])
    hits = find_closest(scene, np.array([o], float), np.array([d], float))
    assert (hits.t[0], hits.primitive[0]) == (math.inf, -1)


def test_empty_scene():
    scene = scene_of(np.zeros((0, 3)), np.zeros((0, 3)))
    hits = find_closest(scene, np.zeros((1, 3)), np.ones((1, 3)))
    assert hits.primitive[0] == -1
    assert find_light(scene, np.zeros((1, 3)), np.ones((1, 3)), 1.0).tolist() == [[1, 1, 1]]


def test_transmittance_multiplies_kt_of_all_crossings():
    """Parallel panes with powers of two for kt, so that products are exact, and a glass sphere that counts twice."""
    n = 12
    panes = np.array([[-9, -9, -k, 9, -9, -k, 0, 9, -k] for k in range(n)], float).reshape(-1, 3)
    rng = np.random.default_rng(11)
    kt = 2.0 ** -rng.integers(0, 4, (n + 1, 3))
    scene = scene_of(panes, np.arange(3 * n).reshape(n, 3), kt=kt, spheres=[((0, 0, 5), 1.0)])
    down = np.array([[0.0, 0.0, -1.0]])
    for start, t_max, panes_crossed, sphere_crossed in [
        (1.0, 100.0, range(n), 0),
        (10.0, 100.0, range(n), 2),
        (5.0, 100.0, range(n), 1),
        (0.5, 2.0, range(2), 0),
        (0.5, 2.5, range(2), 0),
        (0.5, 2.6, range(3), 0),
        (-20.0, 100.0, [], 0),
    ]:
        share = find_light(scene, np.array([[0.0, 0.0, start]]), down, t_max)
        expected = np.prod(kt[list(panes_crossed)], axis=0) * kt[n] ** sphere_crossed
        np.testing.assert_array_equal(share[0], expected)


def test_light_does_not_depend_on_the_company():
    rng = np.random.default_rng(12)
    vertices, faces = soup(rng, 300)
    kt = np.where(rng.random((300, 3)) < 0.5, 0.0, 2.0 ** -rng.integers(0, 4, (300, 3)))  # opaque only together, mostly
    scene = scene_of(vertices, faces, kt=kt)
    origins = rng.uniform(-2, 2, (4000, 3))
    directions = rng.uniform(-1, 1, (4000, 3)) - origins
    ends = rng.uniform(0.2, 2.0, 4000)
    together = find_light(scene, origins, directions, ends)
    expected, _ = brute_light(vertices, faces, origins, directions, ends, kt=kt)
    np.testing.assert_array_equal(together, expected)
    for k in range(0, 4000, 7):
        alone = find_light(scene, origins[k : k + 1], directions[k : k + 1], ends[k : k + 1])
        np.testing.assert_array_equal(alone[0], together[k])
    assert 0.2 < (together == 0).all(axis=1).mean() < 0.99
