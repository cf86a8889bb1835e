"""Batches in tiles: every ray gets the answer that it gets alone, wherever the tiles' edges are."""

import numpy as np
import pytest
from test_paths import adversarial, bumpy
from test_rays_neighbours import picture

from tracer.rays import RayCaster
from tracer.rays import caster as caster_module
from tracer.rays.caster import Hits, checked_rays
from tracer.rays.coherent import trace_coherent
from tracer.rays.leaf import ANY, CLOSEST
from tracer.rays.single import trace_single

VERTICES, FACES = bumpy(24)


def answers(path, caster, rays, start, end, *more):
    """All that a path says about rays start..end; rows it must not touch are -7."""
    found = []
    for mode in (CLOSEST, ANY):
        hits = Hits(np.full(rays.n, -7.0), np.full(rays.n, -7, np.int32), np.full(rays.n, -7.0), np.full(rays.n, -7.0))
        path(caster.bvh.buffer, rays.packed, start, end, mode, *hits, *more)
        found += hits
    return found


def assert_same(caster, rays, width, start=0, end=None):
    end = rays.n if end is None else end
    alone = answers(trace_single, caster, rays, start, end)
    tiles = answers(trace_coherent, caster, rays, start, end, width)
    for one, other in zip(alone, tiles, strict=True):
        np.testing.assert_array_equal(one, other)
    return alone


@pytest.mark.parametrize(("width", "height"), [(40, 30), (41, 9), (8, 8), (100, 17), (64, 1), (200, 3)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pictures(width, height, dtype):
    vertices, faces = bumpy(24, dtype)
    origins, directions = picture(width, height)
    rays = checked_rays(origins.astype(dtype), directions.astype(dtype), 0.0, np.inf)
    assert_same(RayCaster(vertices, faces), rays, width)


@pytest.mark.parametrize(("start", "end"), [(3, 1100), (0, 64), (0, 63), (17, 18), (40, 40), (1, 400)])
@pytest.mark.parametrize("width", [0, 7, 8, 40, 5000])
def test_parts_of_a_picture(start, end, width):
    rays = checked_rays(*picture(40, 30), 0.0, np.inf)
    assert_same(RayCaster(VERTICES, FACES), rays, width, start, end)


def aimed(rng, width, height):
    """A picture whose rays go through vertices and edges, as near each other as those are."""
    origins, directions = picture(width, height)
    face = FACES[12:]
    n = len(origins)
    centre = VERTICES[face].mean(1)
    order = np.lexsort((centre[:, 0], np.floor(8 * centre[:, 1])))  # bands of the sphere, from side to side
    a, b = (VERTICES[face[order[np.arange(n) % len(face)], k]] for k in (0, 1))
    return origins, np.where(rng.random((n, 1)) < 0.5, a, (a + b) / 2) - origins, directions


@pytest.mark.parametrize("width", [0, 48])
def test_at_vertices_and_edges(width):
    rng = np.random.default_rng(7)
    origins, directions, _ = aimed(rng, 48, 64)
    _t, primitive, *_ = assert_same(RayCaster(VERTICES, FACES), checked_rays(origins, directions, 0.0, np.inf), width)
    assert (primitive >= 0).all()


@pytest.mark.parametrize("width", [0, 48])
def test_limits_of_each_ray_and_what_is_no_ray(width):
    rng = np.random.default_rng(8)
    origins, aims, directions = aimed(rng, 48, 64)
    n = len(origins)
    directions = np.where(rng.random((n, 1)) < 0.3, aims, directions)
    kind = rng.integers(0, 40, n)
    origins[kind == 0] = np.nan
    directions[kind == 1] = 0.0
    directions[kind == 2, 1] = np.inf
    directions[kind == 3] *= 1e-200
    directions[kind == 4] *= 1e200
    directions[kind == 5] *= -1.0
    origins[kind == 6] *= 1e9
    t_min = np.where(rng.random(n) < 0.5, 0.0, rng.normal(size=n) + 1.0)
    t_max = np.where(rng.random(n) < 0.5, np.inf, rng.normal(size=n) + 2.0)
    t_min[kind == 7], t_max[kind == 8] = np.nan, np.nan
    _t, primitive, *_ = assert_same(RayCaster(VERTICES, FACES), checked_rays(origins, directions, t_min, t_max), width)
    assert 0.1 < (primitive >= 0).mean() < 0.9


def test_from_a_corner_along_all_axes():
    """Each tile holds rays of several axes and senses."""
    rng = np.random.default_rng(9)
    directions = rng.choice([-1.0, 1.0], (2000, 3)) + rng.normal(size=(2000, 3)) * 1e-3
    assert_same(RayCaster(VERTICES, FACES), checked_rays(np.full((2000, 3), 0.1), directions, 0.0, np.inf), 0)


@pytest.mark.parametrize("width", [0, 40])
def test_incoherent_rays(width):
    rays = checked_rays(*adversarial(VERTICES, FACES, 3000, np.random.default_rng(10)))
    assert_same(RayCaster(VERTICES, FACES), rays, width)


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1e-6), (1e5, 1.0), (1e9, 1e6), (0.0, 1e-80), (3.0, 1e60)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_at_other_places_and_scales(offset, scale, dtype):
    if dtype == np.float32 and not 1e-30 < scale < 1e30:
        pytest.skip("float32 holds no coordinates of this size; float64 is tested")
    shift = np.array([1.0, -0.6, 0.3]) * offset
    origins, directions = picture(48, 48)
    caster = RayCaster(((VERTICES + shift) * scale).astype(dtype), FACES)
    assert_same(caster, checked_rays((origins + shift) * scale, directions * scale, 0.0, np.inf), 48)


def test_coincident_triangles():
    doubled = np.concatenate([FACES, FACES[:, [2, 0, 1]], FACES])
    _t, primitive, *_ = assert_same(RayCaster(VERTICES, doubled), checked_rays(*picture(64, 48), 0.0, np.inf), 64)
    assert primitive.max() < len(FACES)


def test_the_caster_sends_pictures_in_tiles(monkeypatch):
    """On as many threads as it likes, with the same answers."""
    caster = RayCaster(VERTICES, FACES)
    origins, directions = picture(200, 190)
    rays = checked_rays(origins, directions, 0.0, np.inf)
    t, primitive, u, v, *_ = answers(trace_single, caster, rays, 0, rays.n)
    sent = []

    def spy(*given):
        sent.append(given[2:4])
        trace_coherent(*given)

    monkeypatch.setattr(caster_module, "trace_coherent", spy)
    for threads in (1, 2):
        hits = caster.closest_hit(origins, directions, threads=threads)
        for one, other in zip((t, primitive, u, v), hits, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(caster.any_hit(origins, directions, threads=threads), primitive >= 0)
    assert sent[:2] == [(0, rays.n), (0, rays.n)]
    assert all(start % (8 * 200) == 0 for start, _end in sent)
    assert len(sent) > 4
