"""The reflection equations against closed forms and Snell's law."""

import math

import numpy as np
import pytest

from tracer.geometry.vector import dot, length, normalize
from tracer.shading import phong
from tracer.types import Vec3


def unit(rng):
    return normalize(Vec3(*rng.standard_normal(3).tolist()))


@pytest.mark.parametrize(
    ("a", "b", "c", "distance", "expected"),
    [
        (1.0, 0.0, 0.0, 5.0, 1.0),
        (0.5, 0.25, 2.0, 2.0, 1.0 / 9.0),
        (4.0, 1.0, 1.0, math.inf, 0.25),
        (0.0, 1.0, 0.0, math.inf, 0.0),
        (0.0, 0.0, 2.0, 0.5, 2.0),
        (1.0, 1.0, 1.0, 0.0, 1.0),
        (1.0, 0.0, 1.0, 1e154, 1e-308),
        (1.0, 0.0, 1.0, 1e200, 0.0),
        (0.0, 0.0, 1.0, 1e-160, 1e200),
        (5e-324, 0.0, 0.0, 1.0, 1e200),
    ],
)
def test_attenuation(a, b, c, distance, expected):
    assert phong.attenuation(a, b, c, distance) == pytest.approx(expected, rel=1e-15)
    assert phong.attenuation(a, b, c, distance) <= phong.attenuation_bound(a)


def test_mirror_direction_is_equation_17():
    rng = np.random.default_rng(3)
    for _ in range(100):
        d, n = unit(rng), unit(rng)
        u = phong.reflect_direction(d, n)
        assert dot(u, n) == pytest.approx(-dot(d, n), abs=4e-15)
        assert np.cross(u, n) == pytest.approx(np.cross(d, n), abs=4e-15)
        back = phong.reflect_direction(u, n)
        assert tuple(back) == pytest.approx(tuple(d), abs=4e-15)


def test_what_is_left_of_mirrored_and_transmitted_light():
    k, light = Vec3(0.5, 0.25, 1.0), Vec3(2.0, 4.0, 0.5)
    assert tuple(phong.weigh_reflected(k, light, 0.5)) == (0.5, 0.5, 0.25)  # eq. 14
    assert tuple(phong.weigh_transmitted(k, light, 0.25)) == (0.25, 0.25, 0.125)  # eq. 15


@pytest.mark.parametrize("ratio", [0.25, 1 / 1.5, 1.0, 1.33, 1.5, 4.0])
def test_refraction_obeys_snell(ratio):
    rng = np.random.default_rng(4)
    passed = reflected = 0
    for _ in range(400):
        n, d = unit(rng), unit(rng)
        if dot(d, n) > 0.0:
            d = Vec3(-d.x, -d.y, -d.z)
        through, u = phong.refract_direction(d, n, ratio)
        sine = np.linalg.norm(np.cross(d, n))
        assert length(u) == pytest.approx(1.0, abs=1e-14 * max(1.0, ratio))
        if ratio * sine > 1.0 + 1e-14:
            assert not through
            assert tuple(u) == tuple(phong.reflect_direction(d, n))
            reflected += 1
        elif ratio * sine < 1.0 - 1e-14:
            assert through
            assert dot(u, n) < 0.0
            # sin(t) = ratio sin(i), in the plane of d and n
            assert np.cross(u, n) == pytest.approx(ratio * np.cross(d, n), abs=1e-14 * max(1.0, ratio))
            passed += 1
    assert passed > 5
    assert (reflected > 50) == (ratio > 1.2)


def test_refraction_without_a_change_of_index_goes_straight_on():
    rng = np.random.default_rng(5)
    for _ in range(100):
        n, d = unit(rng), unit(rng)
        if dot(d, n) > 0.0:
            n = Vec3(-n.x, -n.y, -n.z)
        through, u = phong.refract_direction(d, n, 1.0)
        assert through
        assert tuple(u) == tuple(d)


def test_total_reflection_begins_at_the_critical_angle():
    """Glass to air, sin = 1 / 1.5: within a few roundings of the angle either answer is a limit of the other."""
    n = Vec3(0.0, 0.0, 1.0)
    critical = math.asin(1.0 / 1.5)
    for k in (1e-12, 1e-9, 1e-3):
        for sign in (-1.0, 1.0):
            angle = critical + sign * k
            through, u = phong.refract_direction(Vec3(math.sin(angle), 0.0, -math.cos(angle)), n, 1.5)
            assert through == (sign < 0.0)
            assert (u.z < 0.0) == through


def test_there_and_back_through_a_pane():
    rng = np.random.default_rng(6)
    n = Vec3(0.0, 0.0, 1.0)
    for _ in range(100):
        d = unit(rng)
        d = Vec3(d.x, d.y, -abs(d.z))
        _, inside = phong.refract_direction(d, n, 1.0 / 1.5)
        through, outside = phong.refract_direction(inside, n, 1.5)
        assert through
        assert tuple(outside) == pytest.approx(tuple(d), abs=1e-13)
