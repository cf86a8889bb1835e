"""Rays against a triangle mesh, exactly: the public door, usable without the rest of the tracer.

>>> import numpy as np
>>> vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
>>> caster = RayCaster(vertices, np.array([[0, 1, 2]]))
>>> hits = caster.closest_hit([[0.25, 0.25, 1.0]], [[0.0, 0.0, -1.0]])
>>> hits.t.tolist(), hits.primitive.tolist()
([1.0], [0])
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.accel.wide import WideBvh, build_wide
from tracer.rays.brute import trace_brute
from tracer.rays.brute_table import FEW, tabulate
from tracer.rays.coherent import SIDE, trace_coherent
from tracer.rays.leaf import ANY, CLOSEST, COUNT
from tracer.rays.neighbours import go_together, row_length
from tracer.rays.stream import trace_stream

CHUNK: Final = 8192  # rays handed to a thread at a time
_WORTH_A_LOOK: Final = 1024  # rays
_TOGETHER: Final = 0.125  # share of rays that go together, from which tiles pay: they soon give up where they do not
_KEPT_BYTES: Final = 2**26  # largest memory of results that is kept for the next batch
_NOTHING: Final = np.empty(0)


class Hits(NamedTuple):
    """Closest hits of n rays."""

    t: NDArray[np.float64]  # (n,) ray parameter: the point is origin + t direction; inf for a miss
    primitive: NDArray[np.int32]  # (n,) row of `faces`; -1 for a miss
    u: NDArray[np.float64]  # (n,) weight of the face's second vertex; 0 for a miss
    v: NDArray[np.float64]  # (n,) weight of the face's third vertex; the first has 1 - u - v


class _Lent:
    """Memory of results, which goes back to its caster when no array needs it any more.

    Fresh pages, which the system clears first, cost a small scene 6 % of its time. As arrays hold what they are made
    of (``__array_interface__``), results that are still in use are never written to again.
    """

    def __init__(self, memory: NDArray[np.uint8], spare: list[NDArray[np.uint8]]) -> None:
        self._memory = memory
        self._spare = spare
        self.__array_interface__ = memory.__array_interface__

    def __del__(self) -> None:
        if self._memory.nbytes <= _KEPT_BYTES:
            self._spare[:] = [self._memory]


def _lend(spare: list[NDArray[np.uint8]], size: int) -> NDArray[np.uint8]:
    """Return uninitialised memory, the spare one if it has that size; it is spare again when no array needs it.

    In one piece: large ones come in large pages.
    """
    try:
        memory = spare.pop()  # one thread alone receives it
    except IndexError:
        memory = np.empty(size, np.uint8)
    return np.asarray(_Lent(memory if len(memory) == size else np.empty(size, np.uint8), spare))


class Rays(NamedTuple):
    """A batch of rays in the form that kernels take."""

    origins: NDArray[Any]  # (n, 3) float32 or float64
    directions: NDArray[Any]  # (n, 3) float32 or float64
    tmin: NDArray[np.float64]  # (n,), or (1,) for all
    tmax: NDArray[np.float64]

    @property
    def n(self) -> int:
        """How many."""
        return len(self.origins)

    @property
    def packed(self) -> tuple[int, ...]:
        """What :func:`tracer.rays.start.start_rays` takes; the arrays must live as long as it is used."""
        numbers: list[int] = []
        for array in (self.origins, self.directions):
            numbers += [array.ctypes.data, int(array.dtype == np.float64)]
        for limit in (self.tmin, self.tmax):
            numbers += [limit.ctypes.data, 8 if len(limit) > 1 else 0]
        return tuple(numbers)


class RayCaster:
    """Closest hits, any hits and crossings of rays with a triangle mesh.

    A closed mesh loses no ray and counts none twice, wherever the ray goes and however large or far away the mesh is:
    on which side of an edge a ray's line passes is decided exactly, once coordinates are rounded into a frame in which
    the ray is an axis (:mod:`tracer.rays.predicate`), and alike for all who share the edge. t is rounded (there, too,
    by how much): a ray that starts on a triangle, or within that of it, may meet it at a t next to 0. Where it matters,
    give a ``tmin``.
    Of equally near triangles the lowest row of ``faces`` is returned. Results do not depend on the order of the rays,
    on what else is in the batch, or on the number of threads. Speed does: rays in the order of a picture's rows, and
    others of which neighbours in the batch go much the same way, are several times as fast as shuffled ones.
    A caster keeps the memory of closest hits that are no longer used, up to 64 MiB, for the next batch of that size.

    Parameters
    ----------
    vertices
        (nv, 3) float32 or float64. A face with a vertex that is not finite, or beyond 1e100, is never met.
    faces
        (nf, 3) integers, rows of ``vertices``; at most 2**28.
    threads
        How many threads build the tree; it is the same tree.

    Raises
    ------
    tracer.accel.wide.BvhError
        (a ValueError) Arrays of another shape or type, or a face that names a vertex which is not there.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, *, threads: int = 1) -> None:
        self._use(build_wide(np.asarray(vertices), np.asarray(faces), threads=threads))

    @classmethod
    def from_bvh(cls, bvh: WideBvh) -> "RayCaster":
        """Make a caster of a tree that is built already, such as one mapped from a file.

        Parameters
        ----------
        bvh
            From :func:`tracer.accel.wide.build_wide` or :func:`tracer.accel.wide.load_wide`.
        """
        caster = cls.__new__(cls)
        caster._use(bvh)  # noqa: SLF001 - its own
        return caster

    def _use(self, bvh: WideBvh) -> None:
        self.bvh = bvh
        self._spare: list[NDArray[np.uint8]] = []

    @cached_property
    def few_triangles(self) -> NDArray[np.float64]:
        """The table of a mesh of at most `FEW` triangles: :mod:`tracer.rays.brute_table`."""
        return tabulate(self.bvh)

    def closest_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: ArrayLike = 0.0,
        tmax: ArrayLike = np.inf,
        *,
        threads: int = 1,
    ) -> Hits:
        """Find the nearest triangle of each ray.

        Parameters
        ----------
        origins, directions
            (n, 3) float32 or float64; directions of any length but 0.
        tmin, tmax
            Scalars or (n,): a hit has max(tmin, 0) < t < tmax, in units of the direction's length.
        threads
            How many to use.

        Returns
        -------
        Hits
            A ray with a NaN, an infinite or zero direction, an origin beyond 1e100, or tmin >= tmax misses.

        Raises
        ------
        ValueError
            Arrays of shapes that do not fit together.
        """
        rays = checked_rays(origins, directions, tmin, tmax)
        n = rays.n
        memory = _lend(self._spare, 28 * n)
        floats = memory[: 24 * n].view(np.float64)
        hits = Hits(floats[:n], memory[24 * n :].view(np.int32), floats[n : 2 * n], floats[2 * n :])
        self._run(CLOSEST, rays, hits, threads)
        return hits

    def any_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: ArrayLike = 0.0,
        tmax: ArrayLike = np.inf,
        *,
        threads: int = 1,
    ) -> NDArray[np.bool_]:
        """Tell which rays meet any triangle; parameters as :meth:`closest_hit`.

        Returns
        -------
        bool (n,)
        """
        rays = checked_rays(origins, directions, tmin, tmax)
        met = np.empty(rays.n, np.int32)
        self._run(ANY, rays, Hits(_NOTHING, met, _NOTHING, _NOTHING), threads)
        return met.astype(np.bool_)

    def count_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: ArrayLike = 0.0,
        tmax: ArrayLike = np.inf,
        *,
        threads: int = 1,
    ) -> NDArray[np.int32]:
        """Count the triangles that each ray crosses; parameters as :meth:`closest_hit`.

        On a closed mesh the number is odd for a ray from inside (with tmin 0, tmax infinite) and even from outside,
        for every ray, also through vertices and along edges.

        Returns
        -------
        int32 (n,)
        """
        rays = checked_rays(origins, directions, tmin, tmax)
        counts = np.empty(rays.n, np.int32)
        self._run(COUNT, rays, Hits(_NOTHING, counts, _NOTHING, _NOTHING), threads)
        return counts

    def _run(self, mode: int, rays: Rays, hits: Hits, threads: int) -> None:
        """Answer all rays, in chunks on several threads; each writes its own rows."""
        path, chunk, more = choose_path(mode, rays, self)
        packed = rays.packed

        def run(start: int, end: int) -> None:
            path(self.bvh.buffer, packed, start, end, mode, *hits, *more)

        if threads <= 1 or rays.n <= chunk:
            run(0, rays.n)
            return
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda start: run(start, min(start + chunk, rays.n)), range(0, rays.n, chunk)))


