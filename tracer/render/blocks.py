"""The kernel: blocks of 16 x 16 pixels, from camera ray to compensated sums.

A block is rendered in waves of up to 1024 samples: camera rays 64 at a time, the samples of neighbouring pixels
together, then all their bounces. Pixels follow each other along a Z curve, so that what is near in a wave is near in
the picture.

Invariants: a pixel's sums depend on the scene, the block and the sample range alone, not on the other blocks of the
call, their order, or the thread. Each half (even and odd sample indices) is summed with compensation and rounded once.
The cancel flag is read before every wave, so a cancel is seen within a few milliseconds.

Sources: Morton 1966 (Z curve). See ARCHITECTURE.md, "Three seams".
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel.view import VIEW_BYTES, view_scene
from tracer.integrators.blinn_phong import FROM_EYE, total_ambient, trace_bounces, trace_radiance
from tracer.integrators.bounces import n_mirrored
from tracer.integrators.corners import Seen, nothing_seen
from tracer.integrators.places import PIXEL, order_samples, place_samples
from tracer.integrators.plain import camera_pencil, is_plain, shade_plain
from tracer.integrators.scratch import WAVE, Scratch, allocate, capacity
from tracer.integrators.sums import SUMS, add_wave
from tracer.integrators.survey import SURVEY_BYTES, recall, start_survey, survey_square
from tracer.jit import inline, int64, kernel, pointer
from tracer.rays.camera_lanes import fill_camera_rays
from tracer.rays.frustum import misses_bounds
from tracer.rays.rows import (
    ALL,
    INTEGERS,
    LANES,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    RAY_ROWS,
    ROW,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    shear_lanes,
)
from tracer.sampling.hashing import pixel_key
from tracer.shading.rows import DEPTH, DIRECTION, FROM, HIT_ROWS, SAMPLE, THROUGHPUT
from tracer.simd import address_of, iota, load, splat, stack_memory, store
from tracer.simd.gateway import types
from tracer.types import (
    BLOCK_PX,
    COUNTERS,
    MATERIAL_KT,
    SETTING_CAMERA,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_HEIGHT,
    SETTING_MAX_DEPTH,
    SETTING_SEED,
    SETTING_SKIP,
    SETTING_WIDTH,
    CompiledScene,
    SceneView,
    Vec3,
)

_int64: Final = types.int64
_SAMPLES: Final = COUNTERS.index("samples")
_PRIMARY_RAYS: Final = COUNTERS.index("primary_rays")
_PIXELS_SKIPPED: Final = COUNTERS.index("pixels_skipped_background")
_BLOCK_PIXELS: Final = BLOCK_PX * BLOCK_PX
_SQUARE: Final = 16  # pixels of the Z curve that make a square of 4 x 4
_PLACE_BYTES: Final = 2 * ROW
_ORDER_BYTES: Final = 8 * PACKET


@inline
def _even_bits(code: int) -> int:
    """Gather bits 0, 2, 4, 6: a coordinate on the Z curve."""
    return (code & 1) | ((code >> 1) & 2) | ((code >> 2) & 4) | ((code >> 3) & 8)


@kernel
def _trace_camera_rays(
    view: SceneView, ambient: Vec3, scratch: Scratch, seen: Seen, places: int, n: int, per_pixel: int, start: int
) -> None:
    """Trace up to 64 camera rays.

    Parameters
    ----------
    view, ambient, scratch, seen
        As `trace_radiance`.
    places
        Where they pass through the picture (`place_samples`).
    n, per_pixel
        How many; those of a pixel.
    start
        Number of the first in the wave.
    """
    settings = view.settings
    hits = scratch.hits
    numbers = stack_memory(_ORDER_BYTES)
    # where no two corners see one face: a fine mesh
    ordered = seen.face < 0 and not seen.divided and settings[SETTING_SKIP] != 0 and per_pixel % LANES == 0
    if ordered:
        order_samples(places, places + ROW, n, min(per_pixel, n), hits + THROUGHPUT, numbers)
    else:
        for k in range(0, n, LANES):
            store(numbers + 8 * k, iota(INTEGERS) + splat(INTEGERS, k))
    fill_camera_rays(
        view.camera,
        settings[SETTING_CAMERA],
        settings[SETTING_WIDTH],
        settings[SETTING_HEIGHT],
        n,
        places,
        hits + ORIGIN,
        hits + DIRECTION,
    )
    one, none = splat(VECTOR, 1.0), splat(INTEGERS, _int64(-1))
    first = splat(INTEGERS, start)
    for k in range((n + 3) // 4):
        at_lanes = hits + STEP * k
        d = at_lanes + DIRECTION
        shear_lanes(hits, k, load(VECTOR, d), load(VECTOR, d + ROW), load(VECTOR, d + 2 * ROW))
        store(at_lanes + T_BEST, splat(VECTOR, np.inf))
        store(at_lanes + PRIMITIVE, none)
        store(at_lanes + SKIP, none)
        store(at_lanes + THROUGHPUT, one)
        store(at_lanes + THROUGHPUT + ROW, one)
        store(at_lanes + THROUGHPUT + 2 * ROW, one)
        store(at_lanes + SAMPLE, load(INTEGERS, numbers + STEP * k) + first)
        store(at_lanes + DEPTH, none + splat(INTEGERS, _int64(1)))
        store(at_lanes + FROM, none)
    lanes = int64(ALL) if n == PACKET else (int64(1) << n) - 1
    trace_radiance(view, ambient, scratch, seen, lanes, int64(FROM_EYE) if ordered else start)


@inline
def _end_of_square(pixels: Any, begin: int, n_pixels: int) -> int:
    """Find the end of the pixels that one thing is known of (`survey_square`)."""
    end = begin + 1
    while end < n_pixels and pixels[PIXEL * end + 3] == pixels[PIXEL * begin + 3]:
        end += 1
    return end


@kernel
def _render_wave(
    view: SceneView,
    ambient: Vec3,
    scratch: Scratch,
    survey: int,
    pixels: Any,
    n_pixels: int,
    first: int,
    end: int,
    sums: Any,
) -> None:
    """Render samples first..end of some pixels and add them to the sums.

    Parameters
    ----------
    view, ambient, scratch
        As `trace_radiance`.
    survey
        Address of what is known of the pixels' squares (`survey_square`).
    pixels, n_pixels
        As `place_samples`.
    first, end
        ``n_pixels * (end - first) <= WAVE``.
    sums
        Flat float64, `SUMS` of each pixel of the wave.
    """
    settings = view.settings
    per_pixel = end - first
    pencil = camera_pencil(view.camera, settings[SETTING_WIDTH], settings[SETTING_HEIGHT])
    places = stack_memory(_PLACE_BYTES)
    points = scratch.hits + THROUGHPUT  # free until the rays are there
    together = max(1, PACKET // per_pixel)  # pixels of a packet
    cleared = False
    start = 0
    while start < n_pixels:
        stop = _end_of_square(pixels, start, n_pixels)
        seen, mirrored = recall(survey, pixels[PIXEL * start + 3])
        if is_plain(view, seen, mirrored):
            shade_plain(
                view,
                ambient,
                scratch.counters,
                seen,
                mirrored,
                pencil,
                pixels,
                start,
                stop,
                first,
                per_pixel,
                points,
                sums,
            )
            start = stop
            continue
        if not cleared:  # what is plain is not added up here
            cleared = True
            for channel in range(3):
                for k in range(0, 8 * n_pixels * per_pixel, STEP):
                    store(scratch.radiance + 8 * WAVE * channel + k, splat(VECTOR, 0.0))
        waiting = n_mirrored(scratch)
        for pixel in range(start, stop, together):
            n_together = min(together, stop - pixel)
            for skipped in range(0, per_pixel, PACKET):
                rays = min(PACKET, per_pixel - skipped) if together == 1 else n_together * per_pixel
                place_samples(settings, pixels, pixel, first + skipped, rays, per_pixel, points, places)
                _trace_camera_rays(view, ambient, scratch, seen, places, rays, per_pixel, pixel * per_pixel + skipped)
        if mirrored.face >= 0:
            trace_bounces(view, ambient, scratch, mirrored, waiting)
        start = stop
    trace_bounces(view, ambient, scratch, nothing_seen(False), int64(-1))
    start = 0
    while start < n_pixels:
        stop = _end_of_square(pixels, start, n_pixels)
        seen, mirrored = recall(survey, pixels[PIXEL * start + 3])
        if not is_plain(view, seen, mirrored):
            first_sum = SUMS * start
            add_wave(scratch.radiance + 8 * start * per_pixel, stop - start, per_pixel, first, sums, first_sum)
        start = stop


@kernel
def _render(
    scene: CompiledScene,
    blocks: NDArray[np.int32],
    first_sample: int,
    end_sample: int,
    cancel: NDArray[np.int64],
    sums: NDArray[np.float64],
    counters: NDArray[np.int64],
    memory: NDArray[np.float64],
    words: NDArray[np.int64],
) -> bool:
    """Do what `render_blocks` does in memory that its caller keeps alive: numba frees an array after its last use."""
    view = view_scene(scene, stack_memory(VIEW_BYTES))
    settings = view.settings
    hits = (address_of(memory) + 63) & ~63
    shadows = hits + HIT_ROWS * ROW
    radiance = shadows + RAY_ROWS * ROW
    scratch = Scratch(
        hits,
        shadows,
        radiance,
        radiance + 8 * 3 * WAVE,
        8 * capacity(settings[SETTING_MAX_DEPTH]),
        address_of(words),
        8 * (settings[SETTING_MAX_DEPTH] + 2),
        address_of(scene.trees),
        address_of(scene.materials) + 8 * MATERIAL_KT,
        address_of(scene.face_material),
        pointer(words[2 * (settings[SETTING_MAX_DEPTH] + 2) :]),
        pointer(counters),
    )
    flag = pointer(cancel)
    ambient = total_ambient(view)
    wave_pixels = np.empty((_BLOCK_PIXELS, PIXEL), np.int64)
    survey = stack_memory(SURVEY_BYTES)
    wave_sums = np.empty((_BLOCK_PIXELS, SUMS))
    width, height, kind = settings[SETTING_WIDTH], settings[SETTING_HEIGHT], settings[SETTING_CAMERA]
    crop_x, crop_y = settings[SETTING_CROP_X], settings[SETTING_CROP_Y]
    crop_end_x, crop_end_y = crop_x + settings[SETTING_CROP_WIDTH], crop_y + settings[SETTING_CROP_HEIGHT]
    may_skip = settings[SETTING_SKIP] != 0 and view.n_planes == 0
    n_taken = end_sample - first_sample
    n_even = (end_sample + 1) // 2 - (first_sample + 1) // 2
    for block in range(blocks.shape[0]):
        x0 = BLOCK_PX * int64(blocks[block, 0])
        y0 = BLOCK_PX * int64(blocks[block, 1])
        if flag[0] != 0:
            return False
        block_empty = may_skip and misses_bounds(
            view.camera, kind, x0, y0, x0 + BLOCK_PX, y0 + BLOCK_PX, width, height, view.bvh_root
        )
        n_pixels = 0
        empty = block_empty
        known = int64(-1)  # what is known of the pixel's square; not asked
        start_survey(survey)
        for code in range(_BLOCK_PIXELS):
            px, py = x0 + _even_bits(code), y0 + _even_bits(code >> 1)
            if code % _SQUARE == 0:  # the next 4 x 4 pixels
                known = int64(-1)
                if may_skip and not block_empty:
                    empty = misses_bounds(view.camera, kind, px, py, px + 4, py + 4, width, height, view.bvh_root)
            if px < crop_x or px >= crop_end_x or py < crop_y or py >= crop_end_y:
                continue
            counters[_SAMPLES] += n_taken
            if empty:
                counters[_PIXELS_SKIPPED] += 1
                for channel in range(3):
                    sums[block, 0, py - y0, px - x0, channel] = n_even * view.background[channel]
                    sums[block, 1, py - y0, px - x0, channel] = (n_taken - n_even) * view.background[channel]
                continue
            counters[_PRIMARY_RAYS] += n_taken
            wave_pixels[n_pixels, 0] = px
            wave_pixels[n_pixels, 1] = py
            wave_pixels[n_pixels, 2] = int64(pixel_key(settings[SETTING_SEED], px, py, 0))
            if known < 0:
                known = survey_square(view, ambient, scratch, survey, int64(code // _SQUARE), x0, y0)
            wave_pixels[n_pixels, 3] = known
            n_pixels += 1
        wave_sums[:] = 0.0
        together = max(1, WAVE // n_taken)
        for start in range(0, n_pixels, together):
            n = min(together, n_pixels - start)
            for first in range(first_sample, end_sample, WAVE):
                if flag[0] != 0:
                    return False
                end = min(end_sample, first + WAVE)
                _render_wave(
                    view,
                    ambient,
                    scratch,
                    survey,
                    pointer(wave_pixels[start:]),
                    n,
                    first,
                    end,
                    pointer(wave_sums[start:]),
                )
        for k in range(n_pixels):
            row, column = wave_pixels[k, 1] - y0, wave_pixels[k, 0] - x0
            for half in range(2):
                for channel in range(3):
                    i = 3 * half + channel
                    sums[block, half, row, column, channel] = wave_sums[k, i] + wave_sums[k, i + 6]
    return True


@kernel
def render_blocks(
    scene: CompiledScene,
    blocks: NDArray[np.int32],
    first_sample: int,
    end_sample: int,
    cancel: NDArray[np.int64],
    sums: NDArray[np.float64],
    counters: NDArray[np.int64],
) -> bool:
    """Render blocks into ``sums``; pixels outside the crop stay as they are.

    Parameters
    ----------
    scene
        Arrays as :data:`tracer.types.FIELDS` says.
    blocks : int32 (n, 2)
        Coordinates (bx, by) in units of 16 px of the absolute image grid.
    first_sample, end_sample
        Half-open range of sample indices.
    cancel : int64 (1,)
        Set to non-zero by another thread: stop soon.
    sums : float64 (n, 2, 16, 16, 3)
        Zero on entry.
    counters : int64 (len(COUNTERS),)
        Added to.

    Returns
    -------
    bool
        False when canceled: ``sums`` is then incomplete.
    """
    memory, words = allocate(scene.settings[SETTING_MAX_DEPTH])
    return _render(scene, blocks, first_sample, end_sample, cancel, sums, counters, memory, words)
