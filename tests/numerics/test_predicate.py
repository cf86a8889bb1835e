"""N3 and N4: the predicate against exact rational arithmetic, on ordinary, nearly degenerate and degenerate triangles.

Two oracles. `on_floats` evaluates the definition (signs and ties of the sheared floats) with fractions: hit or miss
must agree always. `in_space` intersects ray and triangle without any rounding: hit or miss must agree wherever the
ray passes an edge by more than the shear's rounding, and t must be within its published bound.
"""

from fractions import Fraction

import numpy as np
import pytest

from tracer.jit import kernel
from tracer.rays.predicate import exact_edge, intersect_triangle, shear_of

EPS = 2.0**-53


@kernel
def run(triangles, origins, directions, met, times):
    for i in range(len(triangles)):
        kx, ky, kz, sx, sy, sz = shear_of(directions[i, 0], directions[i, 1], directions[i, 2])
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        o = origins[i]
        hit, t, _u, _v, _w = intersect_triangle(
            a[kx], a[ky], a[kz], b[kx], b[ky], b[kz], c[kx], c[ky], c[kz], o[kx], o[ky], o[kz], sx, sy, sz
        )  # fmt: skip
        met[i] = hit
        times[i] = t


@kernel
def edges(points, signs, values):
    for i in range(len(points)):
        values[i], signs[i] = exact_edge(points[i, 0], points[i, 1], points[i, 2], points[i, 3])


def predicate(triangles, origins, directions):
    n = len(triangles)
    met, times = np.empty(n, np.bool_), np.empty(n)
    run(np.ascontiguousarray(triangles), np.ascontiguousarray(origins), np.ascontiguousarray(directions), met, times)
    return met, times


def exact_sign(px, py, qx, qy):
    """The sign of the edge function, with the tie of the module's docstring."""
    value = Fraction(px) * Fraction(qy) - Fraction(py) * Fraction(qx)
    if value != 0:
        return 1 if value > 0 else -1
    if py != qy:
        return 1 if py > qy else -1
    if qx != px:
        return 1 if qx > px else -1
    return 0


def on_floats(triangle, origin, direction):
    """(met, t as a fraction of exact weights) on the sheared floats."""
    ax = np.abs(direction)
    kz = 2 if ax[2] >= ax[0] and ax[2] >= ax[1] else (1 if ax[1] >= ax[0] else 0)
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    sz = 1.0 / direction[kz]
    sx, sy = direction[kx] * sz, direction[ky] * sz
    points = []
    for vertex in triangle:
        z = vertex[kz] - origin[kz]
        points.append(
            (float((vertex[kx] - origin[kx]) - sx * z), float((vertex[ky] - origin[ky]) - sy * z), float(sz * z))
        )
    (ax_, ay, ta), (bx, by, tb), (cx, cy, tc) = points
    signs = {exact_sign(cx, cy, bx, by), exact_sign(ax_, ay, cx, cy), exact_sign(bx, by, ax_, ay)}
    if len(signs) != 1 or 0 in signs:
        return False, None
    u = Fraction(cx) * Fraction(by) - Fraction(cy) * Fraction(bx)
    v = Fraction(ax_) * Fraction(cy) - Fraction(ay) * Fraction(cx)
    w = Fraction(bx) * Fraction(ay) - Fraction(by) * Fraction(ax_)
    return (
        True,
        (u * Fraction(ta) + v * Fraction(tb) + w * Fraction(tc)) / (u + v + w),
        max(ta, tb, tc) - min(ta, tb, tc),
    )


