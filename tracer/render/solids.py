"""Balls inside closed meshes: what passes through one has crossed the mesh.

A mesh is closed if each of its edges, as a pair of places, belongs to an even number of triangles. Then every way from
a point within to a point outside meets a triangle, and so does every ray by the predicate, which loses none at edges.
So a shadow ray to a lamp outside that passes through a ball within an opaque closed mesh arrives nowhere, whatever
triangle it is that it meets.

The ball is the largest about the middle of the mesh's box, in a space where that box is a cube: an ellipsoid.

Closedness is told by the exclusive or of a 64-bit hash of each edge: of an open mesh it is 0 once in 2**64 meshes.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel.top import bounds_of
from tracer.native.entries import entry
from tracer.types import N_SOLID

MOST_SOLIDS: Final = 8  # of a scene: each shadow ray is held against all of them
_LEAST_RADIUS: Final = 0.1  # of the box's half extent; smaller balls are not worth a test
_SHRINK: Final = 1.0 - 2.0**-20  # room for rounding

_hash_places = entry("tracer.render.inside.hash_places")
_is_closed = entry("tracer.render.inside.is_closed")
_measure_ball = entry("tracer.render.inside.measure_ball")


def find_solid(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64] | None:
    """Find a ball within a mesh.

    Parameters
    ----------
    positions : float64 (n, 3)
    faces : int32 (m, 3)

    Returns
    -------
    float64 (N_SOLID,) or None
        As `tracer.types.CompiledScene` says; None where the mesh is open, or its middle is not far within.
    """
    if len(faces) < 4:
        return None
    hashes = np.empty(len(positions), np.uint64)
    _hash_places(positions, (positions + 0.0).view(np.uint64), hashes)
    if not _is_closed(faces, hashes):
        return None
    low, high = bounds_of(positions, faces).reshape(2, 3)
    half = 0.5 * high - 0.5 * low
    middle = low + half
    if not (half > 2.0**-30 * np.abs(middle).max()).all() or not np.isfinite(1.0 / half).all():
        return None
    distance = np.empty(1)
    crossings = _measure_ball(positions, faces, middle, 1.0 / half, distance)
    radius = float(distance[0])
    if crossings % 2 == 0 or not radius > _LEAST_RADIUS:
        return None
    return np.concatenate([middle, 1.0 / (half * (radius * _SHRINK)), 1.0 / half])


def find_solids(meshes: Iterable[tuple[NDArray[np.float64], NDArray[np.int32]]]) -> NDArray[np.float64]:
    """Find balls within meshes of a scene, the largest ones (`MOST_SOLIDS`).

    Parameters
    ----------
    meshes
        Vertices and faces of those all of whose faces let nothing through.

    Returns
    -------
    float64 (n, N_SOLID)
    """
    found = [solid for positions, faces in meshes if (solid := find_solid(positions, faces)) is not None]
    found.sort(key=lambda solid: float(np.prod(solid[3:6])))
    return np.array(found[:MOST_SOLIDS]).reshape(-1, N_SOLID)
