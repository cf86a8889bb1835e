"""Sample points eight at a time against those one at a time: the same bits."""

import numpy as np
import pytest

from tracer.jit import kernel
from tracer.sampling.hashing import pixel_key
from tracer.sampling.lanes import fill_samples, place_in_pixel
from tracer.sampling.sampler import sample_2d
from tracer.simd import address_of
from tracer.types import SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED

COUNTS = (1, 2, 3, 9, 16, 64, 100, 65536)


@kernel
def _fill(sampler, n_samples, n, keys, indices, us, vs):
    fill_samples(sampler, n_samples, n, address_of(keys), address_of(indices), address_of(us), address_of(vs))


def fill(sampler, n_samples, keys, indices):
    n = len(keys)
    room = -(-n // 8) * 8
    words = np.zeros((2, room), np.int32)
    words[0, :n] = np.asarray(keys, np.uint64).astype(np.uint32).view(np.int32)
    words[1, :n] = indices
    points = np.full((2, room + 8), -7.0)
    _fill(sampler, np.int64(n_samples), n, words[0], words[1], points[0], points[1])
    assert (points[:, room:] == -7.0).all()  # not written beyond the next multiple of eight
    return points[:, :n]


@pytest.mark.parametrize("n_samples", COUNTS)
@pytest.mark.parametrize("sampler", [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL])
def test_same_bits_as_one_by_one(sampler, n_samples):
    """Seeds and pixels at the ends of their ranges, the first and last samples and some between."""
    rng = np.random.default_rng(n_samples)
    places = [
        (seed, x, y) for seed in (0, 1, 0xFFFFFFFF) for x, y in ((0, 0), (1, 0), (0, 1), (65535, 3), (16383, 16383))
    ]
    places += [(int(s), int(x), int(y)) for s, x, y in rng.integers(0, [2**32, 65536, 65536], (9, 3))]
    samples = sorted({0, n_samples - 1, n_samples // 2, *rng.integers(0, n_samples, 4).tolist()})
    cases = [(*place, k) for place in places for k in samples]
    keys = [int(pixel_key(seed, x, y, 0)) for seed, x, y, _ in cases]
    assert max(keys) >= 2**31  # keys use all 32 bits
    us, vs = fill(sampler, n_samples, keys, [k for *_, k in cases])
    expected = [sample_2d(sampler, seed, x, y, k, n_samples, 0) for seed, x, y, k in cases]
    assert us.tolist() == [u for u, _ in expected]
    assert vs.tolist() == [v for _, v in expected]


@pytest.mark.parametrize("n", [0, 1, 7, 8, 9, 63, 64])
def test_any_number_of_points(n):
    keys = [int(pixel_key(5, x, 2, 0)) for x in range(n)]
    us, vs = fill(SAMPLER_SOBOL, 16, keys, [x % 16 for x in range(n)])
    expected = [sample_2d(SAMPLER_SOBOL, 5, x, 2, x % 16, 16, 0) for x in range(n)]
    assert list(zip(us.tolist(), vs.tolist(), strict=True)) == expected


@pytest.mark.parametrize("n_samples", [16, 64])
def test_points_of_a_pixel_form_a_net(n_samples):
    """Each elementary interval of area 1 / n holds one point: an oracle apart from the scalar code."""
    key = int(pixel_key(9, 4, 7, 0))
    us, vs = fill(SAMPLER_SOBOL, n_samples, [key] * n_samples, np.arange(n_samples))
    bits = n_samples.bit_length() - 1
    for k in range(bits + 1):
        cells = np.floor(us * 2**k) * 2 ** (bits - k) + np.floor(vs * 2 ** (bits - k))
        assert len(set(cells.tolist())) == n_samples


@kernel
def _place(n_samples, key, first, n, px, py, places):
    place_in_pixel(n_samples, key, first, n, px, py, address_of(places), address_of(places[1:]))


@pytest.mark.parametrize("n_samples", [8, 9, 16, 17, 64, 65536])
def test_places_in_a_pixel_are_the_same_points(n_samples):
    """All bits: a place has no more than float64 holds. Every row of the table of shuffles is used."""
    for pixel in range(40):
        px, py = 3839 - pixel, 65535 - 7 * pixel
        key = int(pixel_key(11, px, py, 0))
        for first in {0, max(0, n_samples // 2 // 8 * 8 - 8)}:
            n = min(64, (n_samples - first) // 8 * 8)
            places = np.full((2, n + 8), -7.0)
            _place(np.int64(n_samples), np.int64(key), np.int64(first), np.int64(n), np.int64(px), np.int64(py), places)
            points = [sample_2d(SAMPLER_SOBOL, 11, px, py, k, n_samples, 0) for k in range(first, first + n)]
            assert places[:, :n].T.tolist() == [[px + u, py + v] for u, v in points]
            assert (places[:, n:] == -7.0).all()
