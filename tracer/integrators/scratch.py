"""Memory that a kernel allocates once and every ray uses.

An allocation inside a ray costs half the speed.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from tracer.accel.build import MAX_DEPTH
from tracer.jit import inline, pointer

STACK_ENTRIES: Final = MAX_DEPTH + 4
PENDING_COLUMNS: Final = 12  # a bounce that waits: origin 0..2, direction 3..5, throughput 6..8, depth, material, skip
PENDING_DEPTH: Final = 9
PENDING_MATERIAL: Final = 10
PENDING_SKIP: Final = 11


class Scratch(NamedTuple):
    """Flat pointers."""

    stack: Any  # int64 (STACK_ENTRIES,) packed nodes of the traversal
    stack_t: Any  # float64 (STACK_ENTRIES,) where each begins
    pending: Any  # float64 (pending_entries, PENDING_COLUMNS) bounces to trace
    occluders: Any  # int64 (n_lights,) slot of the triangle that ended each light's last shadow ray, -1 for none
    counters: Any  # int64 (len(COUNTERS),)


@inline
def pending_entries(max_depth: int) -> int:
    """Bounces that can wait at once: two children at the last depth, one sibling at each depth above, one to spare."""
    return max_depth + 3


@inline
def make_scratch(stack: Any, stack_t: Any, pending: Any, occluders: Any, counters: Any) -> Scratch:
    """View arrays (which the caller keeps alive) as scratch memory."""
    return Scratch(pointer(stack), pointer(stack_t), pointer(pending), pointer(occluders), pointer(counters))


@inline
def allocate(max_depth: int, n_lights: int) -> tuple[Any, Any, Any, Any]:
    """Allocate stack, stack_t, pending and occluders."""
    return (
        np.empty(STACK_ENTRIES, np.int64),
        np.empty(STACK_ENTRIES, np.float64),
        np.empty((pending_entries(max_depth), PENDING_COLUMNS), np.float64),
        np.full(max(n_lights, 1), -1, np.int64),
    )
