"""One leaf against four rays and against a beam.

The exact tests of rays are compared with the scalar predicate on triangles that are hard to decide; what the beam says
of a triangle (no ray meets it, all rays meet it) is compared with many rays of the beam, in plain numpy.
"""

import numpy as np
import pytest

from tests.numerics.closed_meshes import by_brute_force
from tests.tracer.rays.packets import WAYS, brute_light, follow, tree_of
from tracer.jit import int64, kernel
from tracer.rays.beam import (
    BEAM_BYTES,
    BEAM_CENTRE,
    BEAM_FIRST,
    BEAM_HALF,
    BEAM_LAST,
    BEAM_SCALE,
    BEAM_SIGN,
    BEAM_SURE_FIRST,
    BEAM_SURE_LAST,
    BEAM_X_SLOPE,
    BEAM_X_SPREAD,
    BEAM_X_START,
    BEAM_X_WIDTH,
    BEAM_Y_SLOPE,
    BEAM_Y_SPREAD,
    BEAM_Y_START,
    BEAM_Y_WIDTH,
)
from tracer.rays.packet_cut import cut_leaf
from tracer.simd import address_of


def hard_triangles(kind, n, rng):
    """Triangles about the z axis and targets near one kind of trouble."""
    triangles = rng.normal(size=(n, 3, 3))
    weights = rng.dirichlet((1, 1, 1), n)
    if kind == "vertex":
        weights = np.eye(3)[rng.integers(0, 3, n)]
    elif kind == "edge":
        weights[np.arange(n), rng.integers(0, 3, n)] = 0
        weights /= weights.sum(1, keepdims=True)
    elif kind == "sliver":
        along = triangles[:, 1] - triangles[:, 0]
        triangles[:, 2] = (
            triangles[:, 0] + along * rng.random((n, 1)) + 10.0 ** rng.uniform(-16, -6, (n, 1)) * along[:, ::-1]
        )
    elif kind == "point":
        triangles[:, 1] = triangles[:, 0]
    elif kind == "far":
        triangles += 1e7
    return triangles, np.einsum("nk,nkc->nc", weights, triangles)


@pytest.mark.parametrize("n_triangles", [1, 2, 3, 4, 5, 7, 8])
@pytest.mark.parametrize("kind", ["inside", "vertex", "edge", "sliver", "point", "far"])
def test_leaves_of_any_size_decide_as_the_predicate_does(kind, n_triangles):
    rng = np.random.default_rng(70 + n_triangles)
    triangles, targets = hard_triangles(kind, n_triangles, rng)
    vertices, faces = triangles.reshape(-1, 3), np.arange(3 * n_triangles).reshape(-1, 3)
    tree = tree_of(vertices, faces)
    target = targets[rng.integers(0, n_triangles, 512)]
    origins = target + rng.normal(size=(512, 3)) * rng.choice([1e-3, 1.0, 30.0], (512, 1))
    directions = target - origins
    directions[::3] = np.nextafter(directions[::3], rng.choice([-9e9, 9e9], (171, 3)))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    times, primitives, _ = by_brute_force(vertices, faces, origins, directions)
    kt = 2.0 ** -rng.integers(1, 3, (n_triangles, 3))
    light, _ = brute_light(vertices, faces, origins, directions, kt=kt)
    for way in WAYS:
        found = follow(tree, origins, directions, way=way)
        np.testing.assert_array_equal(found.primitive, primitives)
        np.testing.assert_array_equal(found.t, times)
        np.testing.assert_array_equal(follow(tree, origins, directions, mode="shade", kt=kt, way=way).light, light)
    if kind == "inside":
        assert (primitives >= 0).mean() > 0.9
    if kind == "point":
        assert (primitives == -1).all()


