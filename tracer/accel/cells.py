"""The top of a large mesh's binary tree, and its records sorted by what lies below: both by a grid of cells.

Splitting all records level by level reads and writes all of them at each of the first ten levels, from memory, and one
thread after the other. Instead their boxes are gathered by the cells of a grid in one pass over the faces
(`count_cells`), the tree's top is split between cells, which are few (`split_cells`), and a second pass writes every
record where its subtree begins (`sort_records`). Subtrees fit into the processor's cache.

Invariants: a cell's box and count, and so the top, do not depend on who counted what; the records of a subtree stand in
the faces' order. A node is split between cells only where it is at least `_NARROW` of them wide: below, planes between
cells would be too coarse, and the ordinary build takes over. Because a subtree's root is always a wide node of its own,
nothing large may hang on to a subtree of small triangles, or its box would be met for nothing: triangles longer than
`_LARGE` cells go into coarse cells that are groups by themselves, and what one more split would make less than
`_UNEVEN` as costly is split.

Source: grids for the top levels, Garanzha, Pantaleoni and McAllister 2011.
"""

from typing import Any, Final

import numpy as np

from tracer.accel.binary import RECORD_BYTES, centroid_of, half_area, sah_split
from tracer.accel.records import LAST_BYTES, copy_last, frame_lanes, is_usable, record_of, store_record
from tracer.jit import inline, kernel
from tracer.simd import (
    address_of,
    convert,
    extract,
    float32x8,
    lesser_finite,
    load,
    lower_half,
    maximum,
    minimum,
    splat,
    stack_memory,
    store,
    upper_half,
)
from tracer.simd.gateway import types

_int32: Final = types.int32
_int64: Final = types.int64
_INF: Final = float("inf")

MAX_BITS: Final = 5
_COARSE_BITS: Final = 3
COARSE_CELLS: Final = 1 << 3 * _COARSE_BITS
_LARGE: Final = 4  # cells: longer triangles are kept apart,
_APART: Final = 256  # unless they lie in so many coarse cells
_SIDE: Final = 1 << MAX_BITS  # cells along an axis, at most
_ROW: Final = _SIDE * RECORD_BYTES
_BINS_BYTES: Final = 3 * _ROW
_COUNTS_BYTES: Final = 3 * _SIDE * 4
_COSTS_BYTES: Final = _SIDE * 4
_NARROW: Final = 8
_LEVELS: Final = 24
_UNEVEN: Final = 0.5  # cost of both sides, of the whole; about 0.6 where a piece of a surface is halved
_TASK_BYTES: Final = 32
_STACK_BYTES: Final = (_LEVELS + 4) * _TASK_BYTES


@inline
def _cell_of(record: Any, origin: Any, rate: Any, bits: int) -> Any:
    """Return the number of the cell of a record's centroid: a coarse one's, behind the others, if it is large."""
    side = splat(float32x8, np.float32((1 << bits) - 1))
    place = (centroid_of(record) - origin) * rate
    k = convert(_int32, minimum(maximum(place, splat(float32x8, 0.0)), side))
    x, y, z = _int64(extract(k, 0)), _int64(extract(k, 1)), _int64(extract(k, 2))
    extent = -(lower_half(record) + upper_half(record)) * lower_half(rate)
    widest = max(extract(extent, 0), extract(extent, 1), extract(extent, 2))
    if widest > np.float32(0.5 * _LARGE):  # rates are those of twice the place
        shift = bits - _COARSE_BITS
        return (1 << 3 * bits) + (x >> shift | y >> shift << _COARSE_BITS | z >> shift << 2 * _COARSE_BITS)
    return x | y << bits | z << 2 * bits


