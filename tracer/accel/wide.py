"""Build, save and map the wide tree of one object: the only door to :mod:`tracer.accel`'s builder.

Invariants: the tree depends on vertices and faces alone, never on the number of threads; the result is one flat buffer
as :mod:`tracer.accel.layout` says, with its depth checked, that can be written to a file and mapped again.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import layout
from tracer.native.entries import entry

_TASKS: Final = 12  # subtrees of a large mesh that threads build; few enough that the top is a small part
_LARGE: Final = 20_000  # triangles from which on tasks are made at all
_TOP_LEVELS: Final = 2  # wide levels written before the tasks: at most 1 + 8 nodes, 64 tasks
MAX_FACES: Final = 2 ** (31 - layout.ORDER_BITS)

survey_vertices = entry("tracer.accel.records.survey_vertices")
survey_faces = entry("tracer.accel.records.survey_faces")
make_records = entry("tracer.accel.records.make_records")
bound_records = entry("tracer.accel.binary.bound_records")
build_binary = entry("tracer.accel.binary.build_binary")
plan_nodes = entry("tracer.accel.collapse.plan_nodes")
measure = entry("tracer.accel.collapse.measure")
emit_single_leaf = entry("tracer.accel.emit.emit_single_leaf")
emit_node = entry("tracer.accel.emit.emit_node")
emit_subtree = entry("tracer.accel.emit.emit_subtree")


class WideBvh(NamedTuple):
    """A wide tree over the triangles of one object."""

    buffer: NDArray[np.int64]  # (bytes / 8,), 64-byte aligned; tracer.accel.layout

    @property
    def n_triangles(self) -> int:
        """Triangles in the tree: all faces but those with unusable vertices."""
        return int(self.buffer[layout.HEADER_TRIANGLES])

    @property
    def n_nodes(self) -> int:
        """Wide nodes."""
        return int(self.buffer[layout.HEADER_NODES])

    @property
    def depth(self) -> int:
        """Nodes on the longest way down, at most `MAX_DEPTH`."""
        return int(self.buffer[layout.HEADER_DEPTH])

    @property
    def n_bytes(self) -> int:
        """Bytes of the buffer."""
        return int(self.buffer.nbytes)

    def save(self, path: Path) -> None:
        """Write the buffer to a file, as it is.

        Parameters
        ----------
        path
            File to create or replace.
        """
        self.buffer.tofile(path)


class BvhError(ValueError):
    """The mesh cannot be built, or a saved tree cannot be read."""


def load_wide(path: Path) -> WideBvh:
    """Map a saved tree into memory.

    Parameters
    ----------
    path
        What :meth:`WideBvh.save` wrote.

    Returns
    -------
    WideBvh
        Read from the file as it is needed.

    Raises
    ------
    BvhError
        The file is not such a tree, of another version, or cut short.
    """
    try:
        buffer = np.memmap(path, np.int64, "c")
    except ValueError as error:
        raise BvhError(f"{path}: {error}") from error
    words = buffer[: layout.HEADER_BYTES // 8]
    if len(words) < layout.HEADER_BYTES // 8 or words[layout.HEADER_MAGIC] != layout.MAGIC:
        raise BvhError(f"{path}: not a saved tree")
    if words[layout.HEADER_VERSION] != layout.VERSION:
        raise BvhError(f"{path}: version {words[layout.HEADER_VERSION]}, expected {layout.VERSION}")
    if words[layout.HEADER_BYTE_COUNT] != buffer.nbytes:
        raise BvhError(f"{path}: {buffer.nbytes} bytes, expected {words[layout.HEADER_BYTE_COUNT]}")
    return WideBvh(np.asarray(buffer))


def geometry_key(vertices: NDArray[Any], faces: NDArray[Any]) -> str:
    """Name a mesh's tree: a hash of its geometry and of the builder's version.

    Parameters
    ----------
    vertices, faces
        As for :func:`build_wide`.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    digest = hashlib.sha256(f"smalti wide bvh {layout.VERSION}\n".encode())
    for array in (vertices, faces):
        digest.update(f"{array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def empty_aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Allocate without filling, at a multiple of 64 bytes."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    aligned: NDArray[Any] = memory[start : start + size].view(dtype).reshape(shape)
    return aligned


@contextmanager
def _mapper(threads: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a `map` that runs on so many threads; kernels release the GIL."""
    if threads <= 1:
        yield map
    else:
        with ThreadPoolExecutor(threads) as pool:
            yield pool.map


def _frame(bounds: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centre, and the power of two that brings the bounds into [-1, 1]."""
    centre = bounds[0] * 0.5 + bounds[1] * 0.5
    half = float((bounds[1] * 0.5 - bounds[0] * 0.5).max())
    # no finer than float64 resolves around the centre, nor so fine that squares underflow
    half = max(half, float(np.abs(centre).max()) * 2.0**-40, 1e-150)
    return centre, 2.0 ** -math.ceil(math.log2(half) + 1e-9)


def _records(
    vertices: NDArray[Any], faces: NDArray[Any], run: Callable[..., Iterable[Any]]
) -> tuple[NDArray[np.float32], NDArray[np.float64], float, bool, NDArray[np.float32]]:
    """Return records, centre, scale, whether float32 leaves do, and the bounds (2, 8) of boxes and centroids."""
    bounds = np.empty((2, 3))
    unusable, narrow = survey_vertices(vertices, bounds)
    n_usable = len(faces)
    boxes = np.empty((2, 8), np.float32)
    if unusable:
        n_usable = survey_faces(vertices, faces, bounds)
    if n_usable == 0:
        return empty_aligned((0, 8), np.float32), np.zeros(3), 1.0, True, boxes
    for attempt in range(2):
        centre, scale = _frame(bounds)
        records = empty_aligned((n_usable, 8), np.float32)
        if unusable:
            make_records(vertices, faces, 0, len(faces), 1, centre, scale, records, 0)
        else:
            step = max(65536, -(-len(faces) // 8))
            starts = range(0, len(faces), step)
            ends = [min(start + step, len(faces)) for start in starts]
            job = lambda s, e: make_records(vertices, faces, s, e, 0, centre, scale, records, s)  # noqa: E731,B023
            list(run(job, starts, ends))
        bound_records(records, 0, n_usable, boxes)
        extent = -(boxes[0, :3] + boxes[0, 4:7])
        if attempt == 1 or extent.max() > 0.25:  # 0.25: of vertices that no face uses, some may lie far away
            break
        n_usable = survey_faces(vertices, faces, bounds)
    return records, centre, scale, bool(narrow), boxes


def _binary_tree(
    records: NDArray[np.float32], boxes: NDArray[np.float32], run: Callable[..., Iterable[Any]]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Build the binary tree and its plan.

    Where tasks come one after another, each begins where the last one ended: the less memory is touched the better.
    """
    n = len(records)
    nodes = empty_aligned((2 * n + 8 * _TASKS, 8), np.float32)
    plan = empty_aligned((len(nodes), 4), np.int32)
    words = nodes.view(np.int32)
    nodes[0] = boxes[0]
    words[0, 3], words[0, 7] = 0, n
    stop = n // _TASKS if n >= _LARGE else layout.STOP
    pending = np.empty((8 * _TASKS if n >= _LARGE else 0, 8))
    top, n_pending = build_binary(records, nodes, 0, 0, boxes[1], 1, stop, pending)
    costs = empty_aligned((top, 8), np.float32)
    roots = pending[:n_pending].view(np.int64)[:, 0]
    depths = pending[:n_pending].view(np.int64)[:, 1]
    centroids = pending[:n_pending].view(np.float32)[:, 8:]
    counts = words[roots, 7].astype(np.int64)
    starts = top + 2 * (np.cumsum(counts) - counts)
    none = np.empty((0, 8))
    spare: list[NDArray[np.float32]] = []  # fresh memory costs more than what is written to it
    free = top

    def task(i: int) -> None:
        nonlocal free
        start = free if run is map else int(starts[i])
        bounds = np.ascontiguousarray(centroids[i])
        root = int(roots[i])
        end, _ = build_binary(records, nodes, root, int(depths[i]), bounds, start, layout.STOP, none)
        below = spare.pop() if spare else empty_aligned((2 * int(counts.max()), 8), np.float32)
        plan_nodes(nodes, start, end, below, start, below, start, plan)
        plan_nodes(nodes, root, root + 1, costs, 0, below, start, plan)
        spare.append(below)
        free = end

    list(run(task, np.argsort(-counts, kind="stable").tolist()))
    # above the roots, which have their plan already
    edges = [-1, *sorted(roots.tolist()), top]
    for below_root, root in zip(edges[-2::-1], edges[:0:-1], strict=True):
        plan_nodes(nodes, below_root + 1, root, costs, 0, costs, 0, plan)
    return nodes, plan


def _write_tree(
    tree: tuple[Any, Any, Any, Any, Any], narrow: bool, run: Callable[..., Iterable[Any]]
) -> tuple[NDArray[np.int64], int, int]:
    """Return (buffer, wide nodes, depth); ``tree`` is nodes, plan, records, vertices, faces."""
    nodes, plan, records, vertices, faces = tree
    wide = int(not narrow)
    top = empty_aligned((1 << 14,), np.int64)  # 128 KiB: the header and 1 + 8 nodes with eight leaves each
    offset = layout.HEADER_BYTES
    if len(records) <= layout.LEAF_TRIANGLES and (len(records) == 0 or plan[0, 2] & 0xF0 == 0):
        offset = emit_single_leaf(nodes, records, len(records), vertices, faces, top, offset, wide)
        buffer = empty_aligned(((offset + layout.PADDING) // 8,), np.int64)
        buffer[: offset // 8] = top[: offset // 8]
        return buffer, 1, 1
    inner = np.empty((8, 2), np.int64)
    todo = [(0, -1)]  # binary node, offset of its word
    links: list[tuple[int, int]] = []
    n_nodes = 0
    for _ in range(_TOP_LEVELS):
        following = []
        for binary, word in todo:
            links.append((word, offset))
            offset, n_inner = emit_node(*tree, binary, top, offset, wide, inner)
            following += [(int(kid), int(place)) for kid, place in inner[:n_inner]]
            n_nodes += 1
        todo = following
    sizes = list(run(lambda item: measure(nodes, plan, item[0], 4 + 4 * wide), todo))
    starts = [offset]
    for size, _, _ in sizes:
        starts.append(starts[-1] + size)
    total = starts[-1] + layout.PADDING
    if total > layout.MAX_BYTES:
        raise BvhError(f"the tree takes {total} bytes; at most {layout.MAX_BYTES} can be addressed")
    buffer = empty_aligned((total // 8,), np.int64)
    buffer[: offset // 8] = top[: offset // 8]
    words = buffer.view(np.int32)
    links += [(word, start) for (_, word), start in zip(todo, starts, strict=False)]
    for word, start in links:
        if word >= 0:
            words[word // 4] = start // layout.UNIT << 3
    list(run(lambda i: emit_subtree(*tree, todo[i][0], buffer, starts[i], wide), range(len(todo))))
    levels = (_TOP_LEVELS if n_nodes > 1 else 1) + max((depth for _, _, depth in sizes), default=0)
    return buffer, n_nodes + sum(count for _, count, _ in sizes), levels


def _checked(vertices: NDArray[Any], faces: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    vertices = np.asarray(vertices)
    faces = np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise BvhError(f"vertices: shape {vertices.shape}, expected (n, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise BvhError(f"faces: shape {faces.shape}, expected (n, 3)")
    if faces.dtype.kind not in "iu":
        raise BvhError(f"faces: dtype {faces.dtype}, expected integers")
    if len(faces) > MAX_FACES:
        raise BvhError(f"{len(faces)} faces; at most {MAX_FACES} have an id")
    if len(faces) and (int(faces.min()) < 0 or int(faces.max()) >= len(vertices)):
        worst = int(faces.min()) if int(faces.min()) < 0 else int(faces.max())
        raise BvhError(f"faces: vertex {worst} is not one of 0 .. {len(vertices) - 1}")
    if vertices.dtype != np.float32:
        vertices = vertices.astype(np.float64, copy=False)
    if len(vertices) < 2**31:  # one type of faces, one set of kernels
        faces = faces.astype(np.int32, copy=False)
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces)


def build_wide(vertices: NDArray[Any], faces: NDArray[Any], *, threads: int = 1) -> WideBvh:
    """Build the wide tree of a mesh.

    Parameters
    ----------
    vertices
        (nv, 3), float32 or anything that converts to float64. Faces with a vertex that is not finite, or beyond
        1e100, are left out: no ray meets them.
    faces
        (nf, 3) integers, rows of ``vertices``.
    threads
        How many to build with; the tree is the same.

    Returns
    -------
    WideBvh
        52 (float32 leaves) to 89 (float64 leaves) bytes a triangle on ordinary meshes.

    Raises
    ------
    BvhError
        Arrays of another shape or type, a face names a vertex that is not there, or more than 8 GiB.
    """
    vertices, faces = _checked(vertices, faces)
    with _mapper(threads) as run:
        records, centre, scale, narrow, boxes = _records(vertices, faces, run)
        if len(records):
            nodes, plan = _binary_tree(records, boxes, run)
        else:
            nodes, plan = empty_aligned((1, 8), np.float32), np.zeros((1, 4), np.int32)
        buffer, n_nodes, depth = _write_tree((nodes, plan, records, vertices, faces), narrow, run)
    if depth > layout.MAX_DEPTH:
        raise BvhError(f"depth {depth}; a traversal's stack is made for {layout.MAX_DEPTH}")
    buffer[: layout.HEADER_BYTES // 8] = 0
    buffer[-layout.PADDING // 8 :] = 0
    buffer[layout.HEADER_MAGIC] = layout.MAGIC
    buffer[layout.HEADER_VERSION] = layout.VERSION
    buffer[layout.HEADER_BYTE_COUNT] = buffer.nbytes
    buffer[layout.HEADER_TRIANGLES] = len(records)
    buffer[layout.HEADER_NODES] = n_nodes
    buffer[layout.HEADER_DEPTH] = depth
    buffer[layout.HEADER_WIDE_LEAVES] = int(not narrow)
    floats = buffer.view(np.float64)
    floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3] = centre
    floats[layout.FRAME_SCALE] = scale
    if len(records):
        box = boxes[0].astype(np.float64)
        floats[layout.FRAME_HALF : layout.FRAME_HALF + 3] = np.maximum(np.abs(box[:3]), np.abs(box[4:7]))
    else:
        floats[layout.FRAME_HALF : layout.FRAME_HALF + 3] = -1.0
    return WideBvh(buffer)
