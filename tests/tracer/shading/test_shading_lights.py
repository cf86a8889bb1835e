"""Directions, distances and cones of lights."""

import math

import numpy as np
import pytest

from tracer.shading.lights import see_light, shadow_ray
from tracer.types import (
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    N_LIGHT,
    Vec3,
)

INNER, OUTER = math.cos(math.radians(20)), math.cos(math.radians(30))


@pytest.fixture
def lights():
    """Row 1: at (0, 0, 10), shining down, 20 and 30 degrees."""
    table = np.zeros((2, N_LIGHT))
    table[1, LIGHT_POSITION : LIGHT_POSITION + 3] = 0, 0, 10
    table[1, LIGHT_DIRECTION : LIGHT_DIRECTION + 3] = 0, 0, -1
    table[1, LIGHT_SPOT_SCALE] = 1.0 / (INNER - OUTER)
    table[1, LIGHT_SPOT_OFFSET] = -OUTER / (INNER - OUTER)
    return table.ravel()


def test_directional(lights):
    sight = see_light(lights, LIGHT_KIND_DIRECTIONAL, 1, Vec3(5.0, 6.0, 7.0))
    assert tuple(sight.to_light) == (0.0, 0.0, 1.0)
    assert (sight.distance, sight.cone) == (math.inf, 1.0)
    direction, t_max = shadow_ray(lights, LIGHT_KIND_DIRECTIONAL, 1, Vec3(5.0, 6.0, 7.0))
    assert (tuple(direction), t_max) == ((0.0, 0.0, 1.0), math.inf)


def test_point(lights):
    sight = see_light(lights, LIGHT_KIND_POINT, 1, Vec3(3.0, 0.0, 6.0))
    assert tuple(sight.to_light) == pytest.approx((-0.6, 0.0, 0.8), abs=1e-15)
    assert (sight.distance, sight.cone) == (5.0, 1.0)
    direction, t_max = shadow_ray(lights, LIGHT_KIND_POINT, 1, Vec3(3.0, 0.0, 6.0))
    assert tuple(direction) == (-3.0, 0.0, 4.0)
    assert 1.0 - 1e-13 < t_max < 1.0


def test_at_the_light_nothing_arrives(lights):
    assert see_light(lights, LIGHT_KIND_POINT, 1, Vec3(0.0, 0.0, 10.0)).cone == 0.0


@pytest.mark.parametrize(("angle", "cone"), [(0, 1.0), (19.99, 1.0), (30.01, 0.0), (90, 0.0), (180, 0.0), (25, None)])
def test_spot(lights, angle, cone):
    a = math.radians(angle)
    sight = see_light(lights, LIGHT_KIND_SPOT, 1, Vec3(3.0 * math.sin(a), 0.0, 10.0 - 3.0 * math.cos(a)))
    expected = ((math.cos(a) - OUTER) / (INNER - OUTER)) ** 2 if cone is None else cone
    assert sight.cone == pytest.approx(expected, abs=1e-12)
    assert sight.distance == pytest.approx(3.0)
