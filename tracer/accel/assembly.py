"""From sorted records to the wide tree's buffer: its top, then its subtrees one after the other, by several threads.

Which of a subtree's nodes become wide is decided for it alone: its root is the root of a wide node, whatever stands
above. So the top can be planned and written first, and a subtree is built, planned and written while the cache holds
it, in memory that the next one uses again: fresh memory costs more than what is written to it.

Invariant: subtrees stand by their size, equally large ones as the top names them: so the buffer does not depend on the
threads.
"""

import threading
from collections import deque
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import layout
from tracer.accel.sorting import Mesh, Run, Sorted, empty_aligned
from tracer.native.entries import entry

_DIVIDED: Final = 8  # times as much as would be enough: groups beyond are divided further, which one thread does
_bound_records = entry("tracer.accel.binary.bound_records")
_build_binary = entry("tracer.accel.binary.build_binary")
_plan_nodes = entry("tracer.accel.collapse.plan_nodes")
_build_subtree = entry("tracer.accel.subtrees.build_subtree")
_emit_single_leaf = entry("tracer.accel.emit.emit_single_leaf")
_emit_node = entry("tracer.accel.emit.emit_node")
_emit_subtree = entry("tracer.accel.emit.emit_subtree")


class BvhError(ValueError):
    """The mesh cannot be built, or a saved tree cannot be read."""


class Assembled(NamedTuple):
    """A tree's buffer without its header."""

    buffer: NDArray[np.int64]
    n_nodes: int  # wide ones
    depth: int


class _Subtree(NamedTuple):
    """Records that are built on their own."""

    start: int
    end: int
    depth: int  # of its root in the binary tree
    level: int  # of its root in the wide tree, from 1
    word: int  # offset of the child word that names it; -1 for the root of all