@kernel
def count_cells(
    vertices: Any,
    faces: Any,
    start: int,
    end: int,
    check: int,
    frame: Any,
    grid: Any,
    bits: int,
    boxes: Any,
    counts: Any,
) -> None:
    """Bound and count what lies in each cell.

    Parameters
    ----------
    vertices, faces, check, frame
        As for :func:`tracer.accel.records.make_records`.
    start, end
        Which faces.
    grid
        float32 (2, 8): twice the grid's low corner in the frame, and cells for each unit of twice the centroid.
    bits
        There are ``1 << bits`` cells along an axis.
    boxes, counts
        float32 (cells, 8) and int32 (cells,), written.
    """
    last = stack_memory(LAST_BYTES)
    copy_last(vertices, last)
    centre, scale = frame_lanes(frame)
    origin, rate = load(float32x8, address_of(grid)), load(float32x8, address_of(grid) + RECORD_BYTES)
    box_base, count_base = address_of(boxes), address_of(counts)
    for cell in range((1 << 3 * bits) + COARSE_CELLS):
        store(box_base + cell * RECORD_BYTES, splat(float32x8, _INF))
        store(count_base + 4 * cell, _int32(0))
    for i in range(start, end):
        a, b, c = _int64(faces[i, 0]), _int64(faces[i, 1]), _int64(faces[i, 2])
        if check and not (is_usable(vertices, a) and is_usable(vertices, b) and is_usable(vertices, c)):
            continue
        record = record_of(vertices, a, b, c, last, centre, scale)
        cell = _cell_of(record, origin, rate, bits)
        box = box_base + cell * RECORD_BYTES
        store(box, lesser_finite(load(float32x8, box), record))
        store(count_base + 4 * cell, _int32(load(_int32, count_base + 4 * cell) + _int32(1)))


@kernel
def sort_records(
    vertices: Any,
    faces: Any,
    start: int,
    end: int,
    check: int,
    frame: Any,
    grid: Any,
    bits: int,
    group_of: Any,
    rows: Any,
    records: Any,
) -> None:
    """Write the records of faces start..end, each where its group's next one goes.

    Parameters
    ----------
    vertices, faces, start, end, check, frame, grid, bits
        As for :func:`count_cells`.
    group_of
        int32 (cells,).
    rows
        int64 (groups,): the row of each one's next record; moved on.
    records
        float32 (n, 8), written.
    """
    last = stack_memory(LAST_BYTES)
    copy_last(vertices, last)
    centre, scale = frame_lanes(frame)
    origin, rate = load(float32x8, address_of(grid)), load(float32x8, address_of(grid) + RECORD_BYTES)
    group_base, row_base, record_base = address_of(group_of), address_of(rows), address_of(records)
    for i in range(start, end):
        a, b, c = _int64(faces[i, 0]), _int64(faces[i, 1]), _int64(faces[i, 2])
        if check and not (is_usable(vertices, a) and is_usable(vertices, b) and is_usable(vertices, c)):
            continue
        record = record_of(vertices, a, b, c, last, centre, scale)
        group = load(_int32, group_base + 4 * _cell_of(record, origin, rate, bits))
        place = row_base + 8 * _int64(group)
        row = load(_int64, place)
        store(place, row + 1)
        store_record(record_base + row * RECORD_BYTES, record, i)


@inline
def _coordinate(macro: int, axis: int, bits: int) -> Any:
    """Which cell along an axis; the first one that a coarse cell covers."""
    cell = _int64(load(_int32, macro + 12))
    fine = 1 << 3 * bits
    if cell >= fine:
        return (cell - fine >> axis * _COARSE_BITS & ((1 << _COARSE_BITS) - 1)) << bits - _COARSE_BITS
    return cell >> axis * bits & ((1 << bits) - 1)


@inline
def _gather_macros(boxes: int, counts: Any, macros: int, fine: int) -> Any:
    """Write a record for each cell that is not empty: its box, its number (word 3) and its count (word 7).

    Returns how many, and how many of them are not coarse.
    """
    n = _int64(0)
    n_fine = _int64(0)
    n_cells = counts.shape[1]
    for cell in range(n_cells):
        total = 0
        box = splat(float32x8, _INF)
        for k in range(counts.shape[0]):
            if counts[k, cell] > 0:
                total += counts[k, cell]
                box = minimum(box, load(float32x8, boxes + (k * n_cells + cell) * RECORD_BYTES))
        if total > 0:
            row = macros + n * RECORD_BYTES
            store(row, box + splat(float32x8, 0.0))  # no -0, which would tell who counted what
            store(row + 12, _int32(cell))
            store(row + 28, _int32(total))
            n += 1
            n_fine += 1 if cell < fine else 0
    return n, n_fine


@inline
def _store_group(macros: int, first: int, end: int, groups: Any, number: int, n_records: int, group_of: Any) -> Any:
    """Make a group of some macros; returns the records of all groups so far."""
    box = splat(float32x8, _INF)
    total = _int64(0)
    for i in range(first, end):
        macro = macros + i * RECORD_BYTES
        box = minimum(box, load(float32x8, macro))
        total += _int64(load(_int32, macro + 28))
        group_of[load(_int32, macro + 12)] = number
    row = address_of(groups) + number * RECORD_BYTES
    store(row, box)
    store(row + 12, _int32(n_records))
    store(row + 28, _int32(total))
    return n_records + total


