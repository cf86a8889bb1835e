"""How much of a tree a ray has to look at, whatever the order: what "slow" means where seconds cannot be asserted."""

import numpy as np

from tracer.accel import layout
from tracer.jit import kernel
from tracer.simd import address_of, load
from tracer.simd.gateway import types

_float32, _float64, _int32 = types.float32, types.float64, types.int32
_PAD = 2.0**-21  # what packets and single rays give to a box's float32 test, in frame units


@kernel
def _count(tree, origins, directions, counts):
    base = address_of(tree)
    scale = load(_float64, base + 8 * layout.FRAME_SCALE)
    stack = np.empty(layout.STACK_ENTRIES, np.int64)
    for i in range(origins.shape[0]):
        stack[0] = layout.HEADER_BYTES // layout.UNIT << 3
        top = 1
        while top > 0:
            top -= 1
            node = base + stack[top] * (layout.UNIT // 8)
            counts[i] += 1
            for k in range(layout.NODE_WIDTH):
                near, far = 0.0, np.inf
                for axis in range(3):
                    low = _float64(load(_float32, node + 32 * axis + 4 * k))
                    high = _float64(load(_float32, node + layout.NODE_HIGH + 32 * axis + 4 * k))
                    if low > high:
                        near, far = 1.0, 0.0
                    o = (origins[i, axis] - load(_float64, base + 8 * (layout.FRAME_CENTRE + axis))) * scale
                    d = directions[i, axis] * scale
                    a, b = low - _PAD - o, high + _PAD - o
                    if d == 0.0:
                        if a > 0.0 or b < 0.0:
                            far = -1.0
                    else:
                        near, far = max(near, min(a / d, b / d)), min(far, max(a / d, b / d))
                word = load(_int32, node + layout.NODE_CHILDREN + 4 * k)
                if near <= far:
                    if word < 0:
                        counts[i] += (word & 7) + 1
                    else:
                        stack[top] = word
                        top += 1


def count_visits(tree, origins, directions):
    """Nodes and triangles of a tree that each ray meets the boxes of, (n,)."""
    counts = np.zeros(len(origins), np.int64)
    _count(tree, np.ascontiguousarray(origins, np.float64), np.ascontiguousarray(directions, np.float64), counts)
    return counts
