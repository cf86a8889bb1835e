"""A pixel's compensated sums: against `math.fsum`, and the same bits whoever is added up beside it."""

import math

import numpy as np
import pytest

from tracer.integrators.scratch import WAVE
from tracer.integrators.sums import SUMS, add_everywhere, add_shares, add_wave
from tracer.jit import kernel, pointer
from tracer.simd import address_of
from tracer.types import Vec3


@kernel
def _add(radiance, n_pixels, per_pixel, first, sums):
    add_wave(address_of(radiance), n_pixels, per_pixel, first, pointer(sums), 0)


def summed(values, first):
    """Sums of values (pixels, samples, 3) whose first sample has that number."""
    n_pixels, per_pixel, _ = values.shape
    radiance = np.zeros((3, WAVE))
    radiance[:, : n_pixels * per_pixel] = values.reshape(-1, 3).T
    sums = np.zeros((n_pixels, SUMS))
    _add(radiance, n_pixels, per_pixel, first, sums)
    return sums


@pytest.mark.parametrize(("n_pixels", "per_pixel"), [(64, 16), (7, 16), (4, 4), (9, 8), (64, 3), (5, 1), (1, 1024)])
@pytest.mark.parametrize("first", [0, 3])
def test_sums_are_those_of_fsum_and_of_each_pixel_alone(n_pixels, per_pixel, first):
    rng = np.random.default_rng(per_pixel)
    values = rng.random((n_pixels, per_pixel, 3)) * 10.0 ** rng.uniform(-30, 30, (n_pixels, per_pixel, 3))
    sums = summed(values, first)
    for pixel in range(n_pixels):
        for half in range(2):
            for channel in range(3):
                total, lost = sums[pixel, 3 * half + channel], sums[pixel, 6 + 3 * half + channel]
                want = math.fsum(values[pixel, (half + first) % 2 :: 2, channel])
                assert abs((total + lost) - want) <= 2 * math.ulp(want)
        np.testing.assert_array_equal(sums[pixel], summed(values[pixel : pixel + 1], first)[0])


@kernel
def _add_shares(color, shares, n, first, sums, place):
    c = Vec3(color[0], color[1], color[2])
    add_everywhere(c, first, first + n, pointer(sums), place)
    add_shares(c, address_of(shares), n, first, pointer(sums), place)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 16, 63, 64])
@pytest.mark.parametrize("first", [0, 3])
def test_one_colour_times_shares(n, first):
    """Of a pixel in the middle; what lies behind the shares does not count."""
    rng = np.random.default_rng(n)
    color, shares = rng.random(3), np.append(rng.random(n), [np.nan] * 4)
    sums = np.zeros(3 * SUMS)
    _add_shares(color, shares, n, first, sums, SUMS)
    assert not sums[:SUMS].any()
    assert not sums[2 * SUMS :].any()
    for half in range(2):
        for channel in range(3):
            got = sums[SUMS + 3 * half + channel] + sums[SUMS + 6 + 3 * half + channel]
            want = math.fsum(float(color[channel]) * (1.0 + shares[(half + first) % 2 : n : 2]))
            assert abs(got - want) <= 4 * math.ulp(want)
