"""From a mesh to records in the order of subtrees, and the binary nodes above these: the Python side of `cells`.

Invariant: what comes out does not depend on the number of threads.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.native.entries import entry

LARGE: Final = 20_000  # triangles from which on there is more than one subtree
_MANY: Final = 2**19  # triangles from which on the grid is a fine one
_SUBTREES: Final = 64  # of a large mesh, about
_COARSE_CELLS: Final = 512  # `tracer.accel.cells.COARSE_CELLS`; that module needs a compiler
_IN_CACHE: Final = 16384  # records of the grid's groups, mostly

Run = Callable[..., Iterable[Any]]

_survey_vertices = entry("tracer.accel.records.survey_vertices")
_survey_faces = entry("tracer.accel.records.survey_faces")
_make_records = entry("tracer.accel.records.make_records")
_bound_records = entry("tracer.accel.binary.bound_records")
_count_cells = entry("tracer.accel.cells.count_cells")
_split_cells = entry("tracer.accel.cells.split_cells")
_join_groups = entry("tracer.accel.clusters.join_groups")
_sort_records = entry("tracer.accel.cells.sort_records")


class Mesh(NamedTuple):
    """A mesh as kernels take it, and what has been found out about it."""

    vertices: NDArray[Any]  # (nv, 3) float32 or float64
    faces: NDArray[Any]  # (nf, 3) integers
    n_usable: int  # faces that rays can meet
    narrow: bool  # whether float32 holds all usable coordinates
    frame: NDArray[np.float64]  # (4,) centre, scale


class Sorted(NamedTuple):
    """Records, group by group, and the binary nodes down to the groups'."""

    records: NDArray[np.float32]  # (n, 8), tracer.accel.binary
    nodes: NDArray[np.float32]  # (2 n, 8), the first n_nodes are written; a group is a node with a count
    n_nodes: int
    groups: list[tuple[int, int]]  # (node, depth)
    enough: int  # records of a subtree that is not divided further


def empty_aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Allocate without filling, at a multiple of 64 bytes."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    aligned: NDArray[Any] = memory[start : start + size].view(dtype).reshape(shape)
    return aligned


