"""Four texture look-ups side by side are those of one at a time, bit for bit: both wraps, both filters, every seam."""

import numpy as np
import pytest

from tracer.accel.view import VIEW_BYTES, view_scene
from tracer.jit import int64, kernel
from tracer.rays.rows import LANES, STEP, VECTOR
from tracer.render.tiny import make_scene
from tracer.shading.texture import SAMPLE_BYTES, sample_lanes, sample_texture
from tracer.simd import address_of, load, stack_memory, store
from tracer.types import FILTER_BILINEAR, FILTER_NEAREST, WRAP_CLAMP, WRAP_REPEAT

SIZES = [(4, 3), (1, 1), (7, 1), (1, 5), (16, 16)]


@kernel
def look_up(scene, texture, wrap, filtering, us, vs, bits, alone, together):
    view = view_scene(scene, stack_memory(VIEW_BYTES))
    scratch = stack_memory(SAMPLE_BYTES)
    out = address_of(together)
    u, v = address_of(us), address_of(vs)
    for first in range(0, us.shape[0], LANES):
        found = sample_lanes(
            view, texture, wrap, filtering, load(VECTOR, u + 8 * first), load(VECTOR, v + 8 * first), bits, scratch
        )
        at = out + 24 * first
        store(at, found.x)
        store(at + STEP, found.y)
        store(at + 2 * STEP, found.z)
        for lane in range(LANES):
            k = first + lane
            one = sample_texture(view.textures, view.texels, texture, wrap, filtering, us[k], vs[k])
            alone[k, 0], alone[k, 1], alone[k, 2] = one.x, one.y, one.z


@pytest.mark.parametrize("bits", [15, 1, 6, 8])
@pytest.mark.parametrize("wrap", [WRAP_REPEAT, WRAP_CLAMP])
@pytest.mark.parametrize("filtering", [FILTER_NEAREST, FILTER_BILINEAR])
def test_lanes_are_the_look_ups_alone(filtering, wrap, bits):
    rng = np.random.default_rng(57)
    offsets = np.cumsum([3] + [w * h for w, h in SIZES])
    texels = rng.random((offsets[-1] + 1, 3)).astype(np.float32)  # one more, as the renderer has it
    scene = make_scene(textures=[[k, *size] for k, size in zip(offsets, SIZES, strict=False)], texels=texels)
    ends = [0.0, -0.0, 1.0, -1.0, 1.0 - 2.0**-53, 2.0**-60, -(2.0**-60), 1e15 + 0.5, -1e15, 1e300, -1e300, 0.5, 0.25]
    us, vs = rng.uniform(-2, 3, (2, 400))
    us[:200], vs[100:300] = rng.choice(ends, 200), rng.choice(ends, 200)
    lanes = (bits >> np.arange(400) % LANES) & 1 != 0
    for texture, (width, height) in enumerate(SIZES):
        us[300:] = rng.integers(-width, 2 * width + 1, 100) / width  # at the seams, and half a texel beside
        vs[300:] = (rng.integers(-2 * height, 4 * height + 1, 100) / 2) / height
        alone, together = np.empty((400, 3)), np.empty((100, 3, 4))
        look_up(scene, int64(texture), int64(wrap), int64(filtering), us, vs, int64(bits), alone, together.reshape(-1))
        found = together.transpose(0, 2, 1).reshape(400, 3)
        np.testing.assert_array_equal(found[lanes], alone[lanes])
        assert width * height == 1 or np.ptp(alone) > 0.1