def test_weights_are_those_of_the_vertices_as_given():
    """In all six orders, against solving for them."""
    rng = np.random.default_rng(71)
    corners = rng.normal(size=(3, 3))
    for order in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (1, 0, 2), (0, 2, 1)]:
        face = np.array([order])
        weights = rng.dirichlet((1, 1, 1), 64)
        origins = rng.normal(size=(64, 3)) * 4
        directions = weights @ corners[face[0]] - origins
        found = follow(tree_of(corners, face), origins, directions)
        np.testing.assert_allclose(found.u, weights[:, 1], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.v, weights[:, 2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.t, 1.0, rtol=1e-12)


# --- the beam -------------------------------------------------------------------------------------------------------


@kernel
def _cut(rows, n, size, kx, ky, kz, beam):
    """Bits of the triangles that some ray may meet, and of those that all meet on their way."""
    axes = (int64(kx), int64(ky), int64(kz))
    bits, inside, on_the_way = cut_leaf(address_of(rows), int64(n), int64(size), axes, address_of(beam))
    return bits, inside & on_the_way


def beam_of(axis, sign, x, y, first, last, sure_first, sure_last, centre=(0.0, 0.0, 0.0), scale=1.0):
    """Beam memory; x and y are (slope, start, spread, width)."""
    memory = np.full(BEAM_BYTES // 8 + 8, np.nan)
    order = ((axis + 1) % 3, (axis + 2) % 3, axis)
    for k in range(3):
        memory[BEAM_CENTRE // 8 + k] = centre[order[k]]
    values = {BEAM_SCALE: scale, BEAM_SIGN: sign, BEAM_HALF: 2.0, BEAM_FIRST: first, BEAM_LAST: last}
    values |= {BEAM_SURE_FIRST: sure_first, BEAM_SURE_LAST: sure_last}
    values |= dict(zip((BEAM_X_SLOPE, BEAM_X_START, BEAM_X_SPREAD, BEAM_X_WIDTH), x, strict=True))
    values |= dict(zip((BEAM_Y_SLOPE, BEAM_Y_START, BEAM_Y_SPREAD, BEAM_Y_WIDTH), y, strict=True))
    for offset, value in values.items():
        memory[offset // 8] = value
    return memory, order


def meets(triangles, lines, sign, order):
    """Which straight lines x = a + b depth, y = c + d depth meet which triangles, by edge functions: (lines, triangles)."""
    kx, ky, kz = order
    depth = sign * triangles[:, :, kz]
    a, b, c, d = (lines[:, k, None, None] for k in range(4))
    px, py = triangles[:, :, kx] - (a + b * depth), triangles[:, :, ky] - (c + d * depth)
    edges = [px[..., i] * py[..., j] - py[..., i] * px[..., j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return ((edges[0] > 0) & (edges[1] > 0) & (edges[2] > 0)) | ((edges[0] < 0) & (edges[1] < 0) & (edges[2] < 0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", [1e-9, 0.02, 0.3])
def test_what_a_beam_leaves_out_no_ray_of_it_meets(width, dtype):
    """And what all are said to meet, all of them meet. Neither answer is empty: most of what can be told is told."""
    rng = np.random.default_rng(72)
    n_out = n_missed = n_sure = n_covered = 0
    for case in range(400):
        axis, sign, n = case % 3, (-1.0, 1.0)[case % 2], case % 8 + 1
        centres = rng.uniform(-1, 1, (n, 1, 3))
        triangles = (centres + rng.normal(size=(n, 3, 3)) * rng.choice([0.05, 0.3, 1.5], (n, 1, 1))).clip(-1.9, 1.9)
        triangles = triangles.astype(dtype).astype(np.float64)
        slope, start = rng.uniform(-0.9, 0.9, 2), rng.uniform(-0.5, 0.5, 2)
        spread = rng.uniform(-0.2, 0.2, 2) * width
        beam, order = beam_of(
            axis, sign, (slope[0], start[0], spread[0], width), (slope[1], start[1], spread[1], width), -3, 3, -3, 3
        )
        rows = np.ascontiguousarray(triangles.reshape(n, 9).T, dtype)
        memory = np.zeros(rows.size + 64, dtype)
        memory[: rows.size] = rows.ravel()
        bits, sure = _cut(memory, n, rows.itemsize, *order, beam)
        assert bits >> n == 0
        # lines that stay within the beam at depths of -2 .. 2
        at_near, at_far = (rng.uniform(-1, 1, (200, 2)) for _ in range(2))
        at_near[:4], at_far[:4] = [[1, 1], [-1, -1], [1, -1], [-1, 1]], [[1, 1], [-1, -1], [-1, 1], [1, -1]]
        near = slope * -2 + start + at_near * (width - 2 * spread)
        far = slope * 2 + start + at_far * (width + 2 * spread)
        b = (far - near) / 4
        a = near + 2 * b
        met = meets(triangles, np.stack([a[:, 0], b[:, 0], a[:, 1], b[:, 1]], 1), sign, order)
        kept = np.array([(bits >> k) & 1 for k in range(n)], bool)
        told = np.array([(sure >> k) & 1 for k in range(n)], bool)
        assert not (met.any(0) & ~kept).any(), case
        assert met[:, told].all(), case
        n_out += (~kept).sum()
        n_missed += (~met.any(0)).sum()
        n_sure += told.sum()
        n_covered += met.all(0).sum()
    assert n_out > 0.6 * n_missed > 50
    assert n_sure > (0.9 if width < 1e-3 else 0.05) * n_covered


def test_depths_decide_who_is_on_the_way():
    """A triangle across the beam, before, in and behind the depths of the rays, and where only some have got."""
    triangle = np.array([[-5.0, -5.0, 0.5, 5.0, -5.0, 0.5, 0.0, 7.0, 0.5]]).reshape(9, 1)
    memory = np.zeros(64)
    memory[:9] = triangle[:, 0]
    thin = (0.0, 0.0, 0.0, 1e-9)
    for first, last, sure_first, sure_last, kept, sure in [
        (-1.0, 1.0, 0.0, 1.0, 1, 1),
        (0.6, 1.0, 0.6, 1.0, 0, 0),
        (-1.0, 0.4, -1.0, 0.4, 0, 0),
        (-1.0, 1.0, 0.6, 1.0, 1, 0),  # the last ray begins behind it
        (-1.0, 1.0, 0.0, 0.4, 1, 0),  # the first one ends before it
    ]:
        beam, order = beam_of(2, 1.0, thin, thin, first, last, sure_first, sure_last)
        bits, told = _cut(memory, 1, 8, *order, beam)
        assert (bits, told & bits) == (kept, sure)


def test_beyond_the_depths_that_the_lines_hold_for_nothing_is_told_of_the_sides():
    triangle = np.array([30.0, 30.0, 2.5, 31.0, 30.0, 2.5, 30.0, 31.0, 2.5])
    memory = np.zeros(64)
    memory[:9] = triangle
    thin = (0.0, 0.0, 0.0, 1e-9)
    beam, order = beam_of(2, 1.0, thin, thin, -9.0, 9.0, -9.0, 9.0)
    bits, told = _cut(memory, 1, 8, *order, beam)
    assert (bits, told & bits) == (1, 0)
