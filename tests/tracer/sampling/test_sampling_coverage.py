"""Every sampler covers the pixel evenly, for every number of samples: what is never sampled is a bias that no seed removes."""

import math

import numpy as np
import pytest

from tracer.sampling.sampler import sample_2d
from tracer.types import SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED

BINS = 8


@pytest.mark.parametrize("n_samples", [1, 2, 3, 5, 7, 11, 16, 24, 32])
@pytest.mark.parametrize("sampler", [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL])
def test_even_coverage(sampler, n_samples):
    """100 samples expected in each of 8 x 8 fields, over all pixels; six standard deviations of independent samples allowed."""
    n_pixels = math.ceil(100 * BINS * BINS / n_samples)
    counts = np.zeros((BINS, BINS))
    for pixel in range(n_pixels):
        for k in range(n_samples):
            u, v = sample_2d(sampler, 5, pixel, 17, k, n_samples, 0)
            counts[int(v * BINS), int(u * BINS)] += 1
    expected = n_pixels * n_samples / BINS**2
    assert np.abs(counts - expected).max() < 6 * math.sqrt(expected)