def choose_path(mode: int, rays: Rays, caster: RayCaster) -> tuple[Callable[..., None], int, tuple[int, ...]]:
    """Choose the kernel for a batch: the one door for further paths.

    Every path takes the same parameters (:func:`tracer.rays.single.trace_single`) and gives the same answers, so this
    is about speed alone.

    Returns
    -------
    tuple
        (kernel, rays handed to a thread at a time, further arguments).
    """
    bvh = caster.bvh
    if mode != COUNT and rays.n >= _WORTH_A_LOOK:
        width = row_length(bvh.buffer, rays.packed, rays.n)
        if width > 0:
            band = SIDE * width
            return trace_coherent, max(CHUNK // band, 1) * band, (width,)
        if bvh.n_triangles <= FEW:
            return trace_brute, CHUNK, (caster.few_triangles.ctypes.data,)
        if go_together(bvh.buffer, rays.packed, rays.n) >= _TOGETHER:
            return trace_coherent, CHUNK, (0,)
    return trace_stream, CHUNK, ()


def checked_rays(origins: ArrayLike, directions: ArrayLike, tmin: ArrayLike, tmax: ArrayLike) -> Rays:
    """Bring rays into the form that the kernels take."""
    vectors = []
    for name, given in (("origins", origins), ("directions", directions)):
        array = np.asarray(given)
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: shape {array.shape}, expected (n, 3)")
        if array.dtype not in {np.dtype(np.float32), np.dtype(np.float64)}:
            array = array.astype(np.float64)
        vectors.append(np.require(array, requirements=["C", "A"]))
    n = len(vectors[0])
    if len(vectors[1]) != n:
        raise ValueError(f"directions: {len(vectors[1])} rows, expected {n} as in origins")
    limits = []
    for name, given in (("tmin", tmin), ("tmax", tmax)):
        limit = np.atleast_1d(np.asarray(given, np.float64))
        if limit.shape not in {(1,), (n,)}:
            raise ValueError(f"{name}: shape {limit.shape}, expected a scalar or ({n},)")
        limits.append(np.require(limit, requirements=["C", "A"]))
    return Rays(vectors[0], vectors[1], limits[0], limits[1])
