"""Rays in packets against brute force by the scalar predicate and against the caster, which follows each ray alone.

N1 and N2 for packets: the same t, primitive, u and v, bit for bit, for whoever travels together.
"""

import math
from fractions import Fraction

import numpy as np
import pytest

from tests.numerics.closed_meshes import AIMS, MESHES, by_brute_force, flat_boxes, rays_from_inside, sphere
from tests.tracer.rays.packets import WAYS, axis_of, brute_light, follow, tree_of
from tracer.rays import RayCaster

N_RAYS = 384
OFFSETS = (0.0, 1e5, 1e7)  # in mesh diameters


def unit(directions):
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def placed(name, offset, scale=1.0, dtype=np.float64):
    """Vertices, faces, a point inside and how far from it is inside, too."""
    make, inside, reach = MESHES[name]
    vertices, faces = make()
    shift = np.array([1.0, -0.7, 0.5]) * offset * np.linalg.norm(vertices.max(0) - vertices.min(0))
    moved = ((vertices + shift) * scale).astype(dtype).astype(np.float64)
    return moved, faces, (np.array(inside) + shift) * scale, reach * scale


def check(tree, vertices, faces, origins, directions, **options):
    """Closest hits equal brute force and the caster; "any" tells the same."""
    found = follow(tree, origins, directions, **options)
    times, primitives, _ = by_brute_force(vertices, faces, origins, directions)
    np.testing.assert_array_equal(found.primitive, primitives)
    np.testing.assert_array_equal(found.t, times)
    alone = RayCaster.from_bvh(tree).closest_hit(origins, directions)
    met = found.primitive >= 0
    np.testing.assert_array_equal(found.t, alone.t)
    np.testing.assert_array_equal(found.u[met], alone.u[met])
    np.testing.assert_array_equal(found.v[met], alone.v[met])
    assert not found.ended.any()
    np.testing.assert_array_equal(follow(tree, origins, directions, mode="any", **options).ended, met)
    return found


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("name", MESHES)
def test_closed_meshes_lose_no_ray(name, offset, way):
    vertices, faces, centre, reach = placed(name, offset)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(41)
    for aim in AIMS:
        origins, directions = rays_from_inside(vertices, faces, aim, N_RAYS, rng, centre, reach)
        usable = np.abs(directions).max(1) > 0
        directions = unit(directions[usable])
        found = check(tree, vertices, faces, origins[usable], directions, way=way)
        assert (found.primitive >= 0).all(), aim


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scales(scale):
    vertices, faces, centre, reach = placed("torus", 10.0, scale)
    rng = np.random.default_rng(42)
    for aim in AIMS:
        origins, directions = rays_from_inside(vertices, faces, aim, 192, rng, centre, reach)
        check(tree_of(vertices, faces), vertices, faces, origins, unit(directions), way="packet")


@pytest.mark.parametrize("name", ["sphere", "torus", "fan"])
def test_float32_leaves(name):
    vertices, faces, centre, reach = placed(name, 0.0, dtype=np.float32)
    tree = tree_of(vertices, faces, np.float32)
    assert tree.n_bytes < tree_of(vertices + 1e-9, faces).n_bytes
    rng = np.random.default_rng(43)
    for aim in AIMS:
        origins, directions = rays_from_inside(vertices, faces, aim, 192, rng, centre, reach)
        for way in WAYS:
            check(tree, vertices, faces, origins, unit(directions), way=way)


def pencils(vertices, faces, rng, n_pencils, spread, distance):
    """Narrow bundles of 64 from outside: at a vertex, an edge or a face each, their origins and slopes ``spread`` apart."""
    origins, directions = [], []
    middle, size = vertices.mean(0), np.abs(vertices - vertices.mean(0)).max()
    for k in range(n_pencils):
        face = vertices[faces[rng.integers(len(faces))]]
        weights = [[1, 0, 0], [0.5, 0.5, 0], rng.dirichlet([1, 1, 1]), [0.25, 0, 0.75]][k % 4]
        eye = middle + unit(rng.standard_normal((1, 3)))[0] * distance * size
        eye = eye + spread * size * rng.standard_normal((64, 3)) * (k % 3 > 0)
        target = np.asarray(weights) @ face + spread * size * rng.standard_normal((64, 3)) * (k % 5 > 0)
        target[::9] = np.asarray(weights) @ face
        origins.append(eye)
        directions.append(unit(target - eye))
    return np.concatenate(origins), np.concatenate(directions)


