"""Kernels of adaptive sampling: how much the pixels of a block differ, and sums scaled to more samples.

Invariant: a block's numbers depend on its own sums alone, and are added in a fixed order.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tracer.jit import int64, kernel
from tracer.types import BLOCK_PX


@kernel
def measure_contrast(
    sums: NDArray[np.float64],
    blocks: NDArray[np.int32],
    width: int,
    height: int,
    n_samples: int,
    contrasts: NDArray[np.float64],
) -> None:
    """Find the root of the mean squared difference of neighbouring pixels, in all channels, of each block.

    Parameters
    ----------
    sums : float64 (n, 2, 16, 16, 3)
        Of the two halves, linear radiance.
    blocks : int32 (n, 2)
        Block coordinates.
    width, height
        Of the image; pixels beyond it do not count.
    n_samples
        Of both halves.
    contrasts : float64 (n,)
        Written: linear radiance; 0 of a single pixel.
    """
    for block in range(sums.shape[0]):
        columns = min(BLOCK_PX, width - BLOCK_PX * int64(blocks[block, 0]))
        rows = min(BLOCK_PX, height - BLOCK_PX * int64(blocks[block, 1]))
        even, odd = sums[block, 0], sums[block, 1]
        mean_square = 0.0
        for down in range(2):
            right = 1 - down
            n_pairs = max(0, rows - down) * max(0, columns - right)
            red, green, blue = 0.0, 0.0, 0.0  # apart, so that one addition need not wait for another
            for y in range(rows - down):
                for x in range(columns - right):
                    d0 = (even[y, x, 0] + odd[y, x, 0]) - (even[y + down, x + right, 0] + odd[y + down, x + right, 0])
                    d1 = (even[y, x, 1] + odd[y, x, 1]) - (even[y + down, x + right, 1] + odd[y + down, x + right, 1])
                    d2 = (even[y, x, 2] + odd[y, x, 2]) - (even[y + down, x + right, 2] + odd[y + down, x + right, 2])
                    red += d0 * d0
                    green += d1 * d1
                    blue += d2 * d2
            if n_pairs > 0:
                mean_square += (red + green + blue) / (3.0 * n_pairs)
        contrasts[block] = math.sqrt(mean_square) / n_samples


@kernel
def scale_sums(sums: NDArray[np.float64], chosen: NDArray[np.int64], factor: float) -> None:
    """Multiply the sums of some blocks.

    Parameters
    ----------
    sums : float64 (n, 2, 16, 16, 3)
        Changed.
    chosen : int64 (m,)
        Which blocks.
    factor
        By what.
    """
    for k in range(chosen.shape[0]):
        block = sums[chosen[k]]
        for half in range(2):
            for y in range(BLOCK_PX):
                for x in range(BLOCK_PX):
                    for channel in range(3):
                        block[half, y, x, channel] *= factor
