"""Camera rays against equation 1, and the frustum against the rays."""

import numpy as np
import pytest

from tracer.rays.camera import camera_ray, unit_ray
from tracer.rays.frustum import misses_bounds
from tracer.types import CAMERA_ORTHOGRAPHIC, CAMERA_VIEW_PLANE, N_CAMERA, Vec3


def camera(rng=None):
    """A view plane off the middle, seen from (1, 2, 3); turned at random with an rng."""
    table = np.zeros(N_CAMERA)
    table[:3] = 1, 2, 3
    table[3:12] = np.eye(3).ravel() if rng is None else np.linalg.qr(rng.standard_normal((3, 3)))[0].ravel()
    table[12:] = -1.0, 3.0, -2.0, 0.5, 0.25
    return table


def ray(table, kind, x, y):
    return camera_ray(table, np.int64(kind), x, y, np.int64(40), np.int64(20))


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [(0.0, 0.0, (-1.0, 0.5)), (40.0, 20.0, (3.0, -2.0)), (20.0, 10.0, (1.0, -0.75)), (10.0, 20.0, (0.0, -2.0))],
)
def test_equation_1(x, y, expected):
    """u grows to the right, v to the top; the direction is -d w + u u + v v."""
    found = ray(camera(), CAMERA_VIEW_PLANE, x, y)
    assert tuple(found.origin) == (1.0, 2.0, 3.0)
    assert tuple(found.direction) == (*expected, -0.25)


def test_orthographic_rays_are_parallel():
    found = ray(camera(), CAMERA_ORTHOGRAPHIC, 10.0, 20.0)
    assert tuple(found.origin) == (1.0, 0.0, 3.0)
    assert tuple(found.direction) == (0.0, 0.0, -1.0)


def test_unit_ray():
    found = unit_ray(ray(camera(np.random.default_rng(1)), CAMERA_VIEW_PLANE, 3.3, 4.4))
    assert np.linalg.norm(found.direction) == pytest.approx(1.0, abs=1e-15)
    assert isinstance(Vec3(*found.direction), Vec3)


@pytest.mark.parametrize("kind", [CAMERA_VIEW_PLANE, CAMERA_ORTHOGRAPHIC])
def test_frustum_never_drops_what_a_ray_can_meet_and_drops_the_rest(kind):
    rng = np.random.default_rng(2 + kind)
    seen = dropped = unseen = 0
    for _ in range(1500):
        table = camera(rng)
        x0, y0 = rng.uniform(0, [39.0, 19.0])
        x1, y1 = x0 + rng.choice([1e-9, 1.0, 5.0]), y0 + rng.choice([1e-9, 1.0, 5.0])
        size = 10.0 ** rng.uniform(-6, 0.5)
        center = table[:3] + rng.standard_normal(3) * 3
        if rng.random() < 0.6:  # around a point that a ray of the rectangle meets, often touching it with a corner only
            hit = ray(table, kind, rng.uniform(x0, x1), rng.choice([y0, y1]))
            center = np.array(hit.origin) + rng.uniform(0.1, 30) * np.array(hit.direction)
            center += size * rng.choice([-1, 0, 1], 3)
        root = np.concatenate([center - size, center + size])
        missed = misses_bounds(table, np.int64(kind), x0, y0, x1, y1, np.int64(40), np.int64(20), root)
        hits = False
        for x in np.linspace(x0, x1, 5):
            for y in np.linspace(y0, y1, 5):
                o, d = (np.array(v) for v in ray(table, kind, x, y))
                with np.errstate(divide="ignore", invalid="ignore"):
                    t = np.sort([(root[:3] - o) / d, (root[3:] - o) / d], axis=0)
                hits |= bool(np.nanmax(t[0]) <= np.nanmin(t[1]) and np.nanmin(t[1]) > 0)
        assert not (hits and missed)
        seen += hits
        unseen += not hits
        dropped += missed
    assert seen > 300
    assert dropped > 0.5 * unseen


def test_an_empty_box_is_never_seen():
    root = np.array([np.inf] * 3 + [-np.inf] * 3)
    assert misses_bounds(camera(), np.int64(0), 0.0, 0.0, 16.0, 16.0, np.int64(40), np.int64(20), root)


def test_the_eye_in_the_box_sees_it():
    root = np.array([0.0, 0, 0, 9, 9, 9])
    assert not misses_bounds(camera(), np.int64(0), 0.0, 0.0, 1.0, 1.0, np.int64(40), np.int64(20), root)
