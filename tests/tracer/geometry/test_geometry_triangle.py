"""The exact triangle against rational arithmetic, and closed meshes against topology."""

import math
from fractions import Fraction

import numpy as np
import pytest

from tracer.geometry.rounding import EPSILON
from tracer.geometry.triangle import edge_function, edge_sign, intersect_sheared, shear_ray, shear_vertex
from tracer.types import Vec3


def exact_edge(p, q):
    return Fraction(p[0]) * Fraction(q[1]) - Fraction(p[1]) * Fraction(q[0])


def exact_sign(p, q):
    """Sign of the edge function, ties by moving the origin to (delta, delta^2), delta -> 0+."""
    value = exact_edge(p, q)
    if value == 0:  # d/d(delta): the edge function of (p - e, q - e) gains e x (p - q) ...
        value = Fraction(p[1]) - Fraction(q[1]) or Fraction(q[0]) - Fraction(p[0])
    return (value > 0) - (value < 0)


def exact_hit(a, b, c, sz):
    """(t, v, w) in Fractions, or None."""
    signs = {exact_sign(c, b), exact_sign(a, c), exact_sign(b, a)}
    if len(signs) > 1 or 0 in signs:
        return None
    u, v, w = exact_edge(c, b), exact_edge(a, c), exact_edge(b, a)
    det = u + v + w
    depth = [Fraction(sz * vertex[2]) for vertex in (a, b, c)]
    return (u * depth[0] + v * depth[1] + w * depth[2]) / det, v / det, w / det


def nearly_collinear(rng, n):
    """Pairs p, q whose edge function is within a few roundings of zero, or zero."""
    for _ in range(n):
        p = rng.standard_normal(2) * 2.0 ** rng.integers(-20, 20)
        s = rng.standard_normal() if rng.random() < 0.7 else 2.0 ** rng.integers(-8, 8)
        q = p * s
        for _ in range(rng.integers(0, 3)):
            q[rng.integers(2)] = np.nextafter(q[rng.integers(2)], rng.choice([-np.inf, np.inf]))
        yield tuple(map(float, p)), tuple(map(float, q))
    for x, y in [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (-0.0, 0.0), (3.0, 3.0)]:
        for z, w in [(0.0, 2.0), (2.0, 0.0), (0.0, 0.0), (1.0, 1.0), (-1.0, -1.0)]:
            yield (x, y), (z, w)


def test_edge_signs_are_exact_and_antisymmetric():
    rng = np.random.default_rng(3)
    ties = 0
    for p, q in nearly_collinear(rng, 3000):
        assert edge_sign(*p, *q) == exact_sign(p, q)
        assert edge_sign(*q, *p) == -edge_sign(*p, *q)
        ties += exact_edge(p, q) == 0
    assert ties > 100  # the adversary does reach the ties


def test_edge_function_is_accurate_under_cancellation():
    rng = np.random.default_rng(4)
    for p, q in nearly_collinear(rng, 3000):
        exact = exact_edge(p, q)
        assert abs(Fraction(edge_function(*p, *q)) - exact) <= 4 * Fraction(EPSILON) * abs(exact)


def random_triangles(rng, n):
    """Sheared triangles: ordinary, slivers, and such with a vertex or an edge on the ray to within roundings."""
    for k in range(n):
        kind = k % 4
        corners = rng.standard_normal((3, 3)) * 2.0 ** rng.integers(-10, 10)
        if kind == 1:  # a sliver
            corners[2, :2] = corners[0, :2] + (corners[1, :2] - corners[0, :2]) * rng.random() * (1 + 2e-16)
        elif kind == 2:  # an edge through the ray
            corners[1, :2] = -corners[0, :2] * rng.random()
        elif kind == 3:  # a vertex on the ray
            corners[rng.integers(3), :2] = rng.choice([0.0, -0.0, 1e-300, 1e-17], 2)
        yield [tuple(map(float, corner)) for corner in corners]


