"""Adaptive sampling: who goes on depends on the block alone; whoever does has the bits of fixed sampling."""

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, material, mixed, settings
from tracer.film.develop import develop_blocks
from tracer.film.tile import Rect, blocks_of_rect
from tracer.render import get_backend, list_blocks, render_compiled
from tracer.render.adaptive import audited, contrast, render_adaptively
from tracer.types import (
    COUNTERS,
    LIMIT_ADAPTIVE_THRESHOLD,
    N_LIMITS,
    SAMPLER_INDEPENDENT,
    SAMPLER_SOBOL,
    SAMPLER_STRATIFIED,
    SETTING_MIN_SAMPLES,
    SETTING_SAMPLES,
    FilmBlocks,
)
from worker.grid import TileGrid

THRESHOLD = 0.02
WIDTH, HEIGHT = 200, 100  # no multiples of a block's edge


def adaptive(scene, first=4, threshold=THRESHOLD):
    """The scene with adaptive sampling."""
    changed, limits = scene.settings.copy(), np.zeros(N_LIMITS)
    changed[SETTING_MIN_SAMPLES], limits[LIMIT_ADAPTIVE_THRESHOLD] = first, threshold
    return scene._replace(settings=changed, limits=limits)


def fixed(**changes):
    return mixed(settings=settings(**({"width": WIDTH, "height": HEIGHT, "samples": 16} | changes)))


def render(scene, blocks, span=None):
    span = span or (0, int(scene.settings[SETTING_SAMPLES]))
    return get_backend().render(scene, np.asarray(blocks, np.int32), span, np.zeros(1, np.int64))


def parts(picture, block):
    x, y = 16 * block
    return picture[y : y + 16, x : x + 16]


def plain_contrast(means):
    """Definition, for one block's pixels (rows, columns, 3), pair by pair."""
    mean_square = 0.0
    for down, right in ((0, 1), (1, 0)):
        rows, columns = means.shape[0] - down, means.shape[1] - right
        pairs = [means[y, x] - means[y + down, x + right] for y in range(rows) for x in range(columns)]
        mean_square += np.mean(np.square(pairs)) if pairs else 0.0
    return np.sqrt(mean_square)


@pytest.mark.parametrize("size", [(40, 24), (33, 17), (16, 1), (1, 1), (1, 40)])
def test_contrast_is_the_rms_difference_of_neighbours_within_the_image(size):
    width, height = size
    scene = build(settings=settings(width=width, height=height))
    blocks = list_blocks(scene)
    sums = np.random.default_rng(3).uniform(-1, 9, (len(blocks), 2, 16, 16, 3))
    found = contrast(sums, blocks, scene.settings, 6)
    for k, (x, y) in enumerate(16 * blocks):
        means = sums[k].sum(axis=0)[: height - y, : width - x] / 6
        assert found[k] == pytest.approx(plain_contrast(means), rel=1e-13)
        assert contrast(sums[k : k + 1], blocks[k : k + 1], scene.settings, 6)[0] == found[k]


@pytest.mark.parametrize("sampler", [SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED, SAMPLER_SOBOL])
@pytest.mark.parametrize(("first", "samples"), [(2, 3), (4, 16), (6, 17)])
def test_blocks_with_detail_take_all_samples_and_others_the_first(first, samples, sampler):
    scene = fixed(samples=samples, sampler=sampler)
    blocks = list_blocks(scene)
    whole, film = render_compiled(scene).pixels, render_compiled(adaptive(scene, first))
    begun = render(scene, blocks, (0, first))
    kinds = set()
    for block, sums in zip(blocks, begun.sums, strict=True):
        x, y = 16 * block
        means = (sums.sum(axis=0) / first)[: HEIGHT - y, : WIDTH - x]
        is_finished = plain_contrast(means) >= THRESHOLD or bool(audited(block[None])[0])
        kinds.add(is_finished)
        if is_finished:
            np.testing.assert_array_equal(parts(film.pixels, block), parts(whole, block))
        else:
            np.testing.assert_allclose(parts(film.pixels, block), means, rtol=2.0**-23)
    assert kinds == {True, False}
    assert not np.array_equal(film.pixels, whole)


@pytest.mark.parametrize("threshold", [1e-300, THRESHOLD, 1e6])
def test_samples_taken_and_skipped_add_up(threshold):
    for crop in (None, (13, 14, 90, 61), (5, 3, 1, 1)):
        _, _, width, height = crop or (0, 0, WIDTH, HEIGHT)
        counters = render_compiled(adaptive(fixed(crop=crop), threshold=threshold)).counters
        assert counters["samples"] + counters["samples_skipped_adaptive"] == 16 * width * height
        assert counters["samples_skipped_adaptive"] % 12 == 0
        assert counters["samples"] >= 4 * width * height


def test_pixels_that_see_nothing_are_counted_once():
    """A small sphere: blocks that hold its edge also hold pixels that cannot see it."""
    sphere = ((-2.0, 1.0, -4.0), 0.4, material(kd=0.5))
    scene = build(spheres=[sphere], background=[0.1, 0.2, 0.3], settings=settings(samples=16))
    film = render_compiled(adaptive(scene, threshold=1e-300))
    assert film.counters["samples"] > 4 * 40 * 24
    assert film.counters["pixels_skipped_background"] == render_compiled(scene).counters["pixels_skipped_background"]


