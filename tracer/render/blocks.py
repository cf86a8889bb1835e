"""The kernel: blocks of 16 x 16 pixels, from camera ray to compensated sums.

Invariants: a pixel's sums depend on the scene, the pixel and the sample range alone, not on the block, its order,
or the thread. Each half (even and odd sample indices) is summed with compensation and rounded once. The cancel flag
is read before every row of a block and every 512 samples of a pixel, so a cancel is seen within a few milliseconds.

Source: Neumaier 1974 (summation). See ARCHITECTURE.md, "Three seams".
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel.view import view_scene
from tracer.geometry.vector import at
from tracer.integrators.blinn_phong import total_ambient, trace_radiance
from tracer.integrators.scratch import allocate, make_scratch
from tracer.jit import inline, int64, kernel, pointer
from tracer.rays.camera import camera_ray, unit_ray
from tracer.rays.frustum import misses_bounds
from tracer.sampling.hashing import pixel_key
from tracer.sampling.sampler import sample_keyed
from tracer.types import (
    BLOCK_PX,
    COUNTERS,
    SETTING_CAMERA,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_HEIGHT,
    SETTING_MAX_DEPTH,
    SETTING_SAMPLER,
    SETTING_SAMPLES,
    SETTING_SEED,
    SETTING_SKIP,
    SETTING_WIDTH,
    CompiledScene,
)

_SAMPLES: Final = COUNTERS.index("samples")
_PRIMARY_RAYS: Final = COUNTERS.index("primary_rays")
_PIXELS_SKIPPED: Final = COUNTERS.index("pixels_skipped_background")
_POLL_SAMPLES: Final = 512  # samples of a pixel between two looks at the cancel flag


@inline
def add_compensated(total: float, rest: float, value: float) -> tuple[float, float]:
    """One step of Neumaier's sum: new total and new sum of what the roundings lost."""
    new = total + value
    if abs(total) >= abs(value):
        rest += (total - new) + value
    else:
        rest += (value - new) + total
    return new, rest


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
    view = view_scene(scene)
    settings = view.settings
    stack, stack_t, pending, occluders = allocate(settings[SETTING_MAX_DEPTH], view.n_lights)
    scratch = make_scratch(stack, stack_t, pending, occluders, counters)
    flag = pointer(cancel)
    out = pointer(sums)
    where = pointer(blocks)
    ambient = total_ambient(view)
    background = at(view.background, 0)
    width = settings[SETTING_WIDTH]
    height = settings[SETTING_HEIGHT]
    kind = settings[SETTING_CAMERA]
    sampler = settings[SETTING_SAMPLER]
    n_samples = settings[SETTING_SAMPLES]
    seed = settings[SETTING_SEED]
    crop_x = settings[SETTING_CROP_X]
    crop_y = settings[SETTING_CROP_Y]
    crop_end_x = crop_x + settings[SETTING_CROP_WIDTH]
    crop_end_y = crop_y + settings[SETTING_CROP_HEIGHT]
    may_skip = settings[SETTING_SKIP] != 0 and view.n_planes == 0
    half_size = BLOCK_PX * BLOCK_PX * 3
    for block in range(blocks.shape[0]):
        x0 = BLOCK_PX * int64(where[2 * block])
        y0 = BLOCK_PX * int64(where[2 * block + 1])
        # Each block starts with an empty occluder cache, so that its counters do not depend on what was rendered
        # before.
        for light in range(view.n_lights):
            scratch.occluders[light] = -1
        block_empty = may_skip and misses_bounds(
            view.camera, kind, x0, y0, x0 + BLOCK_PX, y0 + BLOCK_PX, width, height, view.bvh_root
        )
        for row in range(BLOCK_PX):
            py = y0 + row
            if py < crop_y or py >= crop_end_y:
                continue
            if flag[0] != 0:
                return False
            for column in range(BLOCK_PX):
                px = x0 + column
                if px < crop_x or px >= crop_end_x:
                    continue
                empty = block_empty or (
                    may_skip and misses_bounds(view.camera, kind, px, py, px + 1, py + 1, width, height, view.bvh_root)
                )
                if empty:
                    scratch.counters[_PIXELS_SKIPPED] += 1
                key = pixel_key(seed, px, py, 0)
                # Sums and what their roundings lost, of the even and the odd samples.
                r0, g0, b0, r1, g1, b1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                r0_rest, g0_rest, b0_rest, r1_rest, g1_rest, b1_rest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for sample in range(first_sample, end_sample):
                    color = background
                    if not empty:
                        if sample % _POLL_SAMPLES == _POLL_SAMPLES - 1 and flag[0] != 0:
                            return False
                        u, v = sample_keyed(sampler, key, sample, n_samples)
                        ray = unit_ray(camera_ray(view.camera, kind, px + u, py + v, width, height))
                        color = trace_radiance(view, ambient, ray.origin, ray.direction, scratch)
                        scratch.counters[_PRIMARY_RAYS] += 1
                    scratch.counters[_SAMPLES] += 1
                    if sample % 2 == 0:
                        r0, r0_rest = add_compensated(r0, r0_rest, color.x)
                        g0, g0_rest = add_compensated(g0, g0_rest, color.y)
                        b0, b0_rest = add_compensated(b0, b0_rest, color.z)
                    else:
                        r1, r1_rest = add_compensated(r1, r1_rest, color.x)
                        g1, g1_rest = add_compensated(g1, g1_rest, color.y)
                        b1, b1_rest = add_compensated(b1, b1_rest, color.z)
                i = 2 * half_size * block + 3 * (BLOCK_PX * row + column)
                out[i] = r0 + r0_rest
                out[i + 1] = g0 + g0_rest
                out[i + 2] = b0 + b0_rest
                out[i + half_size] = r1 + r1_rest
                out[i + half_size + 1] = g1 + g1_rest
                out[i + half_size + 2] = b1 + b1_rest
    return True
