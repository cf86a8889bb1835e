"""Rows of a picture are found, and nothing is found where there are none."""

import numpy as np
import pytest
from test_paths import bumpy

from tracer.rays import RayCaster
from tracer.rays.caster import checked_rays
from tracer.rays.neighbours import go_together, row_length

VERTICES, FACES = bumpy(12)
TREE = RayCaster(VERTICES, FACES).bvh.buffer


def picture(width, height):
    """Rays of a pinhole in the order of a picture's rows."""
    y, x = np.meshgrid(np.arange(height) / height - 0.5, np.arange(width) / width - 0.5, indexing="ij")
    directions = np.stack([x, y * height / width, np.ones_like(x)], -1).reshape(-1, 3)
    return np.broadcast_to(np.array([0.0, 0.1, -1.8]), directions.shape).copy(), directions


def packed(origins, directions):
    rays = checked_rays(origins, directions, 0.0, np.inf)
    return rays, rays.packed


@pytest.mark.parametrize(("width", "height"), [(40, 30), (64, 64), (333, 150), (1000, 40)])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_rows_of_a_picture(width, height, kind):
    origins, directions = picture(width, height)
    rays, numbers = packed(origins.astype(kind), directions.astype(kind))
    assert row_length(TREE, numbers, rays.n) == width


def test_rows_of_rays_to_a_light():
    """From where the picture's rays meet something."""
    origins, directions = picture(200, 160)
    hits = RayCaster(VERTICES, FACES).closest_hit(origins, directions)
    points = origins + 0.999 * hits.t[:, None] * directions
    rays, numbers = packed(points, np.array([0.3, 1.8, -1.0]) - points)
    assert abs(row_length(TREE, numbers, rays.n) - 200) <= 1  # a diagonal neighbour may be as near
    assert go_together(TREE, numbers, rays.n) > 0.5


def test_random_rays_have_no_rows_and_go_their_own_ways():
    rng = np.random.default_rng(6)
    rays, numbers = packed(rng.normal(size=(5000, 3)), rng.normal(size=(5000, 3)))
    assert row_length(TREE, numbers, rays.n) == 0
    assert go_together(TREE, numbers, rays.n) == 0.0


def test_one_long_row():
    """Side by side, but nothing below."""
    angle = np.linspace(-0.5, 0.5, 5000)
    directions = np.stack([angle, 0 * angle, 1 + 0 * angle], -1)
    rays, numbers = packed(np.zeros((5000, 3)), directions)
    assert row_length(TREE, numbers, rays.n) == 0
    assert go_together(TREE, numbers, rays.n) == 1.0


def test_what_is_no_ray():
    rays, numbers = packed(np.full((2000, 3), np.nan), np.zeros((2000, 3)))
    assert row_length(TREE, numbers, rays.n) == 0
    assert go_together(TREE, numbers, rays.n) == 0.0
