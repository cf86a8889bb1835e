"""Samplers: pure functions, stratified as they promise, uniform over pixels, convergent as they should."""

import numpy as np
import pytest

from tracer.sampling.hashing import hash_word, pixel_key
from tracer.sampling.sampler import sample_2d
from tracer.sampling.sobol import reverse_bits, sobol_reversed_second
from tracer.sampling.stratified import permute
from tracer.types import SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED

ALL = [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL]


def points(sampler, n, px=3, py=5, seed=0, dimension=0):
    return np.array([sample_2d(sampler, seed, px, py, k, n, dimension) for k in range(n)])


@pytest.mark.parametrize("sampler", ALL)
@pytest.mark.parametrize("n", [1, 2, 3, 5, 7, 12, 16, 100, 256])
def test_in_the_unit_square(sampler, n):
    p = np.concatenate([points(sampler, n, px=px) for px in range(8)])
    assert (p >= 0.0).all()
    assert (p < 1.0).all()
    assert len(np.unique(p, axis=0)) == len(p)


@pytest.mark.parametrize("sampler", ALL)
def test_every_argument_counts(sampler):
    base = {"seed": 1, "px": 3, "py": 5, "sample": 2, "n_samples": 16, "dimension": 0}
    first = sample_2d(sampler, *base.values())
    assert sample_2d(sampler, *base.values()) == first
    for name in ("seed", "px", "py", "sample", "dimension"):
        other = base | {name: base[name] + 1}
        assert sample_2d(sampler, *other.values()) != first
    swapped = base | {"px": 5, "py": 3}
    assert sample_2d(sampler, *swapped.values()) != first


@pytest.mark.parametrize("n", [4, 9, 16, 25, 64, 100])
def test_stratified_square_numbers_fill_a_grid(n):
    m = int(n**0.5)
    for px in range(10):
        cells = (points(SAMPLER_STRATIFIED, n, px=px) * m).astype(int)
        assert len(np.unique(cells, axis=0)) == n


@pytest.mark.parametrize("n", [2, 3, 6, 8, 12, 50, 99])
def test_stratified_other_numbers_fill_cells_of_their_grid(n):
    columns = int(n**0.5)
    rows = -(-n // columns)
    for px in range(10):
        cells = (points(SAMPLER_STRATIFIED, n, px=px) * [columns, rows]).astype(int)
        assert len(np.unique(cells, axis=0)) == n


@pytest.mark.parametrize("log2_n", [0, 1, 4, 6, 8])
def test_sobol_points_are_nets(log2_n):
    """One point in each elementary interval, of every shape."""
    n = 1 << log2_n
    for px in range(8):
        p = points(SAMPLER_SOBOL, n, px=px)
        for k in range(log2_n + 1):
            cells = (p * [2**k, 2 ** (log2_n - k)]).astype(int)
            assert len(np.unique(cells, axis=0)) == n


def test_aligned_runs_of_a_longer_sobol_render_are_nets():
    """The samples of a pass, 16 k to 16 k + 15 of 256, are a net of their own."""
    p = points(SAMPLER_SOBOL, 256)
    for start in range(0, 256, 16):
        for k in range(5):
            assert len(np.unique((p[start : start + 16] * [2**k, 2 ** (4 - k)]).astype(int), axis=0)) == 16


def test_second_sobol_coordinate_against_its_direction_numbers():
    """Generator matrix built from the recurrence v_j = v_(j-1) xor v_(j-1) >> 1 (primitive polynomial x + 1)."""
    directions = [1 << 31]
    for _ in range(31):
        directions.append(directions[-1] ^ (directions[-1] >> 1))
    for index in [0, 1, 2, 3, 5, 100, 0xDEADBEEF, 0xFFFFFFFF]:
        expected = 0
        for bit in range(32):
            if index >> bit & 1:
                expected ^= directions[bit]
        assert int(reverse_bits(np.uint64(sobol_reversed_second(np.uint64(index))))) == expected


def test_reverse_bits():
    for x in [0, 1, 0x80000000, 0x12345678, 0xFFFFFFFF]:
        assert int(reverse_bits(np.uint64(x))) == int(f"{x:032b}"[::-1], 2)


@pytest.mark.parametrize("length", [1, 2, 3, 7, 16, 100])
def test_permutations_are_permutations(length):
    seen = set()
    for key in range(20):
        image = [
            int(permute(np.uint64(i), np.uint64(length), np.uint64(hash_word(np.uint64(key))))) for i in range(length)
        ]
        assert sorted(image) == list(range(length))
        seen.add(tuple(image))
    assert len(seen) > min(15, length) // 2


@pytest.mark.parametrize("sampler", ALL)
def test_uniform_over_pixels(sampler):
    """Chi-squared over an 8 x 8 grid, each sample index apart: what one pixel takes is uniform over all pixels."""
    for sample in (0, 3, 15):
        p = np.array([sample_2d(sampler, 7, px, py, sample, 16, 0) for px in range(80) for py in range(80)])
        cells = (p * 8).astype(int)
        counts = np.bincount(cells[:, 0] * 8 + cells[:, 1], minlength=64)
        chi_squared = ((counts - 100.0) ** 2 / 100.0).sum()
        assert 30 < chi_squared < 120  # 63 degrees of freedom: 1e-4 quantiles are about 31 and 112


def test_neighbouring_pixels_are_unrelated():
    keys = np.array([[int(pixel_key(0, px, py, 0)) for px in range(100)] for py in range(100)]) / 2.0**32
    assert len(np.unique(keys)) == keys.size
    for a, b in [(keys[:, :-1], keys[:, 1:]), (keys[:-1], keys[1:]), (keys, keys.T)]:
        off = ~np.eye(100, dtype=bool)[: a.shape[0], : a.shape[1]]
        assert abs(np.corrcoef(a[off], b[off])[0, 1]) < 0.05


def rms_error(sampler, n, pixels=200):
    """Error of the mean of a smooth function over a pixel's samples."""

    def f(p):
        return np.exp(p[:, 0]) * np.cos(2.0 * p[:, 1])

    exact = (np.e - 1.0) * np.sin(2.0) / 2.0
    return np.sqrt(np.mean([(f(points(sampler, n, px=px)).mean() - exact) ** 2 for px in range(pixels)]))


@pytest.mark.parametrize(
    ("sampler", "slope"), [(SAMPLER_INDEPENDENT, -0.5), (SAMPLER_STRATIFIED, -1.0), (SAMPLER_SOBOL, -1.5)]
)
def test_convergence(sampler, slope):
    """Error against samples: N^-1/2 at random, N^-1 stratified, N^-3/2 scrambled Sobol (a wrong dimension stalls)."""
    measured = np.log2(rms_error(sampler, 256) / rms_error(sampler, 16)) / 4.0
    assert measured == pytest.approx(slope, abs=0.15)
