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
# of a bounce that waits: origin, direction, throughput, sample, depth, material, skip; one to spare
COLUMNS: Final = 14
PENDING_BYTES: Final = 8 * COLUMNS
PENDING_DIRECTION: Final = 24
PENDING_THROUGHPUT: Final = 48
PENDING_SAMPLE: Final = 72
PENDING_DEPTH: Final = 80
PENDING_FROM: Final = 88
PENDING_SKIP: Final = 96
REFLECTED: Final = 0  # which of the two stacks of bounces
TRANSMITTED: Final = 1


class Scratch(NamedTuple):
    """Addresses (int64) of scratch memory and of what the traversal reads, but for `stack` and `counters`."""

    hits: int  # HIT_ROWS rows: rays and what they have met
    shadows: int  # RAY_ROWS rows: shadow rays
    radiance: int  # float64 (3, WAVE): RGB of the samples under way
    pending: int  # float64 (2, capacity, COLUMNS): bounces to trace, two stacks
    pending_step: int  # bytes from one stack to the other
    heights: int  # int64 (2,): bounces on each
    tree: int  # the triangles' tree
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
    return np.zeros(8 + rows + 3 * WAVE + 2 * COLUMNS * capacity(max_depth)), np.zeros(2 + MAX_DEPTH + 4, np.int64)
