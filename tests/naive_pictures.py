"""Pictures from the oracle: sample positions, the mean over samples, 8-bit levels, and the measure of difference.

Job: what surrounds ``tests.naive.trace``. Invariant: nothing of ``tracer`` is imported.
"""

import random

import numpy as np

from tests.naive import trace


def render(scene, positions):
    """Return the picture (height, width, 3), row 0 on top, as the mean over samples at positions (2, height, width, samples).

    positions[:, i, j, k] are x from the left and y from the bottom, in pixels, of row i from the BOTTOM and column j.
    """
    _, height, width, samples = positions.shape
    colors = trace(scene, positions[0], positions[1]).reshape(height, width, samples, 3)
    return average(colors)


def average(colors):
    """Return the picture (rows, width, 3), top row first, of samples (rows, width, samples, 3), bottom row first."""
    total = np.zeros((*colors.shape[:2], 3))
    for k in range(colors.shape[2]):  # one after another, as a program would add them
        total += colors[:, :, k]
    return (total / colors.shape[2])[::-1]


def original_positions(width, height, samples):
    """Return the original's sample positions: Python's generator seeded with 2019, rows from the bottom, du before dv."""
    generator = random.Random(2019)
    offsets = [generator.uniform(-0.49, 0.49) for _ in range(2 * width * height * samples)]
    offsets = np.array(offsets).reshape(height, width, samples, 2)
    x = np.arange(width)[None, :, None] + 0.5 + offsets[..., 0]
    y = np.arange(height)[:, None, None] + 0.5 + offsets[..., 1]
    return np.stack([x, y])


def random_positions(width, height, samples, seed):
    """Return positions that are uniform in the whole pixel."""
    offsets = np.random.default_rng(seed).random((2, height, width, samples))
    grid = np.stack(np.broadcast_arrays(np.arange(width)[None, :], np.arange(height)[:, None]))
    return grid[..., None] + offsets


def quantise(picture):
    """Return 8-bit levels by the original's rule: clamp, times 255, truncate."""
    return (np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)


def rmse(a, b):
    """Return the root-mean-square difference over all channels of two pictures of 8-bit levels."""
    return float(np.sqrt(np.mean((a.astype(float) - b.astype(float)) ** 2)))
