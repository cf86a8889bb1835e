"""Kernels of `tracer.accel.build`: the binned surface-area build of the two-way tree over shapes."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel.build import MAX_DEPTH
from tracer.jit import kernel

_BINS: Final = 16
_NODE_COST: Final = 1.0  # cost of a node (two boxes) and of a primitive, relative; measured on 4,511 and 80k triangles
_PRIMITIVE_COST: Final = 1.0


@kernel
def _half_area(low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Half of a box's surface area; 0 for an empty one."""
    x = high[0] - low[0]
    y = high[1] - low[1]
    z = high[2] - low[2]
    return x * y + y * z + z * x if x >= 0.0 else 0.0


@kernel
def _best_split(bounds: NDArray[np.float64], ids: NDArray[np.int32], first: int, end: int) -> tuple[float, int, float]:
    """Cheapest binned split of ``ids[first:end]``: cost (area x count, infinite if there is none), axis, plane."""
    best_cost = math.inf
    best_axis = -1
    best_plane = 0.0
    counts = np.empty(_BINS, np.int64)
    lows = np.empty((_BINS, 3))
    highs = np.empty((_BINS, 3))
    low = np.empty(3)
    high = np.empty(3)
    left_cost = np.empty(_BINS)
    for axis in range(3):
        # Twice the centroid is enough to compare, and exact halves of large numbers are not needed.
        c_low = math.inf
        c_high = -math.inf
        for k in range(first, end):
            c = 0.5 * bounds[ids[k], axis] + 0.5 * bounds[ids[k], 3 + axis]
            c_low = min(c_low, c)
            c_high = max(c_high, c)
        if not c_high > c_low:
            continue
        scale = _BINS / (c_high - c_low)
        if not scale < math.inf:
            continue
        # Fill the bins.
        counts[:] = 0
        lows[:] = math.inf
        highs[:] = -math.inf
        for k in range(first, end):
            c = 0.5 * bounds[ids[k], axis] + 0.5 * bounds[ids[k], 3 + axis]
            b = min(int((c - c_low) * scale), _BINS - 1)
            counts[b] += 1
            for j in range(3):
                lows[b, j] = min(lows[b, j], bounds[ids[k], j])
                highs[b, j] = max(highs[b, j], bounds[ids[k], 3 + j])
        # Sweep from the left, then from the right.
        low[:] = math.inf
        high[:] = -math.inf
        n = 0
        for b in range(_BINS - 1):
            n += counts[b]
            for j in range(3):
                low[j] = min(low[j], lows[b, j])
                high[j] = max(high[j], highs[b, j])
            left_cost[b] = n * _half_area(low, high)
        low[:] = math.inf
        high[:] = -math.inf
        n = 0
        for b in range(_BINS - 1, 0, -1):
            n += counts[b]
            for j in range(3):
                low[j] = min(low[j], lows[b, j])
                high[j] = max(high[j], highs[b, j])
            cost = left_cost[b - 1] + n * _half_area(low, high)
            if 0 < n < end - first and cost < best_cost:
                best_cost = cost
                best_axis = axis
                best_plane = c_low + b / scale
    return best_cost, best_axis, best_plane


@kernel
def _partition(
    bounds: NDArray[np.float64], ids: NDArray[np.int32], first: int, end: int, axis: int, plane: float
) -> int:
    """Put the primitives whose centroid is below the plane first; return where the others begin."""
    middle = first
    for k in range(first, end):
        c = 0.5 * bounds[ids[k], axis] + 0.5 * bounds[ids[k], 3 + axis]
        if c < plane:
            ids[k], ids[middle] = ids[middle], ids[k]
            middle += 1
    return middle


@kernel
def _sort_ascending(ids: NDArray[np.int32], first: int, end: int) -> None:
    """Sort the few ids of a leaf."""
    for k in range(first + 1, end):
        value = ids[k]
        j = k
        while j > first and ids[j - 1] > value:
            ids[j] = ids[j - 1]
            j -= 1
        ids[j] = value


@kernel
def build_tree(
    bounds: NDArray[np.float64],
    max_leaf: int,
    node_bounds: NDArray[np.float64],
    children: NDArray[np.int32],
    ids: NDArray[np.int32],
) -> tuple[int, int]:
    """Build over primitive bounds.

    Parameters
    ----------
    bounds : float64 (n, 6)
        Lower, then upper corners.
    max_leaf
        Most boxes of a leaf.
    node_bounds, children
        float64 (m, 12) and int32 (m, 4) with m = max(n, 1), rows of `tracer.types.CompiledScene`; written.
    ids : int32 (n,)
        Receives the primitive of each slot.

    Returns
    -------
    tuple of int
        Nodes, and the depth.
    """
    n = bounds.shape[0]
    for k in range(n):
        ids[k] = k
    n_nodes = 1
    depth_reached = 1
    # Pending ranges: the node that they make the children of, first, end, depth.
    pending = np.empty((2 * MAX_DEPTH + 8, 4), np.int64)
    pending[0, 0] = 0
    pending[0, 1] = 0
    pending[0, 2] = n
    pending[0, 3] = 1
    top = 1
    low = np.empty(3)
    high = np.empty(3)
    while top > 0:
        top -= 1
        node = pending[top, 0]
        first = pending[top, 1]
        end = pending[top, 2]
        depth = pending[top, 3]
        depth_reached = max(depth_reached, depth)
        # Split the node's range in two, unless there is nothing to split (the root of a scene with one primitive).
        middle = first
        if end - first > 1:
            levels = 0
            while (1 << levels) < end - first:
                levels += 1
            if depth + levels < MAX_DEPTH:
                _, axis, plane = _best_split(bounds, ids, first, end)
                if axis >= 0:
                    middle = _partition(bounds, ids, first, end, axis, plane)
            if middle <= first or middle >= end:
                middle = (first + end) // 2
        else:
            middle = end
        for child in range(2):
            begin = first if child == 0 else middle
            stop = middle if child == 0 else end
            count = stop - begin
            low[:] = math.inf
            high[:] = -math.inf
            for k in range(begin, stop):
                for j in range(3):
                    low[j] = min(low[j], bounds[ids[k], j])
                    high[j] = max(high[j], bounds[ids[k], 3 + j])
            for j in range(3):
                node_bounds[node, 4 * j + child] = low[j]
                node_bounds[node, 4 * j + 2 + child] = high[j]
            # Leave the range a leaf when it is small and splitting it would not pay.
            leaf = count <= 1
            if 1 < count <= max_leaf:
                cost, axis, _ = _best_split(bounds, ids, begin, stop)
                area = _half_area(low, high)
                leaf = axis < 0 or _NODE_COST * area + _PRIMITIVE_COST * cost >= _PRIMITIVE_COST * count * area
            if leaf:
                children[node, 2 * child] = begin
                children[node, 2 * child + 1] = count if count > 0 else -1
                _sort_ascending(ids, begin, stop)
            else:
                children[node, 2 * child] = n_nodes
                children[node, 2 * child + 1] = 0
                pending[top, 0] = n_nodes
                pending[top, 1] = begin
                pending[top, 2] = stop
                pending[top, 3] = depth + 1
                top += 1
                n_nodes += 1
    return n_nodes, depth_reached