@kernel
def split_cells(boxes: Any, counts: Any, bits: int, enough: int, macros: Any, groups: Any, group_of: Any) -> int:
    """Split between cells until what is left has few records or is few cells wide: groups of records.

    Parameters
    ----------
    boxes, counts
        float32 (k cells, 8) and int32 (k, cells) of k calls of :func:`count_cells`.
    bits
        As for :func:`count_cells`.
    enough
        So many records are not split further here, unless that pays as it does where large triangles hang on.
    macros
        float32 (cells, 8), for scratch.
    groups
        float32 (cells, 8), receives a binary node for each group: the first record's row counts the groups before.
    group_of
        int32 (cells,), receives the group of each cell that is not empty.

    Returns
    -------
    int
        How many groups.
    """
    macro_base = address_of(macros)
    bins = stack_memory(_BINS_BYTES)
    numbers = stack_memory(_COUNTS_BYTES)
    costs = stack_memory(_COSTS_BYTES)
    stack = stack_memory(_STACK_BYTES)
    infinite = splat(float32x8, _INF)
    n_macros, n_fine = _gather_macros(address_of(boxes), counts, macro_base, 1 << 3 * bits)
    n_together = n_fine if n_macros - n_fine <= _APART else n_macros
    n_groups = _int64(0)
    n_records = _int64(0)
    for i in range(n_together, n_macros):
        n_records = _store_group(macro_base, i, i + 1, groups, n_groups, n_records, group_of)
        n_groups += 1
    store(stack, _int64(0))
    store(stack + 8, _int64(0))
    store(stack + 16, n_together)
    top = stack + _TASK_BYTES if n_together > 0 else stack
    while top > stack:
        top -= _TASK_BYTES
        level, first, end = load(_int64, top), load(_int64, top + 8), load(_int64, top + 16)
        box = infinite
        total = _int64(0)
        for i in range(first, end):
            macro = macro_base + i * RECORD_BYTES
            box = minimum(box, load(float32x8, macro))
            total += _int64(load(_int32, macro + 28))
        widest = _int64(0)
        corner = _int64(0)
        for axis in range(3):
            low, high = _int64(1 << bits), _int64(-1)
            for i in range(first, end):
                k = _coordinate(macro_base + i * RECORD_BYTES, axis, bits)
                low, high = min(low, k), max(high, k)
            widest = max(widest, high - low + 1)
            corner |= low << 8 * axis
        split_axis, plane = -1, 0
        if widest > 1 and level < _LEVELS:
            for k in range(3 * _SIDE):
                store(bins + k * RECORD_BYTES, infinite)
                store(numbers + 4 * k, _int32(0))
            for i in range(first, end):
                macro = macro_base + i * RECORD_BYTES
                for axis in range(3):
                    k = axis * _SIDE + _coordinate(macro, axis, bits) - (corner >> 8 * axis & 255)
                    slot = bins + k * RECORD_BYTES
                    store(slot, lesser_finite(load(float32x8, slot), load(float32x8, macro)))
                    store(numbers + 4 * k, _int32(load(_int32, numbers + 4 * k) + load(_int32, macro + 28)))
            split_axis, plane, cost = sah_split(bins, numbers, costs, 3, _SIDE, _SIDE)
            uneven = cost < np.float32(_UNEVEN) * half_area(box) * np.float32(total)
            if not uneven and (total <= enough or widest < _NARROW):
                split_axis = -1
        if split_axis < 0:
            n_records = _store_group(macro_base, first, end, groups, n_groups, n_records, group_of)
            n_groups += 1
            continue
        plane += corner >> 8 * split_axis & 255
        middle = first
        for i in range(first, end):
            macro, place = macro_base + i * RECORD_BYTES, macro_base + middle * RECORD_BYTES
            goes_left = _coordinate(macro, split_axis, bits) < plane
            here, there = load(float32x8, macro), load(float32x8, place)
            store(macro, there)
            store(place, here)
            middle += 1 if goes_left else 0
        for side in range(2):  # the left one is on top
            store(top, level + 1)
            store(top + 8, first if side else middle)
            store(top + 16, middle if side else end)
            top += _TASK_BYTES
    return int(n_groups)
