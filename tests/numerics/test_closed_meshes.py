"""N1 and N2: closed meshes lose no ray and count none twice, at any place and scale, whatever path a ray takes.

Oracles: topology (a ray from inside crosses an odd number of times), and brute force by the scalar predicate.
Small here; the sizes are parameters, for `make stress`.
"""

import numpy as np
import pytest
from n01 import CELLS, placed

from tests.numerics.closed_meshes import AIMS, by_brute_force, rays_from_inside, sphere
from tracer.rays import RayCaster

N_RAYS = 400


def test_which_cells_are_degenerate():
    """The list that the stress suite states: a needle's width is below a spacing so far away."""
    assert {(name, offset) for name, offset, scale in CELLS if placed(name, offset, scale) is None} == {
        ("needle", 1e12)
    }


# The degenerate cells are left out; the test above proves that these are all of them.
@pytest.mark.parametrize(("name", "offset", "scale"), [cell for cell in CELLS if cell[:2] != ("needle", 1e12)])
def test_no_ray_is_lost_or_counted_twice(name, offset, scale):
    cell = placed(name, offset, scale)
    assert cell is not None
    vertices, faces, centre, reach = cell
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(11)
    for aim in AIMS:
        origins, directions = rays_from_inside(vertices, faces, aim, N_RAYS, rng, centre, reach)
        usable = np.abs(directions).max(1) > 0
        origins, directions = origins[usable], directions[usable]
        hits = caster.closest_hit(origins, directions)
        counts = caster.count_hits(origins, directions)
        times, primitives, crossings = by_brute_force(vertices, faces, origins, directions)
        assert (hits.primitive >= 0).all(), aim
        assert (counts % 2 == 1).all(), aim
        np.testing.assert_array_equal(hits.primitive, primitives)
        np.testing.assert_array_equal(hits.t, times)  # bit for bit
        np.testing.assert_array_equal(counts, crossings)
        assert caster.any_hit(origins, directions).all()


def test_two_meshes_far_apart_in_one_tree():
    vertices, faces = sphere(10, 10)
    far = np.array([1e7, 3e6, -2e6])
    both = np.concatenate([vertices, vertices + far])
    joined = np.concatenate([faces, faces + len(vertices)])
    caster = RayCaster(both, joined)
    rng = np.random.default_rng(5)
    for centre in (np.zeros(3), far):
        for aim in AIMS:
            origins, directions = rays_from_inside(vertices + centre, faces, aim, 60, rng, centre, 0.5)
            times, primitives, crossings = by_brute_force(both, joined, origins, directions)
            hits = caster.closest_hit(origins, directions)
            np.testing.assert_array_equal(hits.primitive, primitives)
            np.testing.assert_array_equal(hits.t, times)
            assert (crossings % 2 == 1).all()
            np.testing.assert_array_equal(caster.count_hits(origins, directions), crossings)


def test_from_far_away():
    """An origin 1e9 diameters off: the boxes' slop grows, the answer does not change."""
    vertices, faces = sphere(12, 12)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(6)
    origins = rng.normal(size=(200, 3))
    origins *= 10.0 ** rng.uniform(1, 10, (200, 1)) / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = vertices[rng.integers(0, len(vertices), 200)] - origins
    times, primitives, crossings = by_brute_force(vertices, faces, origins, directions)
    hits = caster.closest_hit(origins, directions)
    np.testing.assert_array_equal(hits.primitive, primitives)
    np.testing.assert_array_equal(hits.t, times)
    counts = caster.count_hits(origins, directions)
    np.testing.assert_array_equal(counts, crossings)
    assert (counts % 2 == 0).all()


def test_from_where_float64_does_not_resolve_the_mesh():
    """A ray along an axis still meets what brute force says it meets; a lone point of a mesh does no harm."""
    vertices, faces = sphere(8, 8)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(16)
    origins, directions = rng.normal(size=(200, 3)) * 0.3, np.zeros((200, 3))
    axis = rng.integers(0, 3, 200)
    directions[np.arange(200), axis] = 1.0
    origins[np.arange(200), axis] = -(10.0 ** rng.uniform(13, 99, 200))
    times, primitives, crossings = by_brute_force(vertices, faces, origins, directions)
    hits = caster.closest_hit(origins, directions)
    assert (primitives >= 0).all()
    np.testing.assert_array_equal(hits.primitive, primitives)
    np.testing.assert_array_equal(hits.t, times)
    np.testing.assert_array_equal(caster.count_hits(origins, directions), crossings)


