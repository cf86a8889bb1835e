"""Rays through placements: what they meet is the nearest of all, wherever the placements stand."""

from fractions import Fraction

import numpy as np
import pytest

from tests.numerics.closed_meshes import MESHES, by_brute_force, rays_from_inside
from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.packets import brute_light, find_closest, find_light
from tests.tracer.rays.placements import place, random_turn, rows_of

SQUARE = (np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def crowd(rng, n, spread=4.0, mirrored=True):
    """Uses of two meshes, turned, scaled and mirrored at random."""
    uses = [(1, None)]
    for k in range(n):
        linear = random_turn(rng) * 10.0 ** rng.uniform(-1, 0)
        if mirrored and k % 3 == 0:
            linear = linear @ np.diag([1.0, 1.0, -1.0])
        uses.append((k % 2, rows_of(linear, rng.uniform(-spread, spread, 3))))
    return uses


def rays_across(rng, n, spread=4.0):
    origins = rng.uniform(-1.5 * spread, 1.5 * spread, (n, 3))
    return origins, rng.uniform(-spread, spread, (n, 3)) - origins


@pytest.mark.parametrize("n", [1, 2, 40, 300])
def test_the_nearest_of_all_is_met(n):
    """Oracle: every baked triangle by the predicate."""
    rng = np.random.default_rng(n)
    placed = place([icosphere(1, rng, 0.2), icosphere(0)], crowd(rng, n))
    origins, directions = rays_across(rng, 1500)
    t, primitive, _ = by_brute_force(placed.vertices, placed.faces, origins, directions)
    hits = find_closest(placed.scene, origins, directions)
    assert (primitive >= 0).sum() > 20
    np.testing.assert_array_equal(hits.primitive, primitive)
    np.testing.assert_allclose(hits.t, t, rtol=1e-13)


def exact_hit(corners, origin, direction):
    """The least (t, triangle) in rationals; corners (m, 3, 3) of Fractions. A touch of an edge counts."""
    best = None
    for number, (a, b, c) in enumerate(corners):
        e, f = [y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)]
        n = [e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3] for k in range(3)]
        along = sum(x * y for x, y in zip(n, direction, strict=True))
        if along == 0:
            continue
        t = sum(x * (y - o) for x, y, o in zip(n, a, origin, strict=True)) / along
        if t <= 0 or (best is not None and t >= best[0]):
            continue
        p = [o + t * d for o, d in zip(origin, direction, strict=True)]
        signs = []
        for u, v in ((a, b), (b, c), (c, a)):
            w, q = [y - x for x, y in zip(u, v, strict=True)], [y - x for x, y in zip(u, p, strict=True)]
            signs.append(
                sum(n[k] * (w[(k + 1) % 3] * q[(k + 2) % 3] - w[(k + 2) % 3] * q[(k + 1) % 3]) for k in range(3))
            )
        if min(signs) >= 0:
            best = (t, number)
    return best


def test_against_rationals():
    """Vertices moved exactly, rays exactly as given: the same triangle, and t to 1e-14."""
    rng = np.random.default_rng(5)
    mesh = icosphere(0)
    uses = [(0, rows_of(random_turn(rng) @ np.diag([1, 2, 0.5]), rng.uniform(-3, 3, 3))) for _ in range(3)]
    placed = place([mesh], uses)
    corners = []
    for _, rows in uses:
        m = [[Fraction(x) for x in row] for row in rows[:3]]
        moved = [[sum(m[i][k] * Fraction(float(v[k])) for k in range(3)) + m[i][3] for i in range(3)] for v in mesh[0]]
        corners += [[moved[i] for i in face] for face in mesh[1]]
    origins, directions = rays_across(rng, 60, 3.0)
    hits = find_closest(placed.scene, origins, directions)
    n_met = 0
    for k in range(60):
        best = exact_hit(corners, [Fraction(x) for x in origins[k]], [Fraction(x) for x in directions[k]])
        assert hits.primitive[k] == (-1 if best is None else best[1])
        if best is not None:
            n_met += 1
            assert abs(Fraction(hits.t[k]) - best[0]) <= Fraction(1e-14) * best[0]
    assert n_met >= 10


def test_placements_as_they_are_answer_as_one_tree_does():
    """Bit for bit, and equal distances are won by the lowest id, across placements too."""
    rng = np.random.default_rng(6)
    ball, twice = icosphere(1, rng, 0.3), SQUARE
    placed = place([ball, twice], [(1, None), (0, None), (1, None)])
    origins = rng.uniform(-2, 2, (1000, 3))
    directions = np.where(np.arange(1000)[:, None] % 2, [0.0, 0.0, -1.0], rng.standard_normal((1000, 3)))
    t, primitive, _ = by_brute_force(placed.vertices, placed.faces, origins, directions)
    hits = find_closest(placed.scene, origins, directions)
    np.testing.assert_array_equal(hits.t, t)
    np.testing.assert_array_equal(hits.primitive, primitive)
    assert (primitive < 2)[primitive >= 0].sum() > 30
    assert (primitive >= len(placed.faces) - 2).sum() == 0
    one = find_closest(placed.baked, origins, directions)
    np.testing.assert_array_equal(hits.uv, one.uv)