@pytest.mark.parametrize("distance", [3.0, 1e3, 1e7])
@pytest.mark.parametrize("spread", [0.0, 1e-12, 1e-4, 0.05])
def test_pencils_from_outside(spread, distance):
    """The camera's and the shadows' case; at spread 0 many triangles are met by all or by none for certain."""
    vertices, faces = sphere(14, 14)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(44)
    origins, directions = pencils(vertices, faces, rng, 12, spread, distance)
    found = check(tree, vertices, faces, origins, directions, way="packet")
    assert (found.primitive >= 0).mean() > 0.4
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3))
    light, counts = brute_light(vertices, faces, origins, directions, kt=kt)
    assert (counts % 2 == 0).all()
    np.testing.assert_array_equal(follow(tree, origins, directions, mode="shade", kt=kt, way="packet").light, light)


def test_from_far_away():
    """Origins 10 to 1e10 radii off; beams of different distances in one packet."""
    vertices, faces = sphere(12, 12)
    rng = np.random.default_rng(45)
    origins = unit(rng.standard_normal((512, 3))) * 10.0 ** rng.uniform(1, 10, (512, 1))
    directions = unit(vertices[rng.integers(0, len(vertices), 512)] - origins)
    for way in WAYS:
        check(tree_of(vertices, faces), vertices, faces, origins, directions, way=way)


def test_specks():
    """Triangles smaller than float32 resolves, in boxes of their own; all rays of a beam go the same way."""
    rng = np.random.default_rng(46)
    n = 3000
    vertices = (rng.uniform(-1, 1, (n, 1, 3)) + rng.uniform(-1e-9, 1e-9, (n, 3, 3))).reshape(-1, 3)
    faces = np.arange(3 * n, dtype=np.int32).reshape(-1, 3)
    origins = np.repeat(rng.uniform(-1, 1, (n, 3)), 2, 0)
    directions = unit(np.repeat(vertices.reshape(-1, 3, 3).mean(1), 2, 0) - origins)
    for way in WAYS:
        found = check(tree_of(vertices, faces), vertices, faces, origins, directions, way=way, size=2)
        assert (found.primitive >= 0).mean() > 0.9


def test_from_where_float64_does_not_resolve_the_mesh():
    vertices, faces = sphere(8, 8)
    rng = np.random.default_rng(46)
    origins, directions = rng.normal(size=(384, 3)) * 0.3, np.zeros((384, 3))
    axis = rng.integers(0, 3, 384)
    directions[np.arange(384), axis] = 1.0
    origins[np.arange(384), axis] = -(10.0 ** rng.uniform(13, 99, 384))
    for way in WAYS:
        found = check(tree_of(vertices, faces), vertices, faces, origins, directions, way=way)
        assert (found.primitive >= 0).all()


def test_axis_parallel_rays_in_the_planes_of_flat_boxes():
    """N5: origins on faces, edges and corners of a grid of squares, all signs of zero, components of 1e-310."""
    vertices, faces = flat_boxes()
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(47)
    values = np.array([0.0, -0.0, 1.0, -1.0, 1e-310, -1e-310, 0.5])
    directions = rng.choice(values, (4000, 3))
    directions = directions[np.abs(directions).max(1) == 1]  # the caster counts t so: even denormals are alike
    origins = rng.choice([-1.0, -0.5, 0.0, 0.25, 1.0, -2.0], (len(directions), 3))
    for way in WAYS:
        found = check(tree, vertices, faces, origins, directions, way=way)
    assert (found.primitive >= 0).mean() > 0.2


def test_origins_on_the_surface():
    """At vertices, on edges and in faces, with the face skipped and without."""
    vertices, faces = sphere(12, 12)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(48)
    n = 600
    chosen = rng.integers(0, len(faces), n)
    weights = rng.dirichlet([1, 1, 1], n)
    weights[:200] = np.eye(3)[rng.integers(0, 3, 200)]
    weights[200:400, 0] = 0.0
    weights /= weights.sum(1, keepdims=True)
    origins = np.einsum("nk,nkc->nc", weights, vertices[faces[chosen]])
    directions = unit(rng.standard_normal((n, 3)))
    check(tree, vertices, faces, origins, directions, way="packet")
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3))
    for skips in (chosen, chosen[0], -1):
        light, _ = brute_light(vertices, faces, origins, directions, skips=skips, kt=kt)
        for way in WAYS:
            found = follow(tree, origins, directions, skips=skips, mode="shade", kt=kt, way=way)
            np.testing.assert_array_equal(found.light, light)


