"""Adaptive sampling: blocks of 16 x 16 pixels in which the first samples show no detail take no more.

Job: every block takes `SETTING_MIN_SAMPLES`; those whose contrast reaches `LIMIT_ADAPTIVE_THRESHOLD` take all of
`SETTING_SAMPLES`, and so does one in 64 whatever it shows, which tells how much was missed. A pixel is the mean of its
own samples. A block that takes all takes the first ones again, so that it has the bits that it has without this option.
That is no waste where there are many: packets of 64 rays of one pixel travel better than what is left of a pixel's
samples, 60 and 4 of the next one's (`benchmarks/results/adaptive.md`).

The measure is the contrast of neighbouring pixels, as renderers have asked since Whitted 1980 and Mitchell 1987: the
root of the mean squared difference, all pairs of the block side by side and one above the other, all channels, linear
radiance. `benchmarks/results/adaptive.md` holds it against the difference of the two halves and against the truth. In
noise that differs from pixel to pixel it is on the average twice the standard error that the halves show.

Invariant: whether a block goes on follows from the scene and its own pixels alone, all that lie in the image, inside
the crop or not. So no picture depends on tiles, the crop, threads or workers.

Sources: Whitted 1980, "An improved illumination model for shaded display"; Mitchell 1987, "Generating antialiased
images at low sampling densities"; `../shared/design/accuracy.md` section 3 for the audit.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.native.entries import entry
from tracer.types import (
    BLOCK_PX,
    COUNTERS,
    LIMIT_ADAPTIVE_THRESHOLD,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_HEIGHT,
    SETTING_MIN_SAMPLES,
    SETTING_SAMPLES,
    SETTING_WIDTH,
    CompiledScene,
    FilmBlocks,
)

measure_contrast = entry("tracer.render.contrast.measure_contrast")
scale_sums = entry("tracer.render.contrast.scale_sums")

AUDIT_PERIOD: Final = 64  # one block in so many is finished whatever it shows
_AUDIT_STEP: Final = 27  # from row to row of blocks; audited ones then lie 7.6 blocks or more apart, in every column
_AUDIT_START: Final = 32

_SAMPLES: Final = COUNTERS.index("samples")
_PIXELS_SKIPPED: Final = COUNTERS.index("pixels_skipped_background")
_SAMPLES_SKIPPED: Final = COUNTERS.index("samples_skipped_adaptive")
_AUDITED: Final = COUNTERS.index("adaptive_blocks_audited")
_MISSED: Final = COUNTERS.index("adaptive_blocks_missed")

Blocks = NDArray[np.int32]
Render = Callable[[CompiledScene, Blocks, tuple[int, int]], FilmBlocks]


def is_adaptive(scene: CompiledScene) -> bool:
    """Whether a scene's blocks may differ in the number of their samples."""
    return bool(scene.settings[SETTING_MIN_SAMPLES] > 0)


