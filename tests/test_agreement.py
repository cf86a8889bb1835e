"""The statistics by which pictures are judged: right ones pass, and each fault is seen."""

import math

import numpy as np
import pytest

from tests.agreement import beyond, bias, sidak_limit, z_scores

BOUND = 1e-6
PIXELS, OURS, OTHERS = 20_000, 16, 64


def noisy(generator, n_samples, width=0.2):
    """Return samples of pixels half of which lie on an edge, and half have a gradient."""
    edge = (generator.random((PIXELS // 2, n_samples, 1)) < 0.1).astype(float)
    slope = generator.uniform(0.5, 0.5 + width, (PIXELS // 2, n_samples, 1))
    return np.concatenate([edge, slope]).repeat(3, axis=2)


@pytest.fixture(scope="module")
def samples():
    generator = np.random.default_rng(1)
    return noisy(generator, OURS), noisy(generator, OTHERS)


def test_a_right_picture_passes(samples):
    """With independent samples of our own, z is standard normal but for the tails that an edge's few values make."""
    same, independent = samples
    z, error = z_scores(same.mean(axis=1), same, independent, BOUND)
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.02)
    limit = sidak_limit(0.01, 3 * PIXELS)
    assert (np.abs(z) <= limit).all(axis=1).mean() >= 0.9999
    assert (np.abs(bias(same.mean(axis=1), independent, error)) < 4.0).all()


def test_a_thin_feature_is_no_fault():
    """One of our 16 samples met what none of 64 others did: a chance of one in five."""
    same, independent = np.zeros((1, OURS, 3)), np.zeros((1, OTHERS, 3))
    same[0, 3] = 1.0
    z, _ = z_scores(same.mean(axis=1), same, independent, BOUND)
    assert z == pytest.approx(2.0, abs=0.02)


def test_a_leak_is_seen(samples):
    """Ours is off in a few pixels by one of 16 samples; the oracle's values know nothing of it."""
    same, _ = samples
    ours = same.mean(axis=1)
    ours[-7:] += 0.5 / OURS
    assert beyond(ours, same.mean(axis=1), BOUND).nonzero()[0].tolist() == list(range(PIXELS - 7, PIXELS))
    flat = np.full((1, OURS, 3), 0.25), np.full((1, OTHERS, 3), 0.25)
    z, error = z_scores(flat[0].mean(axis=1) + 0.5 / OURS, *flat, BOUND)
    assert (error == 0.0).all()
    assert (z == math.inf).all()


def test_where_nothing_varies_rounding_is_no_fault():
    same, independent = np.full((2, OURS, 3), 0.25), np.full((2, OTHERS, 3), 0.25)
    ours = np.array([[0.25, 0.25 + 0.9 * BOUND, 0.25 - 0.9 * BOUND], [0.25, 0.25 + 1.1 * BOUND, 0.25 - 1.1 * BOUND]])
    z, error = z_scores(ours, same, independent, BOUND)
    assert z.tolist() == [[0.0, 0.0, 0.0], [0.0, math.inf, -math.inf]]
    assert beyond(ours, same.mean(axis=1), BOUND).tolist() == [False, True]
    assert bias(same.mean(axis=1), independent, error).tolist() == [0.0] * 3


def test_the_bound_grows_with_the_value():
    assert beyond(np.full((1, 3), 100.0 + 50 * BOUND), np.full((1, 3), 100.0), BOUND).tolist() == [False]
    assert beyond(np.full((1, 3), 100.0 + 150 * BOUND), np.full((1, 3), 100.0), BOUND).tolist() == [True]


def test_bias_sees_what_no_pixel_shows(samples):
    same, independent = samples
    ours = same.mean(axis=1) + 0.003
    z, error = z_scores(ours, same, independent, BOUND)
    assert (np.abs(z) <= sidak_limit(0.01, 3 * PIXELS)).all(axis=1).mean() >= 0.9999
    assert (bias(ours, independent, error) > 5.0).all()


def test_the_corrected_limit():
    assert sidak_limit(0.05, 1) == pytest.approx(1.959964, abs=1e-6)
    limit = sidak_limit(0.01, 36_000)
    assert 1.0 - (1.0 - math.erfc(limit / math.sqrt(2.0))) ** 36_000 == pytest.approx(0.01, rel=1e-6)
