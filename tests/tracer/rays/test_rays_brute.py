"""Few triangles without a tree: every ray gets the answer that it gets alone. The stress suite (N2) has the hard ones."""

import numpy as np
import pytest
from test_paths import adversarial
from test_rays_coherent import answers

from tests.numerics.closed_meshes import cube
from tracer.rays import RayCaster
from tracer.rays import caster as caster_module
from tracer.rays.brute import trace_brute
from tracer.rays.brute_table import FEW
from tracer.rays.caster import checked_rays
from tracer.rays.single import trace_single

CORNERS, BOX = cube()
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def room(dtype=np.float64):
    """A box with a turned one and a thin one in it: 36 triangles."""
    boxes = [CORNERS * 2.0, CORNERS @ TURN * 0.5, CORNERS * [0.9, 0.01, 0.3] + [0.2, -0.9, 0.1]]
    return np.concatenate(boxes).astype(dtype), np.concatenate([BOX, BOX + 8, BOX + 16])


def assert_same(caster, rays, start=0, end=None):
    end = rays.n if end is None else end
    alone = answers(trace_single, caster, rays, start, end)
    found = answers(trace_brute, caster, rays, start, end, caster.few_triangles.ctypes.data)
    for one, other in zip(alone, found, strict=True):
        np.testing.assert_array_equal(one, other)
    return alone


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_room(dtype):
    vertices, faces = room(dtype)
    rays = checked_rays(*adversarial(vertices, faces, 20_000, np.random.default_rng(2)))
    _t, primitive, *_ = assert_same(RayCaster(vertices, faces), rays)
    assert 0.3 < (primitive >= 0).mean() < 0.95
    assert len(np.unique(primitive)) > 30


@pytest.mark.parametrize("n", [1, 2, 31, 32, 33, 63, 64])
def test_any_number_of_loose_triangles(n):
    rng = np.random.default_rng(n)
    vertices, faces = rng.normal(size=(3 * n, 3)), np.arange(3 * n).reshape(n, 3)
    rays = checked_rays(*adversarial(vertices, faces, 5000, rng))
    _t, primitive, *_ = assert_same(RayCaster(vertices, faces), rays)
    assert primitive.max() == n - 1


def test_coincident_triangles():
    """The lowest row is met, whichever of them stand in pairs."""
    doubled = np.concatenate([BOX, BOX[:, [2, 0, 1]], BOX[::-1]])
    rays = checked_rays(*adversarial(CORNERS, BOX, 5000, np.random.default_rng(3)))
    _t, primitive, *_ = assert_same(RayCaster(CORNERS, doubled), rays)
    assert primitive.max() < len(BOX)


@pytest.mark.parametrize(("start", "end"), [(0, 63), (0, 64), (5, 70), (3, 1000), (17, 18), (40, 40)])
def test_parts_of_a_batch(start, end):
    rays = checked_rays(*adversarial(*room(), 1200, np.random.default_rng(4)))
    assert_same(RayCaster(*room()), rays, start, end)


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1e-6), (1e5, 1.0), (1e9, 1e6), (0.0, 1e-80), (3.0, 1e60)])
def test_at_other_places_and_scales(offset, scale):
    vertices, faces = room()
    origins, directions, t_min, t_max = adversarial(vertices, faces, 5000, np.random.default_rng(5))
    shift = np.array([1.0, -0.6, 0.3]) * offset
    caster = RayCaster((vertices + shift) * scale, faces)
    assert_same(caster, checked_rays((origins + shift) * scale, directions * scale, t_min, t_max))


def test_rays_from_far_away_go_through_the_tree():
    """More of them than wait at a time."""
    vertices, faces = room()
    rng = np.random.default_rng(6)
    origins = rng.normal(size=(10_000, 3)) * 10.0 ** rng.uniform(0, 20, (10_000, 1))
    rays = checked_rays(origins, rng.normal(size=origins.shape) * 0.3 - origins, 0.0, np.inf)
    _t, primitive, *_ = assert_same(RayCaster(vertices, faces), rays)
    assert (primitive >= 0).mean() > 0.5


@pytest.mark.parametrize(("faces", "used"), [(BOX, True), (np.tile(BOX, (FEW // 12 + 1, 1)), False)])
def test_the_caster_goes_without_a_tree_where_triangles_are_few(faces, used, monkeypatch):
    caster = RayCaster(CORNERS, faces)
    rng = np.random.default_rng(7)
    origins, directions = rng.uniform(-1, 1, (20_000, 3)), rng.normal(size=(20_000, 3))
    rays = checked_rays(origins, directions, 0.0, np.inf)
    alone = answers(trace_single, caster, rays, 0, rays.n)
    sent = []

    def spy(*given):
        sent.append(given[2:4])
        trace_brute(*given)

    monkeypatch.setattr(caster_module, "trace_brute", spy)
    for threads in (1, 2):
        hits = caster.closest_hit(origins, directions, threads=threads)
        for one, other in zip(alone[:4], hits, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(caster.any_hit(origins, directions, threads=threads), alone[1] >= 0)
    assert bool(sent) == used