def in_space(triangle, origin, direction):
    """(t, least barycentric weight) without rounding, or None for a parallel or empty triangle."""
    a, b, c = ([Fraction(float(x)) for x in vertex] for vertex in triangle)
    o, d = [Fraction(float(x)) for x in origin], [Fraction(float(x)) for x in direction]
    sub = lambda p, q: [x - y for x, y in zip(p, q, strict=True)]  # noqa: E731
    cross = lambda p, q: [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]  # noqa: E731
    dot = lambda p, q: sum(x * y for x, y in zip(p, q, strict=True))  # noqa: E731
    e1, e2, s = sub(b, a), sub(c, a), sub(o, a)
    p = cross(d, e2)
    det = dot(e1, p)
    if det == 0:
        return None
    u, q = dot(s, p) / det, cross(s, e1)
    v = dot(d, q) / det
    return dot(e2, q) / det, min(u, v, 1 - u - v)


def pairs(kind, n, rng):
    """Triangles, origins and directions near one kind of trouble."""
    triangles = rng.normal(size=(n, 3, 3))
    weights = rng.dirichlet((1, 1, 1), n)
    if kind == "vertex":
        weights = np.eye(3)[rng.integers(0, 3, n)]
    elif kind in {"edge", "edge by an ulp"}:
        weights[np.arange(n), rng.integers(0, 3, n)] = 0
        weights /= weights.sum(1, keepdims=True)
    elif kind == "outside":
        weights = rng.normal(size=(n, 3))
        weights /= weights.sum(1, keepdims=True)
    elif kind == "sliver":
        t = 10.0 ** rng.uniform(-12, -3, (n, 1))
        triangles[:, 2] = (
            triangles[:, 0] + (triangles[:, 1] - triangles[:, 0]) * rng.random((n, 1)) + t * rng.normal(size=(n, 3))
        )
    elif kind == "far":
        triangles += 1e7
    elif kind == "tiny":
        triangles *= 1e-140
    elif kind == "denormal":
        triangles *= 1e-309
    points = np.einsum("nk,nkc->nc", weights, triangles)
    scale = np.abs(triangles - triangles[:, :1]).max((1, 2))[:, None]
    directions = rng.normal(size=(n, 3))
    if kind == "grazing":
        plane = triangles[:, 1] - triangles[:, 0]
        directions = plane + 10.0 ** rng.uniform(-16, -6, (n, 1)) * directions
    origins = points - directions * scale * rng.uniform(0.5, 5, (n, 1))
    directions = (points - origins) / (scale if kind in {"tiny", "denormal"} else 1)
    if kind == "edge by an ulp":
        directions = np.nextafter(directions, rng.choice([-9e9, 9e9], directions.shape))
    return triangles, origins, directions


KINDS = ("inside", "outside", "vertex", "edge", "edge by an ulp", "sliver", "grazing", "far", "tiny", "denormal")


@pytest.mark.parametrize("kind", KINDS)
def test_hit_or_miss_is_exact_and_t_within_its_bound(kind):
    triangles, origins, directions = pairs(kind, 600, np.random.default_rng(21))
    met, times = predicate(triangles, origins, directions)
    n_met = 0
    for i in range(len(triangles)):
        want = on_floats(triangles[i], origins[i], directions[i])
        assert met[i] == want[0], i
        if met[i] and np.isfinite(times[i]):
            n_met += 1
            _, t, spread = want
            # products of denormals lose what no weight can make good
            relative = 3 * 2.0**-24 if kind == "denormal" else 8 * EPS
            bound = relative * spread + 4 * EPS * abs(float(t)) + 5e-324
            assert abs(Fraction(float(times[i])) - t) <= bound, i
    assert n_met > 50 or kind in {"denormal", "grazing", "outside"}


@pytest.mark.parametrize("kind", ["inside", "outside", "far"])
def test_agrees_with_space(kind):
    """Away from edges the shear's rounding does not matter; t is good to a few ulps of the distances involved."""
    triangles, origins, directions = pairs(kind, 500, np.random.default_rng(22))
    met, times = predicate(triangles, origins, directions)
    decided = 0
    for i in range(len(triangles)):
        exact = in_space(triangles[i], origins[i], directions[i])
        if exact is None or abs(exact[1]) < 1e-6:
            continue
        decided += 1
        assert met[i] == (exact[1] > 0)
        if met[i]:
            size = float(np.abs(triangles[i] - origins[i]).max())
            normal = np.cross(triangles[i, 1] - triangles[i, 0], triangles[i, 2] - triangles[i, 0])
            slope = np.linalg.norm(normal) / abs(normal @ directions[i])  # how far t moves with the ray
            assert abs(float(Fraction(float(times[i])) - exact[0])) <= 64 * EPS * size * slope
    assert decided > 300


