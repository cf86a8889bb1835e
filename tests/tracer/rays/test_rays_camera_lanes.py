"""Camera rays four at a time against equation 1 and against those one at a time: the same bits, at any scale."""

import numpy as np
import pytest

from tracer.jit import int64, kernel
from tracer.rays.camera import camera_ray, unit_ray
from tracer.rays.camera_lanes import fill_camera_rays
from tracer.rays.rows import PACKET
from tracer.simd import address_of
from tracer.types import CAMERA_ORTHOGRAPHIC, CAMERA_VIEW_PLANE, N_CAMERA

WIDTH, HEIGHT = 40, 20


@kernel
def _fill(camera, kind, n, places, origins, directions):
    fill_camera_rays(
        camera, kind, int64(WIDTH), int64(HEIGHT), n, address_of(places), address_of(origins), address_of(directions)
    )


@kernel
def _one_by_one(camera, kind, n, places, origins, directions):
    for k in range(n):
        ray = unit_ray(camera_ray(camera, kind, places[0, k], places[1, k], int64(WIDTH), int64(HEIGHT)))
        origins[0, k], origins[1, k], origins[2, k] = ray.origin
        directions[0, k], directions[1, k], directions[2, k] = ray.direction


def table(rng, scale=1.0, plane=1.0, distance=0.25):
    """A camera turned at random; ``scale`` of its axes, ``plane`` of the view plane."""
    values = np.zeros(N_CAMERA)
    values[:3] = rng.standard_normal(3) * 5
    values[3:12] = np.linalg.qr(rng.standard_normal((3, 3)))[0].ravel() * scale
    values[12:16] = np.array([-1.0, 3.0, -2.0, 0.5]) * plane
    values[16] = distance
    return values


def both(camera, kind, x, y):
    """Rays by lanes and one by one: two arrays (2, 3, n)."""
    n = len(x)
    places = np.full((2, PACKET), 1e9)
    places[:, :n] = x, y
    lanes, single = np.full((2, 3, PACKET), -7.0), np.zeros((2, 3, PACKET))
    _fill(camera, np.int64(kind), n, places, lanes[0], lanes[1])
    _one_by_one(camera, np.int64(kind), n, places, single[0], single[1])
    assert (lanes[:, :, -(-n // 4) * 4 :] == -7.0).all()  # not written beyond the next multiple of four
    return lanes[:, :, :n], single[:, :, :n]


@pytest.mark.parametrize("kind", [CAMERA_VIEW_PLANE, CAMERA_ORTHOGRAPHIC])
@pytest.mark.parametrize("n", [0, 1, 3, 4, 5, 63, 64])
def test_same_bits_as_one_by_one(kind, n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        lanes, single = both(table(rng), kind, rng.uniform(0, WIDTH, n), rng.uniform(0, HEIGHT, n))
        np.testing.assert_array_equal(lanes, single)


@pytest.mark.parametrize(
    ("scale", "plane", "distance"),
    [
        (1e-160, 1.0, 1.0),  # squares underflow
        (1e160, 1.0, 1.0),  # squares overflow
        (1.0, 1e-170, 1.0),
        (1.0, 1e150, 1e-150),
        (1.0, 1e-3, 1e12),  # a view of 1e-15 radians
        (1e-300, 1e-20, 1e-20),  # denormal directions
        (1.0, 1e4, 1e-4),  # nearly half a turn wide
    ],
)
@pytest.mark.parametrize("kind", [CAMERA_VIEW_PLANE, CAMERA_ORTHOGRAPHIC])
def test_extreme_planes(kind, scale, plane, distance):
    rng = np.random.default_rng(3)
    camera = table(rng, scale, plane, distance)
    lanes, single = both(camera, kind, rng.uniform(0, WIDTH, 61), rng.uniform(0, HEIGHT, 61))
    np.testing.assert_array_equal(lanes, single)
    if scale > 1e-200:
        np.testing.assert_allclose(np.linalg.norm(lanes[1], axis=0), 1.0, rtol=4e-16)


def test_a_lane_that_overflows_does_not_change_its_neighbours():
    """Four rays are made unit together only where all squares are in range: the others get the same bits as alone."""
    rng = np.random.default_rng(4)
    camera = table(rng, 1.0, 1.0, 1.0)
    x, y = rng.uniform(0, WIDTH, 4), rng.uniform(0, HEIGHT, 4)
    alone, _ = both(camera, CAMERA_VIEW_PLANE, x, y)
    x[1] = 1e200
    together, single = both(camera, CAMERA_VIEW_PLANE, x, y)
    np.testing.assert_array_equal(together, single)
    np.testing.assert_array_equal(together[:, :, [0, 2, 3]], alone[:, :, [0, 2, 3]])


def test_equation_1():
    """Direction -d w + u u + v v, made unit; u grows to the right, v to the top."""
    rng = np.random.default_rng(5)
    camera = table(rng)
    x, y = rng.uniform(0, WIDTH, 64), rng.uniform(0, HEIGHT, 64)
    lanes, _ = both(camera, CAMERA_VIEW_PLANE, x, y)
    right, up, back = camera[3:12].reshape(3, 3)
    left_edge, right_edge, bottom, top, distance = camera[12:]
    u, v = left_edge + (right_edge - left_edge) * x / WIDTH, bottom + (top - bottom) * (HEIGHT - y) / HEIGHT
    expected = u[:, None] * right + v[:, None] * up - distance * back
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    np.testing.assert_allclose(lanes[1].T, expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(lanes[0].T, np.tile(camera[:3], (64, 1)))
    lanes, _ = both(camera, CAMERA_ORTHOGRAPHIC, x, y)
    np.testing.assert_allclose(lanes[0].T, camera[:3] + u[:, None] * right + v[:, None] * up, atol=1e-14)
    np.testing.assert_allclose(lanes[1].T, np.tile(-back / np.linalg.norm(back), (64, 1)), atol=1e-15)