def test_what_a_ray_starts_on_is_left_out_in_its_own_placement_alone():
    """The same triangle of another placement is met, and the one behind the one left out."""
    shifts = [-1.0, -2.0, -3.0]
    uses = [(0, rows_of(np.eye(3), [0, 0, z])) for z in shifts]
    placed = place([SQUARE], uses)
    origins, directions = np.tile([0.3, 0.1, 0.0], (7, 1)), np.tile([0.0, 0.0, -1.0], (7, 1))
    faces = find_closest(placed.scene, origins[:1], directions[:1]).primitive
    face = int(faces[0])
    assert face in {0, 1}
    skips = np.array([-1, face, face + 2, face + 4, 1 - face, 6, 7])
    hits = find_closest(placed.scene, origins, directions, skips)
    assert hits.t.tolist() == [1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert hits.primitive.tolist() == [face, face + 2, face, face, face, face, face]
    kt = np.full((6, 3), 0.5)
    light = find_light(place([SQUARE], uses, kt=kt).scene, origins, directions, 2.5, skips)
    assert light[:, 0].tolist() == [0.25, 0.5, 0.5, 0.25, 0.25, 0.25, 0.25]


def test_light_through_placements():
    """Every placed triangle weakens a shadow ray once, by the material of its own placement."""
    rng = np.random.default_rng(8)
    uses = crowd(rng, 30, 2.0)
    n_faces = sum(len(icosphere(0)[1]) if mesh else len(icosphere(1)[1]) for mesh, _ in uses)
    kt = 2.0 ** -rng.integers(0, 3, (n_faces, 3))
    kt[rng.random(n_faces) < 0.1] = 0.0
    placed = place([icosphere(1), icosphere(0)], uses, kt=kt)
    origins, directions = rays_across(rng, 1000, 2.0)
    for end in (np.inf, 1.0):
        light, counts = brute_light(placed.vertices, placed.faces, origins, directions, end, kt=kt)
        assert (counts > 1).sum() > 100
        np.testing.assert_array_equal(find_light(placed.scene, origins, directions, end), light)


def test_an_answer_does_not_depend_on_the_company():
    rng = np.random.default_rng(9)
    placed = place([icosphere(1), icosphere(0)], crowd(rng, 20))
    origins, directions = rays_across(rng, 256)
    together = find_closest(placed.scene, origins, directions)
    order = rng.permutation(256)
    mixed = find_closest(placed.scene, origins[order], directions[order])
    alone = [find_closest(placed.scene, origins[k : k + 1], directions[k : k + 1]) for k in range(60)]
    for name in together._fields:
        np.testing.assert_array_equal(getattr(mixed, name), getattr(together, name)[order])
        np.testing.assert_array_equal(
            np.concatenate([getattr(one, name) for one in alone]), getattr(together, name)[:60]
        )


@pytest.mark.parametrize("name", MESHES)
def test_closed_meshes_lose_no_ray(name):
    """From inside each of three placements, at vertices, edges and in planes of faces: something is always met."""
    rng = np.random.default_rng(len(name))
    make, inside, reach = MESHES[name]
    vertices, faces = make()
    size = np.abs(vertices).max()
    n_tested = 0
    for scale in (1e-6, 1.0, 1e6):
        for shift in (0.0, 1e5):
            skew = np.array([[1.0, 3.0, 0], [0, 1, 0], [0, -2, 1]])
            linears = [random_turn(rng), random_turn(rng) @ skew, np.diag([1.0, -1.0, 1.0])]
            maps = [
                rows_of(m * scale, (k + shift) * 20 * size * scale * rng.standard_normal(3))
                for k, m in enumerate(linears)
            ]
            placed = place([(vertices, faces)], [(0, rows) for rows in maps])
            for number, rows in enumerate(maps):
                linear, origin = np.array(rows)[:3, :3], np.array(rows)[:3, 3]
                if 10 * np.spacing(np.abs(origin).max()) > reach * scale:
                    continue  # the place is not resolved by float64
                n_tested += 1
                for aim in ("vertex", "edge", "middle", "axis"):
                    o, d = rays_from_inside(vertices, faces, aim, 60, rng, np.array(inside), 0.3 * reach)
                    o, d = o @ linear.T + origin, d @ linear.T
                    usable = np.abs(d).max(1) > 0
                    hits = find_closest(placed.scene, o[usable], d[usable])
                    assert (hits.primitive >= 0).all(), (name, scale, shift, number, aim)
    assert n_tested >= 15