def slivers(rng, n):
    """Triangles 1e-16 to 1e-10 wide about a line through the ray, whose corners differ in depth."""
    for _ in range(n):
        angle = rng.random() * 2 * np.pi
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        place = np.array([-1.0, 1.0, rng.uniform(-1, 1)]) * rng.random(3)
        width = rng.choice([-1, 1], 3) * 10.0 ** rng.uniform(-16, -10, 3)
        flat = np.outer(place, along) + np.outer(width, across)
        yield [(*map(float, p), float(z)) for p, z in zip(flat, rng.uniform(1, 3, 3), strict=True)]


def test_depth_of_slivers():
    rng = np.random.default_rng(15)
    n_hits = 0
    for a, b, c in slivers(rng, 4000):
        found, exact = intersect_sheared(Vec3(*a), Vec3(*b), Vec3(*c), 1.0), exact_hit(a, b, c, 1.0)
        assert math.isnan(found.t) == (exact is None)
        if exact is not None:
            n_hits += 1
            assert abs(Fraction(found.t) - exact[0]) <= 24 * Fraction(EPSILON) * 3
            assert abs(Fraction(found.v) - exact[1]) <= 1e-6  # the weights of a sliver are worth less than its depth
    assert n_hits > 500


def test_hits_and_misses_are_exact():
    rng = np.random.default_rng(5)
    n_hits = 0
    for a, b, c in random_triangles(rng, 6000):
        sz = float(rng.standard_normal())
        found = intersect_sheared(Vec3(*a), Vec3(*b), Vec3(*c), sz)
        exact = exact_hit(a, b, c, sz)
        assert math.isnan(found.t) == (exact is None)
        if exact is None:
            continue
        n_hits += 1
        farthest = max(abs(sz * vertex[2]) for vertex in (a, b, c))
        assert abs(Fraction(found.t) - exact[0]) <= 24 * Fraction(EPSILON) * Fraction(farthest)
        assert min(sz * a[2], sz * b[2], sz * c[2]) <= found.t <= max(sz * a[2], sz * b[2], sz * c[2])
        assert -1e-300 <= found.v <= 1.0 + 1e-12
        assert -1e-300 <= found.w <= 1.0 + 1e-12
    assert n_hits > 500


@pytest.mark.parametrize(
    "corners",
    [
        [(1.0, 1.0, 1.0)] * 3,
        [(0.0, 0.0, 1.0)] * 3,
        [(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)],
        [(-1.0, -1.0, 1.0), (1.0, 1.0, 2.0), (3.0, 3.0, 1.0)],
        [(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 0.0, 1.0)],
        [(0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (0.0, 0.0, 3.0)],
    ],
)
def test_degenerate_triangles_are_never_hit(corners):
    for order in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (1, 0, 2), (0, 2, 1)]:
        a, b, c = (Vec3(*corners[k]) for k in order)
        assert math.isnan(intersect_sheared(a, b, c, 1.0).t)


def test_weights_of_a_plain_triangle():
    """The point with weights (1/4, 1/2, 1/4) at depth 3."""
    a, b, c = Vec3(-1.0, -1.0, 3.0), Vec3(1.0, 0.0, 3.0), Vec3(-1.0, 1.0, 3.0)
    hit = intersect_sheared(a, b, c, 0.5)
    assert (hit.t, hit.v, hit.w) == (1.5, 0.5, 0.25)


def test_shear_brings_the_ray_to_the_axis():
    rng = np.random.default_rng(6)
    for _ in range(200):
        o, d = rng.standard_normal((2, 3))
        t = float(rng.random() * 10)
        ray = shear_ray(Vec3(*o.tolist()), Vec3(*d.tolist()))
        p = (o + t * d).tolist()
        v = shear_vertex(p[ray.kx], p[ray.ky], p[ray.kz], ray)
        assert abs(v.x) < 1e-14
        assert abs(v.y) < 1e-14
        assert v.z * ray.sz == pytest.approx(t, rel=1e-12, abs=1e-14)
        assert abs(ray.sx) <= 1.0
        assert abs(ray.sy) <= 1.0
