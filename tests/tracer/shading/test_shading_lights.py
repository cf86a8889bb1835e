"""Shadow rays: where they go and where they end. What lights give is tested with `direct`."""

import math

import numpy as np
import pytest

from tracer.shading.lights import BEFORE_LIGHT, shadow_ray
from tracer.types import (
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    N_LIGHT,
    Vec3,
)


@pytest.fixture
def lights():
    """Row 1: at (0, 0, 10), shining down."""
    table = np.zeros((2, N_LIGHT))
    table[1, LIGHT_POSITION : LIGHT_POSITION + 3] = 0, 0, 10
    table[1, LIGHT_DIRECTION : LIGHT_DIRECTION + 3] = 0, 0, -1
    return table.ravel()


def test_directional(lights):
    direction, t_max = shadow_ray(lights, LIGHT_KIND_DIRECTIONAL, 1, Vec3(5.0, 6.0, 7.0))
    assert (tuple(direction), t_max) == ((0.0, 0.0, 1.0), math.inf)


@pytest.mark.parametrize("kind", [LIGHT_KIND_POINT, LIGHT_KIND_SPOT])
def test_with_a_place(lights, kind):
    direction, t_max = shadow_ray(lights, kind, 1, Vec3(3.0, 0.0, 6.0))
    assert tuple(direction) == (-3.0, 0.0, 4.0)
    assert t_max == BEFORE_LIGHT
    assert 1.0 - 1e-13 < t_max < 1.0
