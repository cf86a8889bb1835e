"""Memory of bounces that wait: never more than was allocated, at the greatest depth and in a full wave."""

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, material, settings
from tracer.integrators.scratch import PENDING_ROWS, WAVE, allocate, capacity
from tracer.rays.rows import PACKET, RAY_ROWS
from tracer.render import list_blocks
from tracer.render.blocks import _render
from tracer.shading.rows import HIT_ROWS
from tracer.types import COUNTERS, LIMIT_MIN_THROUGHPUT, N_LIMITS

FRONT = [[-99, -99, -4], [99, -99, -4], [99, 99, -4], [-99, 99, -4]]
BACK = [[-99, -99, 2], [-99, 99, 2], [99, 99, 2], [99, -99, 2]]
PANE = [[-99, -99, -2], [99, -99, -2], [99, 99, -2], [-99, 99, -2]]


def render_in(scene, samples):
    """Render in memory of one's own: (sums, counters by name, waiting bounces (2, rows, capacity), heights, guard)."""
    depth = int(scene.settings[9])
    memory, words = allocate(depth)
    guarded = np.concatenate([memory, np.full(4096, 12345.0)])
    pending = np.full((2, PENDING_ROWS, capacity(depth)), np.nan)
    start = len(memory) - pending.size - 8 + ((guarded.ctypes.data + 63 & ~63) - guarded.ctypes.data) // 8
    guarded[start : start + pending.size] = np.nan
    blocks, counters = list_blocks(scene), np.zeros(len(COUNTERS), np.int64)
    sums = np.zeros((len(blocks), 2, 16, 16, 3))
    assert _render(scene, blocks, 0, samples, np.zeros(1, np.int64), sums, counters, guarded, words)
    used = guarded[start : start + pending.size].reshape(pending.shape)
    return (
        sums,
        dict(zip(COUNTERS, counters.tolist(), strict=True)),
        used,
        words[: 2 * (depth + 2)],
        guarded[len(memory) :],
    )


@pytest.mark.parametrize("depth", [1, 2, 7, 32])
def test_two_mirrors_and_glass(depth):
    """Both stacks in use at every depth: a full wave of first bounces, and at most a packet of each depth beyond."""
    limits = np.zeros(N_LIMITS)
    limits[LIMIT_MIN_THROUGHPUT] = 0.9**33 * 0.04
    mirror = material(ke=1.0, kr=0.9)
    pane = material(kr=0.9, kt=0.05)
    scene = build(
        quads=[(FRONT, mirror), (PANE, pane), (BACK, mirror)],
        settings=settings(width=16, height=16, samples=4, depth=depth),
        limits=limits,
    )
    sums, counters, pending, heights, guard = render_in(scene, 4)
    assert not heights.any()
    assert (guard == 12345.0).all()
    assert np.isfinite(sums).all()
    assert counters["samples"] == WAVE
    assert counters["bounces_skipped_depth"] > 0
    for which in range(2):
        filled = ~np.isnan(pending[which, 0])
        top = np.flatnonzero(filled).max(initial=-1) + 1
        assert filled[:top].all()  # no gaps
        assert WAVE <= top <= WAVE + PACKET * max(0, depth - 1) < capacity(depth)
    if depth == 32:
        assert max(np.flatnonzero(~np.isnan(pending[k, 0])).max() for k in range(2)) > WAVE + 10 * PACKET


def test_a_lone_mirror_path_of_the_greatest_depth():
    """Thirty-two bounces between the mirrors, in closed form: 1 + k + k^2 + ..."""
    mirror = material(ke=1.0, kr=0.75)
    scene = build(quads=[(FRONT, mirror), (BACK, mirror)], settings=settings(width=16, height=16, samples=1, depth=32))
    scene.camera[12:16] = -1e-9, 1e-9, -1e-9, 1e-9
    sums, counters, *_ = render_in(scene, 1)
    np.testing.assert_allclose(sums[0, 0], sum(0.75**k for k in range(33)), rtol=1e-14)
    assert counters["reflection_rays"] == 32 * 256


def test_sizes():
    """There is room for all rows, wherever the first cache line begins."""
    for depth in (0, 3, 32):
        memory, words = allocate(depth)
        assert len(memory) >= (HIT_ROWS + RAY_ROWS) * PACKET + 3 * WAVE + 2 * PENDING_ROWS * capacity(depth) + 7
        assert len(words) > 2 * (depth + 2)
