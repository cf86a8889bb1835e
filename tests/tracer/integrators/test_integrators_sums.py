"""A pixel's compensated sums: against `math.fsum`, and the same bits whoever is added up beside it."""

import math

import numpy as np
import pytest

from tracer.integrators.scratch import WAVE
from tracer.integrators.sums import SUMS, add_wave
from tracer.jit import kernel, pointer
from tracer.simd import address_of


@kernel
def _add(radiance, n_pixels, per_pixel, first, sums):
    add_wave(address_of(radiance), n_pixels, per_pixel, first, pointer(sums))


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
