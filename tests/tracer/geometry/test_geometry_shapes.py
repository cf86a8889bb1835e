"""Shapes against 50-digit arithmetic, in local space, and their hit points in the world."""

import math

import mpmath
import numpy as np
import pytest

from tracer.geometry.shapes import cross_plane, cross_shape, locate_on_plane, locate_on_shape
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_CYLINDER_OPEN, SHAPE_DISK, SHAPE_SPHERE, Vec3

mpmath.mp.dps = 50
ALL = [SHAPE_SPHERE, SHAPE_BOX, SHAPE_DISK, SHAPE_CYLINDER_OPEN, SHAPE_CYLINDER_CAPPED]


def quadratic(o, d, axes):
    """Both t at which the sum of squares over some axes is 1, or none."""
    a = sum(d[k] ** 2 for k in axes)
    b = sum(o[k] * d[k] for k in axes)
    c = sum(o[k] ** 2 for k in axes) - 1
    square = b * b - a * c
    if a == 0 or square < 0:
        return []
    return [(-b - mpmath.sqrt(square)) / a, (-b + mpmath.sqrt(square)) / a]


def at(o, d, t):
    return [o[k] + t * d[k] for k in range(3)]


def exact_crossings(kind, o, d):
    """All t, in order, from the definitions of the surfaces."""
    o, d = [mpmath.mpf(x) for x in o], [mpmath.mpf(x) for x in d]
    if kind == SHAPE_SPHERE:
        return quadratic(o, d, range(3))
    found = []
    if kind == SHAPE_BOX:
        for axis in range(3):
            for side in (-1, 1):
                t = (side - o[axis]) / d[axis]
                if all(abs(x) <= 1 for k, x in enumerate(at(o, d, t)) if k != axis):
                    found.append(t)
    if kind in {SHAPE_CYLINDER_OPEN, SHAPE_CYLINDER_CAPPED}:
        found += [t for t in quadratic(o, d, range(2)) if 0 <= at(o, d, t)[2] <= 1]
    ends = {SHAPE_DISK: [0], SHAPE_CYLINDER_CAPPED: [0, 1]}.get(kind, [])
    for height in ends:
        t = (height - o[2]) / d[2]
        x, y, _ = at(o, d, t)
        if x * x + y * y <= 1:
            found.append(t)
    return sorted(found)


def lines(rng, n):
    for _ in range(n):
        o = rng.standard_normal(3) * 10.0 ** rng.uniform(-1, 2)
        aim = rng.uniform(-1.1, 1.1, 3)
        yield o.tolist(), ((aim - o) * 10.0 ** rng.uniform(-3, 3)).tolist()


@pytest.mark.parametrize("kind", ALL)
def test_crossings_against_mpmath(kind):
    rng = np.random.default_rng(kind)
    n_hits = 0
    for o, d in lines(rng, 1500):
        exact = exact_crossings(kind, o, d)
        found = [t for t in cross_shape(kind, Vec3(*o), Vec3(*d)) if not math.isnan(t)]
        assert len(found) == len(exact)
        reach = math.hypot(*o) + 2.0
        for t, want in zip(found, exact, strict=True):
            # 1e-12 of the distance, and what a tangent's square root makes of it is left to the test of grazing rays
            assert abs(t - want) * math.hypot(*d) <= 1e-11 * reach
        n_hits += len(exact)
    assert n_hits > 500


def test_far_spheres_keep_their_class():
    """Distance over radius up to 1e8: hits and misses are right outside the error of the perpendicular distance."""
    rng = np.random.default_rng(11)
    decided = 0
    for _ in range(1500):
        distance = 10.0 ** rng.uniform(0.5, 8)
        towards = rng.standard_normal(3)
        towards /= np.linalg.norm(towards)
        across = np.cross(towards, rng.standard_normal(3))
        across /= np.linalg.norm(across)
        aim = across * (1.0 + rng.uniform(-1, 1) * 10.0 ** rng.uniform(-8, 0))
        o = (-distance * towards).tolist()
        d = (aim + distance * towards).tolist()
        exact = exact_crossings(SHAPE_SPHERE, o, d)
        found = cross_shape(SHAPE_SPHERE, Vec3(*o), Vec3(*d))
        mo, md = [mpmath.mpf(x) for x in o], [mpmath.mpf(x) for x in d]
        b = sum(x * y for x, y in zip(mo, md, strict=True))
        gap = abs(1 - mpmath.sqrt(sum(x * x for x in mo) - b * b / sum(x * x for x in md)))
        if gap > 8 * 2.0**-53 * distance:
            decided += 1
            assert math.isnan(found.t0) == (not exact)
        if exact and not math.isnan(found.t0):
            # the point found lies on the surface to within a few roundings of the distance
            for t in found:
                p = at(mo, md, mpmath.mpf(t))
                assert abs(mpmath.sqrt(sum(x * x for x in p)) - 1) <= 8 * 2.0**-53 * distance + 1e-15
    assert decided > 1000