def test_a_ray_does_not_meet_what_it_skips():
    vertices, faces = sphere(12, 12)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(49)
    origins, directions = rng.normal(size=(256, 3)) * 0.2, unit(rng.normal(size=(256, 3)))
    first = follow(tree, origins, directions)
    second = follow(tree, origins, directions, skips=first.primitive)
    assert (second.primitive != first.primitive).all()
    without = [by_brute_force(vertices, np.delete(faces, p, 0), origins[k : k + 1], directions[k : k + 1])
               for k, p in enumerate(first.primitive)]  # fmt: skip
    np.testing.assert_array_equal(second.t, [times[0] for times, _, _ in without])
    everyone = follow(tree, origins, directions, skips=first.primitive[0])
    assert (everyone.primitive != first.primitive[0]).all()


def test_ends():
    """The interval is open: a ray that ends on a triangle does not meet it, one number further it does."""
    vertices, faces = sphere(12, 12)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(50)
    origins, directions = rng.normal(size=(600, 3)), unit(rng.normal(size=(600, 3)))
    first = follow(tree, origins, directions)
    keep = first.primitive >= 0
    origins, directions, t = origins[keep], directions[keep], first.t[keep]
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3))
    for way in WAYS:
        at_hit = follow(tree, origins, directions, t, way=way)
        assert (at_hit.primitive == -1).all()
        np.testing.assert_array_equal(at_hit.t, t)  # the end stays where nothing was met before it
        assert not follow(tree, origins, directions, t, mode="any", way=way).ended.any()
        beyond = np.nextafter(t, np.inf)
        np.testing.assert_array_equal(follow(tree, origins, directions, beyond, way=way).t, t)
        assert follow(tree, origins, directions, beyond, mode="any", way=way).ended.all()
        for ends in (t, beyond, t * rng.uniform(0.5, 4, len(t)), 1e-300, np.where(rng.random(len(t)) < 0.5, t, np.inf)):
            light, counts = brute_light(vertices, faces, origins, directions, ends, kt=kt)
            found = follow(tree, origins, directions, ends, mode="shade", kt=kt, way=way)
            np.testing.assert_array_equal(found.light, light)
            met = follow(tree, origins, directions, ends, mode="any", way=way).ended
            np.testing.assert_array_equal(met, counts > 0)


@pytest.mark.parametrize("name", MESHES)
def test_light_through_closed_meshes(name):
    """Products of kt at every crossing, black and clear faces among them; who is in the dark is told."""
    vertices, faces, centre, reach = placed(name, 1.0)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(51)
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3)) * (rng.random((len(faces), 3)) < 0.8)
    kt[::3] = 0.0
    dark = 0
    for aim in AIMS:
        origins, directions = rays_from_inside(vertices, faces, aim, 192, rng, centre, reach)
        directions = unit(directions)
        light, counts = brute_light(vertices, faces, origins, directions, kt=kt)
        assert (counts % 2 == 1).all()
        for way in WAYS:
            found = follow(tree, origins, directions, mode="shade", kt=kt, way=way)
            np.testing.assert_array_equal(found.light, light)
            np.testing.assert_array_equal(found.ended, (light == 0).all(1))
        dark += found.ended.sum()
    assert 0 < dark < 192 * len(AIMS)


def test_light_through_many_surfaces_is_the_same_in_any_order():
    """Twelve spheres within each other, kt of 53 bits each: the product, rounded once, whatever the company."""
    one, ring = sphere(10, 10)
    vertices = np.concatenate([one * (1 + 0.1 * k) for k in range(12)])
    faces = np.concatenate([ring + k * len(one) for k in range(12)])
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(53)
    kt = rng.uniform(0.5, 1.0, (len(faces), 3))
    origins, directions = rng.normal(size=(256, 3)) * 0.1, unit(rng.normal(size=(256, 3)))
    crossed = []
    for face in range(len(faces)):  # which rays cross which face: one face black at a time
        only = np.ones((len(faces), 3))
        only[face] = 0.0
        crossed.append(brute_light(vertices, faces, origins, directions, kt=only)[0][:, 0] == 0.0)
    crossed = np.array(crossed)
    assert (crossed.sum(0) >= 12).all()
    exact = [
        [
            float(math.prod((Fraction(x) for x in kt[crossed[:, ray], channel]), start=Fraction(1)))
            for channel in range(3)
        ]
        for ray in range(256)
    ]
    for way in WAYS:
        for size in (64, 5, 1):
            found = follow(tree, origins, directions, mode="shade", kt=kt, way=way, size=size)
            np.testing.assert_array_equal(found.light, exact)


