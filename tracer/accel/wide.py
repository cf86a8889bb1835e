"""Build, save and map the wide tree of one object: the only door to :mod:`tracer.accel`'s builder.

Invariants: the tree depends on vertices and faces alone, never on the number of threads; the result is one flat buffer
as :mod:`tracer.accel.layout` says, with its depth checked, that can be written to a file and mapped again.

How: :mod:`tracer.accel.sorting` makes the records and the top of the binary tree, :mod:`tracer.accel.assembly` builds
and writes subtree after subtree.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import layout
from tracer.accel.assembly import BvhError, assemble
from tracer.accel.sorting import sort_mesh

MAX_FACES: Final = 2 ** (31 - layout.ORDER_BITS)


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
        The file is not such a tree, of another version, or cut short. What is in it is not looked at: rays need a tree
        that :meth:`WideBvh.save` wrote.
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


@contextmanager
def _mapper(threads: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a `map` that runs on so many threads; kernels release the GIL."""
    if threads <= 1:
        yield map
    else:
        with ThreadPoolExecutor(threads) as pool:
            yield pool.map


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
        mesh, found = sort_mesh(vertices, faces, threads, run)
        buffer, n_nodes, depth = assemble(mesh, found, threads, run)
    if depth > layout.MAX_DEPTH:
        raise BvhError(f"depth {depth}; a traversal's stack is made for {layout.MAX_DEPTH}")
    buffer[: layout.HEADER_BYTES // 8] = 0
    buffer[-layout.PADDING // 8 :] = 0
    buffer[layout.HEADER_MAGIC] = layout.MAGIC
    buffer[layout.HEADER_VERSION] = layout.VERSION
    buffer[layout.HEADER_BYTE_COUNT] = buffer.nbytes
    buffer[layout.HEADER_TRIANGLES] = mesh.n_usable
    buffer[layout.HEADER_NODES] = n_nodes
    buffer[layout.HEADER_DEPTH] = depth
    buffer[layout.HEADER_WIDE_LEAVES] = int(not mesh.narrow)
    floats = buffer.view(np.float64)
    floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3] = mesh.frame[:3]
    floats[layout.FRAME_SCALE] = mesh.frame[3]
    box = found.nodes[0].astype(np.float64)
    half = np.maximum(np.abs(box[:3]), np.abs(box[4:7])) if mesh.n_usable else -1.0
    floats[layout.FRAME_HALF : layout.FRAME_HALF + 3] = half
    return WideBvh(buffer)