def test_a_ray_in_a_face_or_along_an_edge_of_the_box_hits():
    inf = math.inf
    for o, d in [
        ((-3.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        ((-3.0, 1.0, 0.5), (1.0, -0.0, 0.0)),
        ((-3.0, 1.0, -1.0), (1.0, 0.0, -0.0)),
        ((-3.0, -1.0, -1.0), (1.0, -0.0, 0.0)),
    ]:
        found = cross_shape(SHAPE_BOX, Vec3(*map(np.float64, o)), Vec3(*map(np.float64, d)))
        assert tuple(found) == (2.0, 4.0)
    outside = cross_shape(SHAPE_BOX, Vec3(-3.0, 1.0 + 1e-15, 0.0), Vec3(1.0, 0.0, 0.0))
    assert math.isnan(outside.t0)
    assert math.isnan(outside.t1)
    inside = cross_shape(SHAPE_BOX, Vec3(0.0, 0.0, 0.0), Vec3(1.0, 0.0, 0.0))
    assert (inside.t0, inside.t1) == (-1.0, 1.0)
    assert inf > 0


def test_cylinder_along_its_axis():
    down = cross_shape(SHAPE_CYLINDER_CAPPED, Vec3(0.25, 0.5, 3.0), Vec3(0.0, 0.0, -1.0))
    assert (down.t0, down.t1) == (2.0, 3.0)
    past = cross_shape(SHAPE_CYLINDER_CAPPED, Vec3(1.25, 0.5, 3.0), Vec3(0.0, 0.0, -1.0))
    assert math.isnan(past.t0)
    tube = cross_shape(SHAPE_CYLINDER_OPEN, Vec3(0.25, 0.5, 3.0), Vec3(0.0, 0.0, -1.0))
    assert math.isnan(tube.t0)
    assert math.isnan(tube.t1)


def random_map(rng):
    """An affine map of condition up to 100, its inverse, and an origin up to 1e3 away, flat arrays."""
    u, _, v = np.linalg.svd(rng.standard_normal((3, 3)))
    matrix = u @ np.diag(10.0 ** rng.uniform(-1, 1, 3)) @ v
    return rng.standard_normal(3) * 10.0 ** rng.uniform(-1, 3), matrix.ravel(), np.linalg.inv(matrix).ravel()


@pytest.mark.parametrize("kind", ALL)
def test_world_points_lie_on_the_surface_within_their_error(kind):
    rng = np.random.default_rng(20 + kind)
    n_hits = 0
    for o, d in lines(rng, 400):
        origin, to_world, to_local = random_map(rng)
        world_o = origin + to_world.reshape(3, 3) @ o
        world_d = to_world.reshape(3, 3) @ d
        for t in cross_shape(kind, Vec3(*o), Vec3(*d)):
            if not t > 0.0:
                continue
            n_hits += 1
            facts = locate_on_shape(
                kind, Vec3(*origin), to_world, to_local, np.int64(0), Vec3(*world_o), Vec3(*world_d), t
            )
            assert math.hypot(*facts.normal) == pytest.approx(1.0, abs=1e-15)
            # distance from the exact local surface, carried to the world: below the bound along the normal
            inverse = mpmath.matrix(to_world.reshape(3, 3).tolist()) ** -1
            local = inverse * mpmath.matrix(
                [mpmath.mpf(p) - mpmath.mpf(c) for p, c in zip(facts.position, origin, strict=True)]
            )
            x, y, z = local
            radius = mpmath.sqrt(x * x + y * y)
            off = {
                SHAPE_SPHERE: [mpmath.sqrt(x * x + y * y + z * z) - 1],
                SHAPE_BOX: [abs(x) - 1, abs(y) - 1, abs(z) - 1],
                SHAPE_DISK: [z],
                SHAPE_CYLINDER_OPEN: [radius - 1],
                SHAPE_CYLINDER_CAPPED: [radius - 1, z, z - 1],
            }[kind]
            bound = sum(abs(inverse[i, j]) * facts.error[j] for i in range(3) for j in range(3))
            assert min(abs(value) for value in off) <= bound
            # and the point is where the ray is
            reach = np.abs(world_o).max() + np.abs(t * world_d).max()
            assert np.abs(np.array(facts.position) - (world_o + t * world_d)).max() <= 1e-11 * reach
    assert n_hits > 150


def test_normals_by_inverse_transpose():
    """An ellipsoid x^2/4 + y^2 + z^2/9 = 1: the gradient at the hit."""
    to_world = np.diag([2.0, 1.0, 3.0])
    to_local = np.diag([0.5, 1.0, 1.0 / 3.0])
    o, d = Vec3(5.0, 0.3, 0.9), Vec3(-1.0, 0.0, 0.0)
    t = (5.0 - 2.0 * math.sqrt(1 - 0.09 - 0.09)) / 1.0
    facts = locate_on_shape(SHAPE_SPHERE, Vec3(0.0, 0.0, 0.0), to_world.ravel(), to_local.ravel(), np.int64(0), o, d, t)
    p = np.array(facts.position)
    gradient = 2.0 * p / np.array([4.0, 1.0, 9.0])
    assert np.array(facts.normal) == pytest.approx(gradient / np.linalg.norm(gradient), abs=1e-14)


@pytest.mark.parametrize(
    ("kind", "p", "normal", "uv"),
    [
        (SHAPE_SPHERE, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.25, 0.5)),
        (SHAPE_SPHERE, (0.0, -1.0, 0.0), (0.0, -1.0, 0.0), (0.75, 0.5)),
        (SHAPE_SPHERE, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0)),
        (SHAPE_BOX, (-1.0, 0.5, -0.5), (-1.0, 0.0, 0.0), (0.75, 0.25)),
        (SHAPE_BOX, (0.5, 1.0, 0.0), (0.0, 1.0, 0.0), (0.75, 0.5)),
        (SHAPE_BOX, (0.5, 0.0, -1.0), (0.0, 0.0, -1.0), (0.75, 0.5)),
        (SHAPE_DISK, (0.5, -0.5, 0.0), (0.0, 0.0, 1.0), (0.75, 0.25)),
        (SHAPE_CYLINDER_OPEN, (0.0, 1.0, 0.25), (0.0, 1.0, 0.0), (0.25, 0.25)),
        (SHAPE_CYLINDER_CAPPED, (0.5, 0.0, 0.0), (0.0, 0.0, -1.0), (0.75, 0.5)),
        (SHAPE_CYLINDER_CAPPED, (0.0, 0.5, 1.0), (0.0, 0.0, 1.0), (0.5, 0.75)),
    ],
)
def test_texture_coordinates(kind, p, normal, uv):
    one = np.eye(3).ravel()
    o = Vec3(*(np.array(p) + 2.0 * np.array(normal)))
    facts = locate_on_shape(kind, Vec3(0.0, 0.0, 0.0), one, one, np.int64(0), o, Vec3(*(-np.array(normal))), 2.0)
    assert tuple(facts.position) == pytest.approx(p, abs=1e-15)
    assert tuple(facts.normal) == pytest.approx(normal, abs=1e-15)
    assert (facts.u, facts.v) == pytest.approx(uv, abs=1e-15)