def test_a_tiny_threshold_is_fixed_sampling():
    """Blocks that are not finished are of one colour then."""
    scene = fixed()
    whole, film = render_compiled(scene).pixels, render_compiled(adaptive(scene, threshold=1e-300))
    assert film.counters["samples_skipped_adaptive"] > 0
    np.testing.assert_array_equal(film.pixels, whole)


def test_without_the_option_nothing_is_asked():
    film = render_compiled(fixed())
    names = ("samples_skipped_adaptive", "adaptive_blocks_audited", "adaptive_blocks_missed")
    assert [film.counters[name] for name in names] == [0, 0, 0]


@pytest.mark.parametrize("tile_size", [16, 64, 256])
def test_tiles_change_nothing(tile_size):
    for crop in (None, (13, 14, 90, 61)):
        scene = adaptive(fixed(crop=crop))
        film = render_compiled(scene)
        grid = TileGrid(*film.window, tile_size)
        pixels, counters = np.zeros_like(film.pixels), np.zeros(len(COUNTERS), np.int64)
        for tile in range(grid.n_tiles):
            rect = Rect(*grid.tile_rect(tile))
            part = render(scene, blocks_of_rect(rect))
            x, y = rect.x - grid.x, rect.y - grid.y
            pixels[y : y + rect.height, x : x + rect.width] = develop_blocks(rect, part.sums, 16)
            counters += part.counters
        np.testing.assert_array_equal(pixels, film.pixels)
        assert dict(zip(COUNTERS, counters.tolist(), strict=True)) == film.counters


def test_a_crop_is_part_of_the_whole_picture():
    """Whatever it leaves of a block, down to one pixel; and outside of it nothing remains."""
    whole = render_compiled(adaptive(fixed())).pixels
    for crop in [(13, 14, 90, 61), (90, 40, 1, 1), (95, 47, 2, 2), (199, 99, 1, 1), (64, 32, 16, 16)]:
        x, y, w, h = crop
        scene = adaptive(fixed(crop=crop))
        np.testing.assert_array_equal(render_compiled(scene).pixels, whole[y : y + h, x : x + w])
        sums = render(scene, list_blocks(scene)).sums
        assert np.count_nonzero(sums.sum(axis=(1, 4))) == w * h


def test_threads_change_nothing():
    one, two = (render_compiled(adaptive(fixed(width=400, height=300)), threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.pixels, two.pixels)
    assert one.counters == two.counters


def test_one_block_in_64_is_audited():
    blocks = np.stack(np.meshgrid(np.arange(128), np.arange(128)), axis=-1).reshape(-1, 2).astype(np.int32)
    chosen = blocks[audited(blocks)]
    assert len(chosen) == 128 * 128 // 64
    assert {tuple(np.bincount(chosen[:, axis], minlength=128)) for axis in (0, 1)} == {(2,) * 128}
    apart = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    assert apart[apart > 0].min() > 7


def spark(x, y):
    """A black wall with a lamp of a hundredth of a pixel's area in pixel (x, y), 1000 times as bright as white."""
    left, top = -1 + 2 * (x + 0.45) / 96, 0.6 - 1.2 * (y + 0.45) / 48
    right, bottom = left + 0.1 * 2 / 96, top - 0.1 * 1.2 / 48
    lamp = [[left, bottom, -1], [right, bottom, -1], [right, top, -1], [left, top, -1]]
    wall = [[-9, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]]
    size = settings(width=96, height=48, samples=1024, sampler=SAMPLER_SOBOL)
    return build(quads=[(wall, material()), (lamp, material(ke=1000.0))], settings=size)


@pytest.mark.parametrize(("block", "is_audited"), [((5, 1), True), ((4, 1), False)])
def test_what_the_first_samples_miss_is_found_by_the_audit_alone(block, is_audited):
    scene = adaptive(spark(16 * block[0] + 7, 16 * block[1] + 3), first=2)
    film = render_compiled(scene)
    assert film.counters["adaptive_blocks_audited"] == 1
    assert film.counters["adaptive_blocks_missed"] == is_audited
    assert (film.pixels.max() > 1.0) == is_audited


def test_sums_that_are_not_finite_are_no_reason_to_stop():
    calls = []

    def fake(scene, blocks, span):
        calls.append((len(blocks), span))
        sums = np.full((len(blocks), 2, 16, 16, 3), np.nan if len(calls) == 1 else 1.0)
        return FilmBlocks(sums, np.zeros(2, np.int64), np.zeros(len(COUNTERS), np.int64))

    scene = adaptive(fixed())
    film = render_adaptively(fake, scene, list_blocks(scene))
    assert calls == [(91, (0, 4)), (91, (0, 16))]
    assert (film.sums == 1.0).all()


@pytest.mark.parametrize("span", [(0, 4), (4, 16)])
def test_parts_of_the_samples_are_refused(span):
    with pytest.raises(ValueError, match="all 16 samples"):
        render(adaptive(fixed()), [[0, 0]], span)