def test_intervals():
    """tmin and tmax as brute force has them, up to the very hit: the interval is open on both sides."""
    vertices, faces = sphere(12, 12)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(7)
    origins, directions = rng.normal(size=(300, 3)), rng.normal(size=(300, 3))
    first = caster.closest_hit(origins, directions)
    found = first.primitive >= 0
    origins, directions, t = origins[found], directions[found], first.t[found]
    assert not caster.any_hit(origins, directions, 0.0, t).any()
    assert caster.any_hit(origins, directions, 0.0, np.nextafter(t, np.inf)).all()
    np.testing.assert_array_equal(caster.closest_hit(origins, directions, np.nextafter(t, 0)).t, t)
    second = caster.closest_hit(origins, directions, t)
    assert (second.t > t).all()
    counts = caster.count_hits(origins, directions)
    np.testing.assert_array_equal(caster.count_hits(origins, directions, t), counts - 1)
    for lower, upper in ((0.3, 1.7), (1.0, 1e300), (2.0, 2.5)):
        times, primitives, crossings = by_brute_force(vertices, faces, origins, directions, lower, upper)
        hits = caster.closest_hit(origins, directions, lower, upper)
        np.testing.assert_array_equal(hits.t, times)
        np.testing.assert_array_equal(hits.primitive, primitives)
        np.testing.assert_array_equal(caster.count_hits(origins, directions, lower, upper), crossings)


def test_results_do_not_depend_on_threads_order_or_company():
    vertices, faces = sphere(40, 40)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(8)
    n = 20_000
    origins, directions = rng.normal(size=(n, 3)) * 2, rng.normal(size=(n, 3))
    whole = caster.closest_hit(origins, directions)
    order = rng.permutation(n)
    shuffled = caster.closest_hit(origins[order], directions[order], threads=2)
    for one, other in zip(whole, shuffled, strict=True):
        np.testing.assert_array_equal(one[order], other)
    alone = caster.closest_hit(origins[77:78], directions[77:78])
    assert [float(column[0]) for column in alone] == [float(column[77]) for column in whole]
    np.testing.assert_array_equal(caster.any_hit(origins, directions, threads=2), whole.primitive >= 0)
    np.testing.assert_array_equal(
        caster.count_hits(origins, directions, threads=2), caster.count_hits(origins, directions)
    )


def test_scaled_by_a_power_of_two():
    """N21 for rays: everything times 2**k gives the same bits."""
    vertices, faces = sphere(12, 12)
    rng = np.random.default_rng(9)
    origins, directions = rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    reference = RayCaster(vertices, faces).closest_hit(origins, directions)
    for k in (-60, 13, 200):
        factor = 2.0**k
        hits = RayCaster(vertices * factor, faces).closest_hit(origins * factor, directions * factor)
        for one, other in zip(reference, hits, strict=True):
            np.testing.assert_array_equal(one, other)


def test_coincident_triangles_give_the_lowest_id():
    """N2, N15: whatever the order of a face's vertices, the first of equals wins, in every build order."""
    vertices, faces = sphere(8, 8)
    rng = np.random.default_rng(10)
    origins, directions = rng.normal(size=(300, 3)) * 0.2, rng.normal(size=(300, 3))
    for _ in range(5):
        copies = np.concatenate([faces, faces[:, [1, 2, 0]], faces[:, [2, 1, 0]]])
        order = rng.permutation(len(copies))
        lowest = np.full(len(faces), len(copies))
        np.minimum.at(lowest, order % len(faces), np.arange(len(copies)))
        hits = RayCaster(vertices, copies[order]).closest_hit(origins, directions)
        np.testing.assert_array_equal(hits.primitive, lowest[order[hits.primitive] % len(faces)])


def test_barycentrics_are_those_of_the_given_order():
    vertices, faces = sphere(12, 12)
    rng = np.random.default_rng(12)
    faces = np.take_along_axis(faces, rng.permuted(np.tile(np.arange(3), (len(faces), 1)), axis=1), 1)
    origins, directions = rng.normal(size=(2000, 3)) * 0.2, rng.normal(size=(2000, 3))
    hits = RayCaster(vertices, faces).closest_hit(origins, directions)
    a, b, c = (vertices[faces[hits.primitive, k]] for k in range(3))
    points = (1 - hits.u - hits.v)[:, None] * a + hits.u[:, None] * b + hits.v[:, None] * c
    np.testing.assert_allclose(points, origins + hits.t[:, None] * directions, atol=1e-13)
    assert (hits.u >= 0).all()
    assert (hits.v >= 0).all()
    assert (hits.u + hits.v <= 1 + 1e-15).all()