def test_edge_signs_are_exact():
    """Nearly collinear points, at all magnitudes down to denormals: sign and tie against fractions."""
    rng = np.random.default_rng(23)
    rows = []
    for i in range(6000):
        a, b = rng.normal(size=2) * 2.0 ** rng.integers(-30, 30, 2)
        f = rng.random()
        kind = i % 6
        c, d = [
            (a * 3, b * 3),
            (a * f, b * f),
            (np.nextafter(a * f, 9e9), b * f),
            (a, b),
            (-a, -b),
            (a, np.nextafter(b, 9e9)),
        ][kind]
        if i % 7 == 0:
            b = 0.0
        rows.append([a, b, c, d])
    rows = np.array(rows)
    wide = rows.copy()
    wide[:, :2] *= 2.0 ** rng.integers(-1000, 100, (len(rows), 1))
    wide[:, 2:] *= 2.0 ** rng.integers(-1000, 100, (len(rows), 1))
    columns = rows * 2.0 ** rng.integers(-1060, 100, (len(rows), 1))
    for points in (rows, wide, columns, np.trunc(rows * 8) * 5e-324):
        signs, values = np.empty(len(points), np.int64), np.empty(len(points))
        edges(np.ascontiguousarray(points), signs, values)
        assert signs.tolist() == [exact_sign(*(float(x) for x in row)) for row in points]


def test_triangles_without_area_are_never_met():
    """N4: a repeated vertex, three equal ones; collinear ones cross at most as their rounded projection does."""
    rng = np.random.default_rng(24)
    triangles, origins, directions = pairs("vertex", 400, rng)
    triangles[:, 2] = triangles[:, 0]
    assert not predicate(triangles, origins, directions)[0].any()
    triangles[:, 1] = triangles[:, 0]
    assert not predicate(triangles, origins, directions)[0].any()


@pytest.mark.parametrize(
    "corners",
    [
        [(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)],  # seen through a vertex
        [(-1.0, -1.0, 1.0), (1.0, 1.0, 2.0), (3.0, 3.0, 1.0)],  # through an edge
        [(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 0.0, 1.0)],
        [(0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (0.0, 0.0, 3.0)],  # seen end-on
    ],
)
def test_lines_are_never_met(corners):
    """Exactly collinear, in every order of the vertices, by a ray along an axis that goes through them."""
    orders = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (1, 0, 2), (0, 2, 1)]
    triangles = np.array([[corners[k] for k in order] for order in orders])
    assert not predicate(triangles, np.zeros((6, 3)), np.tile([0.0, 0.0, 1.0], (6, 1)))[0].any()


def test_published_bad_cases():
    """Triangles that other tracers lose: Embree #387 (a long thin one hit at a shared edge), and one seen edge-on."""
    triangles = np.array(
        [
            [[-1, -1, 0], [1, -1, 0], [0, 1, 0]],
            [[0, 0, 0], [1e8, 0, 0], [0, 1e-8, 0]],
            [[0, -1, -1], [0, 1, -1], [0, 0, 1]],
        ],
        float,
    )
    origins = np.array([[0, 0, 1], [1e7, 1e-9, 1], [0, 0, -5]], float)
    directions = np.array([[0, 0, -1], [0, 0, -1], [0, 0, 1]], float)
    met, times = predicate(triangles, origins, directions)
    want = [on_floats(*item)[0] for item in zip(triangles, origins, directions, strict=True)]
    assert met.tolist() == want
    assert met[:2].all()
    assert times[:2].tolist() == [1.0, 1.0]
