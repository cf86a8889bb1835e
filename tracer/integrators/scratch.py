"""Memory that a kernel allocates once and every ray uses.

An allocation inside a ray costs half the speed.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel.build import MAX_DEPTH
from tracer.jit import inline, kernel
from tracer.rays.rows import PACKET, RAY_ROWS, ROW
from tracer.shading.rows import HIT_ROWS

WAVE: Final = 1024  # samples that are under way together
REFLECTED: Final = 0  # which of the two stacks of bounces
TRANSMITTED: Final = 1
# Rows of a stack: what is known of each bounce that waits.
PENDING_ORIGIN: Final = 0
PENDING_DIRECTION: Final = 3
PENDING_THROUGHPUT: Final = 6
PENDING_SAMPLE: Final = 9  # int64, as are the next two
PENDING_FROM: Final = 10
PENDING_SKIP: Final = 11
PENDING_ROWS: Final = 12


class Scratch(NamedTuple):
    """Addresses (int64) of scratch memory and of what the traversal reads, but for `stack` and `counters`."""

    hits: int  # HIT_ROWS rows: rays and what they have met
    shadows: int  # RAY_ROWS rows: shadow rays
    radiance: int  # float64 (3, WAVE): RGB of the samples under way
    pending: int  # float64 (2, PENDING_ROWS, capacity): bounces to trace, two stacks
    pending_row: int  # bytes from row to row
    heights: int  # int64 (2, max_depth + 2): bounces on each stack, by depth; column 0 counts them all
    heights_row: int  # bytes from one stack's to the other's
    trees: int  # the triangles' trees
    kt: int  # of the first material
    face_material: int
    stack: Any  # int64, flat: for the traversal of the shapes
    counters: Any  # int64 (len(COUNTERS),), flat


@inline
def capacity(max_depth: int) -> int:
    """Bounces that can wait on one stack: a wave's first ones, and one packet's of each depth beyond."""
    return WAVE + PACKET * (max_depth + 1)


@kernel
def allocate(max_depth: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Allocate all of it: float64 and int64. Rows start on a cache line."""
    rows = (HIT_ROWS + RAY_ROWS) * ROW // 8
    n = 8 + rows + 3 * WAVE + 2 * PENDING_ROWS * capacity(max_depth)
    return np.zeros(n), np.zeros(2 * (max_depth + 2) + MAX_DEPTH + 4, np.int64)
