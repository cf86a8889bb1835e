"""The top of the binary tree over groups of records, bottom-up: again and again the two of least common box are joined.

Groups are a few hundred, so all pairs can be asked; large triangles, which are groups of their own, end up side by side
with all else instead of around it.

Invariant: the result depends on the groups' order alone, and is at most `_DEPTH` deep: where the tree would be deeper,
neighbours in the groups' order are joined pair by pair.

Source: Walter, Bala, Kulkarni and Pingali 2008 (agglomerative clustering).
"""

from typing import Any, Final

import numpy as np

from tracer.accel.binary import RECORD_BYTES, half_area
from tracer.jit import inline, kernel
from tracer.simd import address_of, float32x8, load, minimum, store
from tracer.simd.gateway import types

_int32: Final = types.int32
_INF: Final = float("inf")
_DEPTH: Final = 28  # MAX_DEPTH less what 2**31 records need below


@inline
def _join(clusters: int, a: int, b: int) -> Any:
    """Return the common box."""
    return minimum(load(float32x8, clusters + a * RECORD_BYTES), load(float32x8, clusters + b * RECORD_BYTES))


@kernel
def _find_nearest(clusters: Any, active: Any, n: int, i: int, nearest: Any, areas: Any) -> None:
    """Write which other active cluster shares the least box with the i-th, and its area."""
    best = np.float32(_INF)
    which = -1
    for j in range(n):
        if j != i:
            area = half_area(_join(address_of(clusters), active[i], active[j]))
            if area < best:
                best = area
                which = j
    nearest[i], areas[i] = which, best


@kernel
def _join_nearest(n_groups: int, clusters: Any, kids: Any) -> None:
    """Join the two of least common box until one is left, the last row."""
    active, nearest = np.arange(n_groups), np.empty(n_groups, np.int64)
    areas = np.empty(n_groups, np.float32)
    for i in range(n_groups):
        _find_nearest(clusters, active, n_groups, i, nearest, areas)
    n = n_groups
    for made in range(n_groups, 2 * n_groups - 1):
        i = 0
        for k in range(1, n):
            if areas[k] < areas[i]:
                i = k
        j = nearest[i]
        i, j = min(i, j), max(i, j)
        kids[made, 0], kids[made, 1] = active[i], active[j]
        store(address_of(clusters) + made * RECORD_BYTES, _join(address_of(clusters), active[i], active[j]))
        active[i] = made
        n -= 1
        active[j], nearest[j], areas[j] = active[n], nearest[n], areas[n]  # the last one fills the gap
        for k in range(n):
            if k == i or nearest[k] == i or nearest[k] == j:
                _find_nearest(clusters, active, n, k, nearest, areas)
            elif nearest[k] == n:
                nearest[k] = j


@kernel
def _join_neighbours(n_groups: int, clusters: Any, kids: Any) -> None:
    """Join pair by pair, level by level; the last row is the root."""
    made = n_groups
    below = 0
    while made < 2 * n_groups - 1:
        kids[made, 0], kids[made, 1] = below, below + 1
        store(address_of(clusters) + made * RECORD_BYTES, _join(address_of(clusters), below, below + 1))
        below += 2
        made += 1


@kernel
def _write_nodes(groups: Any, clusters: Any, kids: Any, nodes: Any, depths: Any) -> int:
    """Write the joined tree as binary nodes; returns its depth."""
    n_groups = groups.shape[0]
    node_base = address_of(nodes)
    which = np.empty(2 * n_groups, np.int64)
    which[0] = 2 * n_groups - 2
    depths[0] = 0
    deepest = 0
    free = 1
    for index in range(2 * n_groups - 1):
        node = node_base + index * RECORD_BYTES
        cluster = which[index]
        deepest = max(deepest, depths[index])
        if cluster < n_groups:
            store(node, load(float32x8, address_of(groups) + cluster * RECORD_BYTES))
            continue
        store(node, load(float32x8, address_of(clusters) + cluster * RECORD_BYTES))
        store(node + 12, _int32(free))
        store(node + 28, _int32(0))
        for side in range(2):
            which[free + side] = kids[cluster, side]
            depths[free + side] = depths[index] + 1
        free += 2
    return int(deepest)


@kernel
def join_groups(groups: Any, clusters: Any, kids: Any, nodes: Any, depths: Any) -> int:
    """Build the binary nodes above groups of records.

    Parameters
    ----------
    groups
        float32 (n, 8), a binary node for each, of `tracer.accel.cells.split_cells`.
    clusters, kids
        float32 (2 n, 8) and int64 (2 n, 2), for scratch.
    nodes
        float32 (m, 8), m >= 2 n - 1: receives the nodes from the root on; nodes with a count are the groups.
    depths
        int64 (2 n,), receives the nodes' depths.

    Returns
    -------
    int
        How many nodes: 2 n - 1.
    """
    n_groups = groups.shape[0]
    for i in range(n_groups):
        store(address_of(clusters) + i * RECORD_BYTES, load(float32x8, address_of(groups) + i * RECORD_BYTES))
    _join_nearest(n_groups, clusters, kids)
    if _write_nodes(groups, clusters, kids, nodes, depths) > _DEPTH:
        _join_neighbours(n_groups, clusters, kids)
        _write_nodes(groups, clusters, kids, nodes, depths)
    return int(2 * n_groups - 1)
