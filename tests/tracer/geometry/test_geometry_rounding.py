"""Bounds on rounding errors against fractions."""

import math
from fractions import Fraction

import pytest

from tests.tracer.rays.spawning import away
from tracer.geometry.rounding import EPSILON, gamma


def test_gamma_bounds_a_chain_of_roundings():
    value, exact = 1.0, Fraction(1)
    for k in range(1, 30):
        factor = 1.0 + k * 2.0**-40
        value *= factor
        exact *= Fraction(factor)
        assert abs(Fraction(value) / exact - 1) <= Fraction(gamma(k))
    assert gamma(1) > EPSILON


@pytest.mark.parametrize("value", [0.0, 1.0, -1.0, 3.0, 1e-310, -1e300, 2.0**52, 0.1])
def test_away_takes_one_or_two_steps(value):
    up = away(value, 1.0)
    assert up in {math.nextafter(value, math.inf), math.nextafter(math.nextafter(value, math.inf), math.inf)}
    down = away(value, -1e-300)
    assert down in {math.nextafter(value, -math.inf), math.nextafter(math.nextafter(value, -math.inf), -math.inf)}
    assert away(value, 0.0) == value
