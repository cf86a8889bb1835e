"""Binned-SAH build of the binary tree that the wide tree is collapsed from.

A primitive is a record of 8 float32, ``(lo.x, lo.y, lo.z, id, -hi.x, -hi.y, -hi.z, 0)``: the union of two boxes is one
lane-wise minimum. A node is the same 32 bytes; its word 3 holds the first child (of an inner node) or the first
record (of a leaf), its word 7 the number of records (0 for an inner node).

Invariants: children have higher indices than their parent and stand side by side; every inner node's records are
contiguous; the depth is at most `MAX_DEPTH` - 1, because a node whose depth plus log2(count) reaches it is split in
the middle from there on. The tree depends on the records' order alone, never on the number of threads.

Three or four records are split in the best of all ways, without bins. More are put into bins along the two longest axes
of their centroids' box: leaving out the third changes the tree's cost by less than half a percent.

Source: Wald 2007 (binning); the branch-free partition (Lomuto's, with the children's bounds fused in) is 1.3-2.4 times
as fast as Hoare's.
"""

from typing import Any, Final

import numpy as np

from tracer.accel.layout import MAX_DEPTH, SMALL, STOP
from tracer.jit import inline, kernel
from tracer.simd import (
    address_of,
    concatenate,
    convert,
    extract,
    float32x8,
    int32x8,
    iota,
    lesser_finite,
    load,
    lower_half,
    mask_to_bits,
    minimum,
    permute,
    select,
    splat,
    stack_memory,
    store,
    upper_half,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_int32: Final = types.int32
_int64: Final = types.int64

RECORD_BYTES: Final = 32
_BINS: Final = 16
_ROW: Final = _BINS * RECORD_BYTES
_AXES: Final = 2  # binned, the longest: the third hardly ever has the best plane
_ALL_BINS_BYTES: Final = _AXES * _ROW
_COUNTS_BYTES: Final = _AXES * _BINS * 4
_COSTS_BYTES: Final = _BINS * 4
# depth-first with the larger child postponed: at most log2(n) entries wait
_TASK_BYTES: Final = 64  # node, depth, centroid bounds
_STACK_BYTES: Final = 96 * _TASK_BYTES
_INF: Final = float("inf")
_FEW: Final = 4  # records of which all splits are tried


@inline
def _swapped(record: Any) -> Any:
    return concatenate(upper_half(record), lower_half(record))


@inline
def centroid_of(record: Any) -> Any:
    """(lo + hi, -(lo + hi)): twice the centroid and its negative, so that minima bound it on both sides."""
    return record - _swapped(record)


@inline
def half_area(record: Any) -> Any:
    """Half the area of a box: x y + y z + z x of its extents."""
    extent = -(lower_half(record) + upper_half(record))
    x = extract(extent, 0)
    y = extract(extent, 1)
    z = extract(extent, 2)
    return x * (y + z) + y * z


@inline
def _bin_of(centroid: Any, origin: Any, scale: Any) -> Any:
    return convert(_int32, (centroid - origin) * scale)


@inline
def sah_split(bins: int, counts: int, costs: int, n_axes: int, n_bins: int, room: int) -> Any:
    """Find (axis, first bin of the right side, cost) of least area times count; axis -1 when no plane separates any.

    ``bins`` and ``counts`` have a row with room for so many bins for each axis; ``costs`` is one of scratch. Choices
    are written so that no branch hangs on them: it would be foretold wrongly every other time.
    """
    infinite = splat(float32x8, _INF)
    none = np.float32(_INF)
    best = none
    best_axis = -1
    best_bin = 0
    for axis in range(n_axes):
        row = bins + axis * room * RECORD_BYTES
        numbers = counts + axis * room * 4
        box = infinite
        count = np.int32(0)
        for k in range(n_bins - 1, 0, -1):
            box = minimum(box, load(float32x8, row + k * RECORD_BYTES))
            count += load(_int32, numbers + k * 4)
            area = half_area(box) * np.float32(count)
            store(costs + k * 4, area if count > 0 else none)
        box = infinite
        count = np.int32(0)
        for k in range(1, n_bins):
            box = minimum(box, load(float32x8, row + (k - 1) * RECORD_BYTES))
            count += load(_int32, numbers + (k - 1) * 4)
            area = half_area(box) * np.float32(count)
            cost = (area if count > 0 else none) + load(_float32, costs + k * 4)
            better = cost < best
            best_axis = axis if better else best_axis
            best_bin = k if better else best_bin
            best = cost if better else best
    return best_axis, best_bin, best


@inline
def _log2_ceil(count: int) -> int:
    bits = 0
    while (1 << bits) < count:
        bits += 1
    return bits


@kernel
def bound_records(records: Any, start: int, end: int, bounds: Any) -> None:
    """Write the box and the centroids' box of records start..end into ``bounds`` (2, 8)."""
    base = address_of(records)
    box = splat(float32x8, _INF)
    centroids = box
    for i in range(start, end):
        record = load(float32x8, base + i * RECORD_BYTES)
        box = minimum(box, record)
        centroids = minimum(centroids, centroid_of(record))
    store(address_of(bounds), box)
    store(address_of(bounds) + RECORD_BYTES, centroids)


@inline
def _divide_few(records: int, count: int, spare: int) -> int:
    """Put three or four records into the order in which they are split best; returns how many go to the left.

    All ways are tried, the last record on the right: what bins would miss matters most where most nodes are.
    """
    infinite = splat(float32x8, _INF)
    last = load(float32x8, records + (count - 1) * RECORD_BYTES)
    best = np.float32(_INF)
    best_set = 1
    for chosen in range(1, 1 << (count - 1)):
        left, right = infinite, last
        n_left = 0
        for k in range(count - 1):
            record = load(float32x8, records + k * RECORD_BYTES)
            if chosen >> k & 1:
                left = minimum(left, record)
                n_left += 1
            else:
                right = minimum(right, record)
        cost = half_area(left) * np.float32(n_left) + half_area(right) * np.float32(count - n_left)
        if cost < best:
            best = cost
            best_set = chosen
    n_left = 0
    for k in range(count):
        store(spare + k * RECORD_BYTES, load(float32x8, records + k * RECORD_BYTES))
        n_left += best_set >> k & 1
    to_left, to_right = records, records + n_left * RECORD_BYTES
    for k in range(count):
        record = load(float32x8, spare + k * RECORD_BYTES)
        goes_left = best_set >> k & 1
        store(to_left if goes_left else to_right, record)
        to_left += goes_left * RECORD_BYTES
        to_right += (1 - goes_left) * RECORD_BYTES
    return n_left


@inline
def _longest_two(extent: Any) -> Any:
    """Return the two axes of greatest extent, in lanes 0 and 1."""
    x, y, z = extract(extent, 0), extract(extent, 1), extract(extent, 2)
    least = np.int32(0) if x <= y and x <= z else (np.int32(1) if y <= z else np.int32(2))
    lanes = iota(int32x8) + splat(int32x8, least + np.int32(1))
    return select(lanes > splat(int32x8, 2), lanes - splat(int32x8, 3), lanes)


@inline
def _count_in(address: int, bounds: Any, scale: Any, order: Any, bins: int, counts: int) -> None:
    """Put a record into its bins, one along each of the two axes."""
    record = load(float32x8, address)
    numbers = permute(_bin_of(centroid_of(record), bounds, scale), order)
    for axis in range(_AXES):
        number = _int64(extract(numbers, axis))
        slot = bins + axis * _ROW + number * RECORD_BYTES
        store(slot, lesser_finite(load(float32x8, slot), record))
        counter = counts + (axis * _BINS + number) * 4
        store(counter, np.int32(load(_int32, counter) + np.int32(1)))


@kernel
def build_binary(
    records: Any, nodes: Any, root: int, depth: int, centroids: Any, first_free: int, stop: int, pending: Any
) -> Any:
    """Split a node and what comes of it.

    Parameters
    ----------
    records
        float32 (n, 8), reordered in place.
    nodes
        float32 (m, 8); ``nodes[root]`` holds a box, its first record (word 3) and its count (word 7).
    root, depth
        The node to start at, and its depth.
    centroids
        float32 (8,), bounds of the root's centroids.
    first_free
        Index of the first free node; 2 count nodes from there are this call's.
    stop
        Nodes of at most so many records, but more than `SMALL`, are left for a later call.
    pending
        int64 (k, 2): receives (node, depth) of those that were left; there are fewer than n / `SMALL`.

    Returns
    -------
    tuple of int
        (first free node, number of pending rows).
    """
    record_base = address_of(records)
    node_base = address_of(nodes)
    pending_base = address_of(pending)
    infinite = splat(float32x8, _INF)
    zero = splat(float32x8, 0.0)
    bins = stack_memory(_ALL_BINS_BYTES)
    counts = stack_memory(_COUNTS_BYTES)
    costs = stack_memory(_COSTS_BYTES)
    stack = stack_memory(_STACK_BYTES)
    n_pending = 0
    free = first_free
    store(stack, _int64(root))
    store(stack + 8, _int64(depth))
    store(stack + 32, load(float32x8, address_of(centroids)))
    top = stack + _TASK_BYTES
    while top > stack:
        top -= _TASK_BYTES
        index = load(_int64, top)
        level = load(_int64, top + 8)
        bounds = load(float32x8, top + 32)
        node = node_base + index * RECORD_BYTES
        start = _int64(load(_int32, node + 12))
        count = _int64(load(_int32, node + 28))
        if count <= STOP:
            continue
        if SMALL < count <= stop:
            store(pending_base + n_pending * 16, _int64(index))
            store(pending_base + n_pending * 16 + 8, _int64(level))
            n_pending += 1
            continue
        extent = zero
        scale = zero
        split_axis, split_bin = -1, 0
        middle = start + count // 2
        if level + _log2_ceil(count) >= MAX_DEPTH - 1:
            pass  # from here on by halves, so that the depth stays bounded
        elif count <= _FEW:
            middle = start + _divide_few(record_base + start * RECORD_BYTES, count, bins)
        else:
            extent = -_swapped(bounds) - bounds
            order = _longest_two(extent)
            n_bins = _BINS if count > 256 else (8 if count > 16 else 4)
            # just below n_bins, so that the upmost centroid falls into the last bin
            scale = select(extent > zero, splat(float32x8, np.float32(n_bins) * np.float32(0.9999)) / extent, zero)
            for axis in range(_AXES):
                for k in range(n_bins):
                    store(bins + axis * _ROW + k * RECORD_BYTES, infinite)
                    store(counts + (axis * _BINS + k) * 4, np.int32(0))
            # four at a time, from far apart: neighbours fall into one bin, and each would wait for the one before
            quarter = count >> 2
            for i in range(start, start + quarter):
                for k in range(4):
                    _count_in(record_base + (i + k * quarter) * RECORD_BYTES, bounds, scale, order, bins, counts)
            for i in range(start + 4 * quarter, start + count):
                _count_in(record_base + i * RECORD_BYTES, bounds, scale, order, bins, counts)
            row, split_bin, _ = sah_split(bins, counts, costs, _AXES, n_bins, _BINS)
            split_axis = -1 if row < 0 else _int64(extract(order, 0) if row == 0 else extract(order, 1))
        left, right, left_centroids, right_centroids = infinite, infinite, infinite, infinite
        if split_axis < 0:
            for i in range(start, middle):
                record = load(float32x8, record_base + i * RECORD_BYTES)
                left = minimum(left, record)
                left_centroids = minimum(left_centroids, centroid_of(record))
            for i in range(middle, start + count):
                record = load(float32x8, record_base + i * RECORD_BYTES)
                right = minimum(right, record)
                right_centroids = minimum(right_centroids, centroid_of(record))
        else:
            middle = start
            axis = splat(int32x8, split_axis)
            axis_bounds = permute(bounds, axis)
            axis_scale = permute(scale, axis)
            first_right = splat(int32x8, split_bin)
            for i in range(start, start + count):
                here = record_base + i * RECORD_BYTES
                there = record_base + middle * RECORD_BYTES
                record = load(float32x8, here)
                centroid = centroid_of(record)
                mask = _bin_of(permute(centroid, axis), axis_bounds, axis_scale) < first_right  # the same in all lanes
                goes_left = mask_to_bits(mask) & 1
                left = minimum(left, select(mask, record, infinite))
                left_centroids = minimum(left_centroids, select(mask, centroid, infinite))
                right = minimum(right, select(mask, infinite, record))
                right_centroids = minimum(right_centroids, select(mask, infinite, centroid))
                store(here, load(float32x8, there))
                store(there, record)
                middle += goes_left
        child = node_base + free * RECORD_BYTES
        store(child, left)
        store(child + 12, np.int32(start))
        store(child + 28, np.int32(middle - start))
        store(child + 32, right)
        store(child + 44, np.int32(middle))
        store(child + 60, np.int32(start + count - middle))
        store(node + 12, np.int32(free))
        store(node + 28, np.int32(0))
        # the larger side waits, so that the stack stays below log2(n) entries
        swap = _int64(middle - start < start + count - middle)
        store(top + swap * _TASK_BYTES, _int64(free))
        store(top + swap * _TASK_BYTES + 8, _int64(level + 1))
        store(top + swap * _TASK_BYTES + 32, left_centroids)
        store(top + (1 - swap) * _TASK_BYTES, _int64(free + 1))
        store(top + (1 - swap) * _TASK_BYTES + 8, _int64(level + 1))
        store(top + (1 - swap) * _TASK_BYTES + 32, right_centroids)
        top += 2 * _TASK_BYTES
        free += 2
    return free, n_pending