def test_plane():
    n = np.array([1.0, 2.0, -2.0]) / 3.0
    q = np.array([5.0, -4.0, 100.0])
    rng = np.random.default_rng(9)
    uv = np.zeros(6)
    uv[[0, 4]] = 1.0
    for _ in range(200):
        o, d = rng.standard_normal((2, 3)) * 50
        t = cross_plane(Vec3(*q), Vec3(*n), Vec3(*o), Vec3(*d))
        exact = sum((mpmath.mpf(a) - mpmath.mpf(b)) * mpmath.mpf(c) for a, b, c in zip(q, o, n, strict=True)) / sum(
            mpmath.mpf(a) * mpmath.mpf(b) for a, b in zip(d, n, strict=True)
        )
        assert abs(t / exact - 1) < 1e-12
        facts = locate_on_plane(Vec3(*q), Vec3(*n), uv, np.int64(0), Vec3(*o), Vec3(*d), t)
        off = abs(
            sum((mpmath.mpf(a) - mpmath.mpf(b)) * mpmath.mpf(c) for a, b, c in zip(facts.position, q, n, strict=True))
        )
        assert off <= float(np.abs(n) @ np.array(facts.error))
        assert (facts.u, facts.v) == pytest.approx((facts.position.x - 5.0, facts.position.y + 4.0), abs=1e-12)