def render_adaptively(render: Render, scene: CompiledScene, blocks: Blocks) -> FilmBlocks:
    """Render blocks, each with as many samples as it needs.

    Parameters
    ----------
    render : callable
        Takes a range of samples of some blocks of a scene.
    scene : CompiledScene
        With `SETTING_MIN_SAMPLES` even, from 2 to below `SETTING_SAMPLES`.
    blocks : int32 (n, 2)
        Block coordinates.

    Returns
    -------
    FilmBlocks
        As if all samples had been taken: the sums of a block that took fewer are scaled.
    """
    settings = scene.settings
    n_samples, n_first = int(settings[SETTING_SAMPLES]), int(settings[SETTING_MIN_SAMPLES])
    threshold = scene.limits[LIMIT_ADAPTIVE_THRESHOLD]
    film = render(scene._replace(settings=_uncropped(settings)), blocks, (0, n_first))
    sums, counters = film.sums, film.counters
    plain = contrast(sums, blocks, settings, n_first) < threshold  # not so where it is NaN
    is_audited = audited(blocks)
    finished = np.flatnonzero(~plain | is_audited)
    left = np.flatnonzero(plain & ~is_audited)

    inside = _pixels_inside(blocks, settings)
    n_pixels = (inside[:, 1] - inside[:, 0]) * (inside[:, 3] - inside[:, 2])
    cropped = np.flatnonzero(n_pixels != _pixel_counts(blocks, settings))
    for block in cropped:
        _clear_outside(sums[block], inside[block])
    scale_sums(sums, left, n_samples / n_first)
    if len(finished):
        whole = render(scene, blocks[finished], (0, n_samples))
        sums[finished] = whole.sums
        skipped = counters[_PIXELS_SKIPPED]
        counters += whole.counters
        counters[_PIXELS_SKIPPED] = skipped  # the same pixels once more

    n_skipped = (n_samples - n_first) * int(n_pixels[left].sum())
    counters[_SAMPLES] = n_samples * int(n_pixels.sum()) - n_skipped
    counters[_SAMPLES_SKIPPED] = n_skipped
    asked = np.setdiff1d(np.flatnonzero(plain & is_audited), cropped)
    if len(asked):
        counters[_AUDITED] = len(asked)
        still = contrast(sums[asked], blocks[asked], settings, n_samples) < threshold
        counters[_MISSED] = len(asked) - int(still.sum())
    n_even = (n_samples + 1) // 2
    return FilmBlocks(sums, np.array([n_even, n_samples - n_even], np.int64), counters)


def contrast(
    sums: NDArray[np.float64], blocks: Blocks, settings: NDArray[np.int64], n_samples: int
) -> NDArray[np.float64]:
    """Return the contrast of each block, float64 (n,); see `measure_contrast`."""
    found = np.empty(len(blocks))
    measure_contrast(sums, blocks, int(settings[SETTING_WIDTH]), int(settings[SETTING_HEIGHT]), n_samples, found)
    return found


def audited(blocks: Blocks) -> NDArray[np.bool_]:
    """Tell which blocks are finished whatever they show: a lattice of one in `AUDIT_PERIOD`."""
    found: NDArray[np.bool_] = (blocks[:, 0] + _AUDIT_STEP * blocks[:, 1] + _AUDIT_START) % AUDIT_PERIOD == 0
    return found


def _uncropped(settings: NDArray[np.int64]) -> NDArray[np.int64]:
    changed = settings.copy()
    changed[[SETTING_CROP_X, SETTING_CROP_Y]] = 0
    changed[[SETTING_CROP_WIDTH, SETTING_CROP_HEIGHT]] = settings[[SETTING_WIDTH, SETTING_HEIGHT]]
    return changed


def _pixels_inside(blocks: Blocks, settings: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the columns first, end and rows first, end of each block that lie in the crop."""
    first = settings[[SETTING_CROP_X, SETTING_CROP_Y]]
    end = first + settings[[SETTING_CROP_WIDTH, SETTING_CROP_HEIGHT]]
    corners = BLOCK_PX * blocks.astype(np.int64)
    low = np.clip(first - corners, 0, BLOCK_PX)
    high = np.clip(end - corners, low, BLOCK_PX)
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)


def _pixel_counts(blocks: Blocks, settings: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of each block's pixels that lie in the image."""
    sides = np.clip(settings[[SETTING_WIDTH, SETTING_HEIGHT]] - BLOCK_PX * blocks.astype(np.int64), 0, BLOCK_PX)
    counts: NDArray[np.int64] = sides[:, 0] * sides[:, 1]
    return counts


def _clear_outside(sums: NDArray[np.float64], inside: NDArray[np.int64]) -> None:
    """Set the sums (2, 16, 16, 3) of pixels that do not count to 0."""
    left, right, top, bottom = inside
    kept = sums[:, top:bottom, left:right].copy()
    sums[:] = 0.0
    sums[:, top:bottom, left:right] = kept