def test_light_beyond_float64_is_no_nan():
    """Sixty panes that multiply by a million: the light stops growing, and the next black pane ends it."""
    pane = np.array([[-1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [-1.0, 3.0, 0.0]])
    vertices = np.concatenate([pane + np.array([0.0, 0.0, 0.1 * k]) for k in range(60)])
    faces = np.arange(180).reshape(-1, 3)
    tree = tree_of(vertices, faces)
    origins, directions = np.full((16, 3), [0.1, 0.2, -1.0]), np.full((16, 3), [0.0, 0.01, 1.0])
    kt = np.full((60, 3), 1e6)
    for way in WAYS:
        light = follow(tree, origins, directions, mode="shade", kt=kt, way=way).light
        assert np.isfinite(light).all()
        assert (light > 1e280).all()
        kt_black = np.where(np.arange(60)[:, None] == 59, 0.0, kt)
        assert follow(tree, origins, directions, mode="shade", kt=kt_black, way=way).ended.all()


def test_a_shadow_rays_length_is_its_own():
    """Directions that reach to a light, of lengths 1e-3 to 1e3 in one packet, ending at 1."""
    vertices, faces = sphere(12, 12)
    tree = tree_of(vertices, faces)
    rng = np.random.default_rng(52)
    origins = rng.normal(size=(512, 3)) * 3
    directions = unit(rng.normal(size=(512, 3))) * 10.0 ** rng.uniform(-3, 3, (512, 1))
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3))
    light, counts = brute_light(vertices, faces, origins, directions, 1.0, kt=kt)
    assert 0.2 < (counts > 0).mean() < 0.9
    for way in WAYS:
        np.testing.assert_array_equal(follow(tree, origins, directions, 1.0, mode="shade", kt=kt, way=way).light, light)


def test_degenerate_meshes():
    """N4: zero area, duplicates, collinear faces, slivers, denormals: as brute force has it, the lowest id of equals."""
    rng = np.random.default_rng(53)
    vertices = rng.normal(size=(60, 3))
    vertices[10:20] = vertices[0] + (vertices[1] - vertices[0]) * rng.random((10, 1))
    vertices[20:30] = vertices[2]
    vertices[30:40] *= 1e-310
    vertices[40:50] = vertices[3] + 1e-12 * rng.normal(size=(10, 3))
    faces = rng.integers(0, 60, (400, 3)).astype(np.int32)
    faces = np.concatenate([faces, faces[:100, [2, 0, 1]], faces[100:200, ::-1]])
    origins = rng.normal(size=(512, 3)) * 2
    directions = unit(vertices[rng.integers(0, 60, 512)] - origins)
    tree = tree_of(vertices, faces)
    for way in WAYS:
        found = check(tree, vertices, faces, origins, directions, way=way)
        assert not any(np.isnan(column).any() for column in found)
    kt = 2.0 ** -rng.integers(0, 2, (len(faces), 3))
    light, _ = brute_light(vertices, faces, origins, directions, kt=kt)
    np.testing.assert_array_equal(follow(tree, origins, directions, mode="shade", kt=kt, way="packet").light, light)


def test_scaled_by_a_power_of_two():
    """N21: everything times 2**k gives the same bits, huge and tiny."""
    vertices, faces = sphere(12, 12)
    rng = np.random.default_rng(54)
    origins, directions = rng.normal(size=(256, 3)), unit(rng.normal(size=(256, 3)))
    reference = follow(tree_of(vertices, faces), origins, directions, way="packet")
    for k in (-200, -60, 13, 200):
        factor = 2.0**k
        found = follow(tree_of(vertices * factor, faces), origins * factor, directions, way="packet")
        np.testing.assert_array_equal(found.primitive, reference.primitive)
        np.testing.assert_array_equal(found.t, reference.t * factor)
        np.testing.assert_array_equal([found.u, found.v], [reference.u, reference.v])


def test_an_empty_tree():
    tree = tree_of(np.zeros((0, 3)), np.zeros((0, 3)))
    origins, directions = np.zeros((5, 3)), unit(np.ones((5, 3)))
    for way in WAYS:
        found = follow(tree, origins, directions, way=way)
        assert (found.primitive == -1).all()
        assert np.isinf(found.t).all()
        shaded = follow(tree, origins, directions, mode="shade", way=way)
        assert (shaded.light == 1).all()
        assert not shaded.ended.any()


def test_the_axis_of_a_ray_decides_who_may_travel_together():
    """`axis_of`, by which these tests part rays into packets, by hand."""
    directions = np.array([[1, 0.5, -1], [1, -1, 0.5], [-1, 0.9, 0.9], [0.2, 0.3, 0.4], [-1, -1, -1]])
    assert axis_of(directions).tolist() == [5, 3, 1, 4, 5]
