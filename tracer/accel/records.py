"""From vertices and faces to the binary build's records: the object's frame, and boxes rounded outward in it.

Invariant: a record's float32 box in the frame contains the triangle. Faces with a vertex that is not finite, or beyond
1e100 (where products of coordinates would overflow), have no record: no ray meets them.
"""

from typing import Any, Final

import numpy as np

from tracer.accel.binary import RECORD_BYTES
from tracer.accel.layout import LARGEST
from tracer.jit import inline, kernel
from tracer.simd import address_of, store
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64
_INF: Final = float("inf")


@inline
def _usable(vertices: Any, j: int) -> Any:
    x, y, z = _float64(vertices[j, 0]), _float64(vertices[j, 1]), _float64(vertices[j, 2])
    return abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST


@kernel
def survey_vertices(vertices: Any, bounds: Any) -> Any:
    """Bound all vertices.

    Parameters
    ----------
    vertices
        (nv, 3) float32 or float64.
    bounds
        float64 (2, 3); receives low and high of the usable ones.

    Returns
    -------
    tuple of int
        (vertices that are not usable, 1 if float32 holds all others exactly).
    """
    unusable = 0
    inexact = 0
    x0 = y0 = z0 = _INF
    x1 = y1 = z1 = -_INF
    for j in range(vertices.shape[0]):
        x, y, z = _float64(vertices[j, 0]), _float64(vertices[j, 1]), _float64(vertices[j, 2])
        if not (abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST):
            unusable += 1
            continue
        x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
        x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
        if _float64(_float32(x)) != x or _float64(_float32(y)) != y or _float64(_float32(z)) != z:
            inexact += 1
    bounds[0, 0], bounds[0, 1], bounds[0, 2] = x0, y0, z0
    bounds[1, 0], bounds[1, 1], bounds[1, 2] = x1, y1, z1
    return unusable, 1 if inexact == 0 else 0


@kernel
def survey_faces(vertices: Any, faces: Any, bounds: Any) -> int:
    """Bound the usable faces' vertices alone, as `survey_vertices`; returns how many faces are usable."""
    usable = 0
    bounds[0, :] = _INF
    bounds[1, :] = -_INF
    for i in range(faces.shape[0]):
        a, b, c = _int64(faces[i, 0]), _int64(faces[i, 1]), _int64(faces[i, 2])
        if not (_usable(vertices, a) and _usable(vertices, b) and _usable(vertices, c)):
            continue
        usable += 1
        for k in range(3):
            for axis in range(3):
                x = _float64(vertices[_int64(faces[i, k]), axis])
                bounds[0, axis] = min(bounds[0, axis], x)
                bounds[1, axis] = max(bounds[1, axis], x)
    return usable


@inline
def _round_down(x: float) -> Any:
    """Round to a float32 at or below x, one or two steps away."""
    return _float32(x - abs(x) * 1.1920928955078125e-07 - 1e-40)


@kernel
def make_records(
    vertices: Any, faces: Any, start: int, end: int, check: int, centre: Any, scale: float, records: Any, first: int
) -> int:
    """Write the records of faces start..end from row ``first`` on; returns the row behind them.

    ``check`` = 1 leaves out the faces that are not usable; 0 is for when all are.
    """
    base = address_of(records) + first * RECORD_BYTES
    row = first
    c0, c1, c2 = centre[0], centre[1], centre[2]
    for i in range(start, end):
        a, b, c = _int64(faces[i, 0]), _int64(faces[i, 1]), _int64(faces[i, 2])
        if check and not (_usable(vertices, a) and _usable(vertices, b) and _usable(vertices, c)):
            continue
        row += 1
        x0 = min(_float64(vertices[a, 0]), _float64(vertices[b, 0]), _float64(vertices[c, 0]))
        y0 = min(_float64(vertices[a, 1]), _float64(vertices[b, 1]), _float64(vertices[c, 1]))
        z0 = min(_float64(vertices[a, 2]), _float64(vertices[b, 2]), _float64(vertices[c, 2]))
        x1 = max(_float64(vertices[a, 0]), _float64(vertices[b, 0]), _float64(vertices[c, 0]))
        y1 = max(_float64(vertices[a, 1]), _float64(vertices[b, 1]), _float64(vertices[c, 1]))
        z1 = max(_float64(vertices[a, 2]), _float64(vertices[b, 2]), _float64(vertices[c, 2]))
        store(base, _round_down((x0 - c0) * scale))
        store(base + 4, _round_down((y0 - c1) * scale))
        store(base + 8, _round_down((z0 - c2) * scale))
        store(base + 12, _int32(i))
        store(base + 16, _round_down((c0 - x1) * scale))
        store(base + 20, _round_down((c1 - y1) * scale))
        store(base + 24, _round_down((c2 - z1) * scale))
        store(base + 28, np.float32(0.0))
        base += RECORD_BYTES
    return row