def _frame_of(bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bounds' centre, and the power of two that brings them into [-1, 1]."""
    centre = bounds[0] * 0.5 + bounds[1] * 0.5
    half = float((bounds[1] * 0.5 - bounds[0] * 0.5).max())
    # no finer than float64 resolves around the centre, nor so fine that squares underflow
    half = max(half, float(np.abs(centre).max()) * 2.0**-40, 1e-150)
    return np.append(centre, 2.0 ** -math.ceil(math.log2(half) + 1e-9))


def _grid_of(bounds: NDArray[np.float64], frame: NDArray[np.float64], bits: int) -> NDArray[np.float32]:
    """Return the grid over the bounds, as `tracer.accel.cells.count_cells` takes it."""
    grid = np.zeros((2, 8), np.float32)
    low = (bounds[0] - frame[:3]) * frame[3]
    extent = (bounds[1] - frame[:3]) * frame[3] - low
    grid[0, :3] = 2.0 * low
    grid[1, :3] = np.where(extent > 1e-20, (1 << bits) / np.maximum(2.0 * extent, 2e-20), 0.0)
    return grid


def _sort_in_cells(mesh: Mesh, bounds: NDArray[np.float64], threads: int, run: Run) -> Sorted:
    """Sort a large mesh's records into groups."""
    vertices, faces, n, _, frame = mesh
    check = int(n < len(faces))
    bits = 4 if n < _MANY else 5
    n_cells = (1 << 3 * bits) + _COARSE_CELLS
    grid = _grid_of(bounds, frame, bits)
    n_parts = 1 if threads == 1 else 2 * threads
    edges = [len(faces) * k // n_parts for k in range(n_parts + 1)]
    parts = list(zip(range(n_parts), edges[:-1], edges[1:], strict=True))
    boxes = empty_aligned((n_parts, n_cells, 8), np.float32)
    counts = empty_aligned((n_parts, n_cells), np.int32)

    def count(part: tuple[int, int, int]) -> None:
        k, start, end = part
        _count_cells(vertices, faces, start, end, check, frame, grid, bits, boxes[k], counts[k])

    list(run(count, parts))
    group_of = np.zeros(n_cells, np.int32)
    macros, groups = empty_aligned((n_cells, 8), np.float32), empty_aligned((n_cells, 8), np.float32)
    enough = min(max(n // _SUBTREES, 1024), _IN_CACHE)
    n_groups = _split_cells(boxes.reshape(-1, 8), counts, bits, enough, macros, groups, group_of)
    shares = np.stack([np.bincount(group_of, part, n_groups) for part in counts]).astype(np.int64)
    rows = np.cumsum(shares, 0) - shares
    rows += np.cumsum(shares.sum(0)) - shares.sum(0)
    records = empty_aligned((n, 8), np.float32)

    def sort(part: tuple[int, int, int]) -> None:
        k, start, end = part
        _sort_records(vertices, faces, start, end, check, frame, grid, bits, group_of, rows[k], records)

    list(run(sort, parts))
    nodes = empty_aligned((2 * n, 8), np.float32)
    clusters, kids = empty_aligned((2 * n_groups, 8), np.float32), np.empty((2 * n_groups, 2), np.int64)
    depths = np.empty(2 * n_groups, np.int64)
    n_nodes = _join_groups(groups[:n_groups], clusters, kids, nodes, depths)
    leaves = np.flatnonzero(nodes[:n_nodes].view(np.int32)[:, 7])
    return Sorted(records, nodes, n_nodes, [(int(node), int(depths[node])) for node in leaves], enough)


def _in_order(mesh: Mesh) -> Sorted:
    """Make one group of a small mesh's records."""
    n = mesh.n_usable
    records, nodes = empty_aligned((n, 8), np.float32), empty_aligned((2 * n, 8), np.float32)
    _make_records(mesh.vertices, mesh.faces, int(n < len(mesh.faces)), mesh.frame, records)
    bounds = np.empty((2, 8), np.float32)
    _bound_records(records, 0, n, bounds)
    nodes[0] = bounds[0]
    words = nodes.view(np.int32)
    words[0, 3], words[0, 7] = 0, n
    return Sorted(records, nodes, 1, [(0, 0)], n)


def sort_mesh(vertices: NDArray[Any], faces: NDArray[Any], threads: int, run: Run) -> tuple[Mesh, Sorted]:
    """Make the records of a mesh.

    Parameters
    ----------
    vertices, faces
        C-contiguous (nv, 3) and (nf, 3), with every index in range.
    threads
        How many there are.
    run
        `map` on them.

    Returns
    -------
    tuple
        The mesh in its frame; its sorted records.
    """
    bounds = np.empty((2, 3))
    unusable, narrow = _survey_vertices(vertices, bounds)
    n_usable = _survey_faces(vertices, faces, bounds) if unusable else len(faces)
    if n_usable == 0:
        mesh = Mesh(vertices, faces, 0, True, np.array([0.0, 0.0, 0.0, 1.0]))
        return mesh, Sorted(empty_aligned((0, 8), np.float32), np.zeros((1, 8), np.float32), 0, [], 0)
    for attempt in range(2):
        mesh = Mesh(vertices, faces, n_usable, bool(narrow), _frame_of(bounds))
        found = _sort_in_cells(mesh, bounds, threads, run) if n_usable >= LARGE else _in_order(mesh)
        extent = -(found.nodes[0, :3] + found.nodes[0, 4:7])
        if attempt == 1 or extent.max() > 0.25:  # 0.25: of vertices that no face uses, some may lie far away
            break
        n_usable = _survey_faces(vertices, faces, bounds)
    return mesh, found