def _divide(found: Sorted) -> tuple[list[tuple[int, int]], int]:
    """Finish the top's binary tree; returns (node, depth) of the subtrees' roots, and the number of nodes."""
    records, nodes, free, groups, enough = found
    words = nodes.view(np.int32)
    bounds = np.empty((2, 8), np.float32)
    pending = np.empty((len(records) // layout.SMALL + 1, 2), np.int64)
    roots = []
    for node, depth in groups:
        start, count = int(words[node, 3]), int(words[node, 7])
        if layout.SMALL < count <= _DIVIDED * enough:
            roots.append((node, depth))
            continue
        _bound_records(records, start, start + count, bounds)
        free, n_pending = _build_binary(records, nodes, node, depth, bounds[1], free, enough, pending)
        roots += [(int(root), int(level)) for root, level in pending[:n_pending]]
    return roots, free


class _Assembly:
    """A buffer that is being written.

    Parameters
    ----------
    mesh, found
        Of `tracer.accel.sorting.sort_mesh`.
    """

    def __init__(self, mesh: Mesh, found: Sorted) -> None:
        self.mesh, self.found = mesh, found
        self.value_bytes = 4 if mesh.narrow else 8
        # Room for a node and a leaf of its own a triangle, more than there can be. What is not written takes no memory.
        most = len(found.records) * (layout.NODE_BYTES + 64 + 16 * self.value_bytes) + 4096
        self.buffer = empty_aligned((min(most, layout.MAX_BYTES) // 8,), np.int64)
        self.words = self.buffer.view(np.int32)
        self.offset = layout.HEADER_BYTES
        self.n_nodes = 0
        self.depth = 1
        self.subtrees: list[_Subtree] = []
        self.lock = threading.Lock()
        self.n_begun = 0
        self.n_placed = 0
        self.built: dict[int, tuple[int, Any]] = {}  # size and scratch of those whose place is not known
        self.placed: deque[tuple[int, Any]] = deque()  # offset and scratch of those that can be written
        self.scratch: list[Any] = []

    def write_top(self) -> None:
        """Plan and write the wide nodes above the subtrees, and list these."""
        mesh, records, nodes = self.mesh, self.found.records, self.found.nodes
        roots, n_nodes = _divide(self.found)
        words = nodes.view(np.int32)
        costs, plan = empty_aligned((n_nodes, 8), np.float32), empty_aligned((n_nodes, 4), np.int32)
        extents = {node: (int(words[node, 3]), int(words[node, 7]), depth) for node, depth in roots}
        for node, (start, count, _) in extents.items():
            words[node, 7] = -count
            costs[node] = 0.0  # whatever it is, it is a part of all sums: no choice depends on it
            costs[node, 0] = np.inf
            plan[node] = count, start, 1 << 4, 0  # a wide node, whatever its children are
        wide = int(not mesh.narrow)
        count = len(records)
        if count:
            _plan_nodes(nodes, n_nodes, costs, plan)
        if count <= layout.LEAF_TRIANGLES and (count == 0 or plan[0, 2] & 0xF0 == 0):
            self.offset = _emit_single_leaf(
                nodes, records, count, mesh.vertices, mesh.faces, self.buffer, self.offset, wide
            )
            self.n_nodes = 1
            return
        inner = np.empty((layout.NODE_WIDTH, 2), np.int64)
        todo = [(0, -1, 1)]  # binary node, offset of its word, level
        tree = nodes, plan, records, mesh.vertices, mesh.faces
        while todo:
            node, word, level = todo.pop()
            if node in extents:
                start, count, depth = extents[node]
                self.subtrees.append(_Subtree(start, start + count, depth, level, word))
                continue
            self._link(word, self.offset)
            self.offset, n_inner = _emit_node(*tree, node, self.buffer, self.offset, wide, inner)
            self.n_nodes += 1
            self.depth = max(self.depth, level)
            todo += [(int(kid), int(place), level + 1) for kid, place in inner[:n_inner][::-1]]
        self.subtrees.sort(key=lambda subtree: subtree.start - subtree.end)  # no thread is left alone with a large one

    def _link(self, word: int, offset: int) -> None:
        """Write where a node is."""
        if word >= 0:
            self.words[word // 4] = offset // layout.UNIT << 3

    def _take_scratch(self) -> Any:
        """Return memory for a subtree; the lock is held."""
        if self.scratch:
            return self.scratch.pop()
        rows = 2 * max(subtree.end - subtree.start for subtree in self.subtrees) + 2
        floats = empty_aligned((rows, 20), np.float32).reshape(-1)  # in one piece: large ones come in large pages
        return (
            floats[: 8 * rows].reshape(rows, 8),
            floats[8 * rows : 16 * rows].reshape(rows, 8),
            floats[16 * rows :].view(np.int32).reshape(rows, 4),
        )

    def _place(self, i: int, measured: tuple[int, int, int], scratch: Any) -> None:
        """Note what a subtree takes, and give those a place of which all before them are known; the lock is held."""
        size, n_nodes, depth = measured
        self.n_nodes += n_nodes
        self.depth = max(self.depth, self.subtrees[i].level - 1 + depth)
        self.built[i] = size, scratch
        while self.n_placed in self.built:
            size, scratch = self.built.pop(self.n_placed)
            if self.offset + size + layout.PADDING > layout.MAX_BYTES:
                raise BvhError(f"the tree takes more than {layout.MAX_BYTES} bytes, which cannot be addressed")
            self._link(self.subtrees[self.n_placed].word, self.offset)
            self.placed.append((self.offset, scratch))
            self.offset += size
            self.n_placed += 1

    def work(self) -> None:
        """Build and write subtrees until none is left: what a thread does."""
        mesh, records = self.mesh, self.found.records
        wide = int(not mesh.narrow)
        while True:
            with self.lock:
                if self.placed:
                    offset, scratch = self.placed.popleft()
                elif self.n_begun < len(self.subtrees):
                    i, offset, scratch = self.n_begun, 0, self._take_scratch()
                    self.n_begun += 1
                else:
                    return  # who builds the last ones writes them
            nodes, costs, plan = scratch
            if offset:
                _emit_subtree(nodes, plan, records, mesh.vertices, mesh.faces, self.buffer, offset, wide)
                with self.lock:
                    self.scratch.append(scratch)
                continue
            start, end, depth = self.subtrees[i][:3]
            measured = _build_subtree(records, start, end, depth, nodes, costs, plan, self.value_bytes)
            with self.lock:
                self._place(i, measured, scratch)


def assemble(mesh: Mesh, found: Sorted, threads: int, run: Run) -> Assembled:
    """Build the tree.

    Parameters
    ----------
    mesh, found
        Of `tracer.accel.sorting.sort_mesh`; the records are reordered.
    threads
        How many there are.
    run
        `map` on them.

    Raises
    ------
    BvhError
        More than 8 GiB.
    """
    assembly = _Assembly(mesh, found)
    assembly.write_top()
    list(run(lambda _: assembly.work(), range(threads)))
    total = assembly.offset + layout.PADDING
    return Assembled(assembly.buffer[: total // 8], assembly.n_nodes, assembly.depth)
