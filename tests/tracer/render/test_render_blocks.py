"""Waves: every sample of every pixel is taken once, in its half, whatever the number of samples, the range or the crop."""

import itertools
import math

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, material, mixed, settings
from tracer.integrators.scratch import WAVE
from tracer.render import get_backend, list_blocks
from tracer.render.blocks import _even_bits
from tracer.sampling.sampler import sample_2d
from tracer.types import BLOCK_PX, COUNTERS, SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED

COUNTS = (1, 3, 5, 9, 17, 100, 1000, 2000)
CROP = (13, 14, 7, 4)  # four blocks, cut on all sides


def render(scene, span, blocks=None):
    blocks = list_blocks(scene) if blocks is None else np.asarray(blocks, np.int32)
    return get_backend().render(scene, blocks, span, np.zeros(1, np.int64))


def picture(scene, film):
    """Sums of the halves (2, height, width, 3) of the whole image."""
    width, height = int(scene.settings[0]), int(scene.settings[1])
    result = np.zeros((2, -(-height // BLOCK_PX) * BLOCK_PX, -(-width // BLOCK_PX) * BLOCK_PX, 3))
    for (bx, by), sums in zip(list_blocks(scene).tolist(), film.sums, strict=True):
        result[:, BLOCK_PX * by : BLOCK_PX * (by + 1), BLOCK_PX * bx : BLOCK_PX * (bx + 1)] = sums
    return result[:, :height, :width]


@pytest.mark.parametrize("sampler", [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL])
@pytest.mark.parametrize("samples", COUNTS)
def test_every_sample_is_taken_once(samples, sampler):
    """A lamp whose edge cuts a column of pixels: the sums count the samples to the left of it, half by half.

    Sums of ones are exact, so a sample that is lost, doubled, put elsewhere or into the other half is seen. The three
    parts of a range that is cut at odd places add up to the whole.
    """
    edge = 15.4  # in pixels of 40, so at x = -1 + 2 * 15.4 / 40 = -0.23 of the view plane
    x = -1.0 + 2.0 * edge / 40
    lamp = [[-9, -9, -1], [x, -9, -1], [x, 9, -1], [-9, 9, -1]]
    scene = build(
        quads=[(lamp, material(ke=[1.0, 2.0, 0.0]))],
        settings=settings(samples=samples, sampler=sampler, seed=7, crop=CROP),
    )
    left, top, width, height = CROP
    expected = np.zeros((2, 24, 40))
    for py in range(top, top + height):
        for px in range(left, left + width):
            if px < 15:
                expected[:, py, px] = (samples + 1) // 2, samples // 2
            elif px == 15:
                for k in range(samples):
                    u, _ = sample_2d(sampler, 7, px, py, k, samples, 0)
                    assert abs(px + u - edge) > 1e-9
                    expected[k % 2, py, px] += px + u < edge
    cuts = sorted({0, min(samples, samples // 3 | 1), samples // 2, samples})
    parts = [render(scene, span) for span in itertools.pairwise(cuts)]
    for films in ([render(scene, (0, samples))], parts):
        sums = sum(picture(scene, film) for film in films)
        np.testing.assert_array_equal(sums[..., 0], expected)
        np.testing.assert_array_equal(sums[..., 1], 2 * expected)
        assert (sums[..., 2] == 0).all()
        counters = np.sum([film.counters for film in films], axis=0)
        assert counters[COUNTERS.index("samples")] == samples * width * height


@pytest.mark.parametrize("samples", [1, 5, 17, 64, 100, 1500])
def test_samples_do_not_depend_on_their_wave(samples):
    """Mirrors and glass: every sample alone (other pixels beside it, other lanes) sums to the picture of all.

    Compensated sums are rounded once, so they equal `fsum` to the last place.
    """
    scene = mixed(settings=settings(samples=samples, crop=(17, 13, 6, 4), depth=5))
    whole = render(scene, (0, samples)).sums
    step = 1 if samples <= 17 else 37
    ranges = [(k, min(k + step, samples)) for k in range(0, samples, step)]
    parts = np.stack([render(scene, span).sums for span in ranges])
    exact = np.apply_along_axis(math.fsum, 0, parts)
    np.testing.assert_allclose(whole, exact, rtol=4e-16 if step == 1 else 2e-15, atol=0)
    assert (whole != 0).any()


def test_two_halves_of_a_range_equal_the_whole():
    scene = mixed(settings=settings(samples=16))
    whole = render(scene, (0, 16))
    first, second = render(scene, (0, 8)), render(scene, (8, 16))
    np.testing.assert_allclose(first.sums + second.sums, whole.sums, rtol=4e-16)
    np.testing.assert_array_equal(first.counters + second.counters, whole.counters)


@pytest.mark.parametrize("samples", [1, 17, 100, 1100])
def test_any_partition_into_calls_gives_the_same_bits(samples):
    scene = mixed(settings=settings(samples=samples, crop=(9, 3, 26, 15), depth=4))
    blocks = list_blocks(scene)
    together = render(scene, (0, samples))
    rng = np.random.default_rng(samples)
    order = rng.permutation(len(blocks))
    cuts = np.sort(rng.choice(np.arange(1, len(blocks)), 2, replace=False))
    pieces = [render(scene, (0, samples), blocks[part]) for part in np.split(order, cuts)]
    np.testing.assert_array_equal(np.concatenate([piece.sums for piece in pieces]), together.sums[order])
    np.testing.assert_array_equal(np.sum([piece.counters for piece in pieces], axis=0), together.counters)


@pytest.mark.parametrize("samples", [1, 3, 100])
@pytest.mark.parametrize("crop", [(0, 0, 1, 1), (15, 15, 2, 2), (31, 0, 9, 24), (3, 7, 29, 1)])
def test_crops_equal_the_full_picture(crop, samples):
    """Which pixels share a wave changes with the crop; their sums do not."""
    x, y, w, h = crop
    options = {"samples": samples, "depth": 4, "width": 40, "height": 24}
    full = mixed(settings=settings(**options))
    part = mixed(settings=settings(**options, crop=crop))
    want = picture(full, render(full, (0, samples)))[:, y : y + h, x : x + w]
    got = picture(part, render(part, (0, samples)))
    np.testing.assert_array_equal(got[:, y : y + h, x : x + w], want)
    got[:, y : y + h, x : x + w] = 0
    assert (got == 0).all()


def test_pixels_of_a_block_follow_a_z_curve():
    """Each pixel once, and every aligned run of 4, 16, 64 is a square."""
    places = [(_even_bits(code), _even_bits(code >> 1)) for code in range(BLOCK_PX**2)]
    assert len(set(places)) == BLOCK_PX**2
    for run, edge in ((4, 2), (16, 4), (64, 8)):
        for start in range(0, BLOCK_PX**2, run):
            corner = np.ptp(np.array(places[start : start + run]), axis=0)
            assert corner.tolist() == [edge - 1, edge - 1]


def test_a_wave_holds_whole_pixels():
    assert WAVE % BLOCK_PX**2 == 0
