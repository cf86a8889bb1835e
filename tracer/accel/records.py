"""From vertices and faces to the binary build's records: the object's frame, and boxes rounded outward in it.

Invariant: a record's float32 box in the frame contains the triangle. Faces with a vertex that is not finite, or beyond
1e100 (where products of coordinates would overflow), have no record: no ray meets them.

A vertex is read as four lanes, of which the fourth is the next one's first coordinate: so the last vertex is read from
a copy (`copy_last`), or what is read would end behind the array.
"""

from typing import Any, Final

import numpy as np

from tracer.accel.binary import RECORD_BYTES
from tracer.accel.layout import LARGEST
from tracer.jit import inline, kernel
from tracer.simd import (
    absolute,
    address_of,
    concatenate,
    convert,
    float64x4,
    is_single,
    load_as_float64,
    maximum,
    minimum,
    splat,
    stack_memory,
    store,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64
_INF: Final = float("inf")


LAST_BYTES: Final = 64  # of memory for `copy_last`


@inline
def is_usable(vertices: Any, j: int) -> Any:
    """Tell whether a vertex is finite and small enough to compute with."""
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
        if not (is_usable(vertices, a) and is_usable(vertices, b) and is_usable(vertices, c)):
            continue
        usable += 1
        for k in range(3):
            for axis in range(3):
                x = _float64(vertices[_int64(faces[i, k]), axis])
                bounds[0, axis] = min(bounds[0, axis], x)
                bounds[1, axis] = max(bounds[1, axis], x)
    return usable


@inline
def copy_last(vertices: Any, memory: int) -> None:
    """Copy the last vertex, and as a fourth coordinate 0."""
    last = vertices.shape[0] - 1
    for axis in range(4):
        value = _float64(vertices[last, axis]) if axis < 3 else 0.0
        if is_single(vertices[last, 0]):
            store(memory + 4 * axis, _float32(value))
        else:
            store(memory + 8 * axis, value)


@inline
def _corner(vertices: Any, j: int, last: int) -> Any:
    """Return a vertex as float64 lanes, the fourth anything; ``last`` is the address of the last one's copy."""
    inside = j < vertices.shape[0] - 1
    if is_single(vertices[0, 0]):
        return load_as_float64(float64x4, _float32, address_of(vertices) + 12 * j if inside else last)
    return load_as_float64(float64x4, _float64, address_of(vertices) + 24 * j if inside else last)


@inline
def _rounded_down(x: Any) -> Any:
    """Round lanes to float32 numbers at or below them, one or two steps away."""
    return convert(_float32, x - absolute(x) * splat(float64x4, 1.1920928955078125e-07) - splat(float64x4, 1e-40))


@inline
def record_of(vertices: Any, a: int, b: int, c: int, last: int, centre: Any, scale: Any) -> Any:
    """Return the record of a triangle, without the words 3 and 7; ``centre`` and ``scale`` are lanes of the frame."""
    p, q, r = _corner(vertices, a, last), _corner(vertices, b, last), _corner(vertices, c, last)
    low = minimum(minimum(p, q), r)
    high = maximum(maximum(p, q), r)
    return concatenate(_rounded_down((low - centre) * scale), _rounded_down((centre - high) * scale))


@inline
def frame_lanes(frame: Any) -> Any:
    """Return (centre, scale) as lanes, of a frame (centre's x, y, z, scale)."""
    return load_as_float64(float64x4, _float64, address_of(frame)), splat(float64x4, frame[3])


@kernel
def make_records(vertices: Any, faces: Any, check: int, frame: Any, records: Any) -> None:
    """Write the records of all faces, in their order.

    Parameters
    ----------
    vertices, faces
        (nv, 3) float32 or float64; (nf, 3) integers.
    check
        1 leaves out the faces that are not usable; 0 is for when all are.
    frame
        float64 (4,): its centre's x, y, z, and its scale.
    records
        float32 (n, 8), written.
    """
    last = stack_memory(LAST_BYTES)
    copy_last(vertices, last)
    centre, scale = frame_lanes(frame)
    row = address_of(records)
    for i in range(faces.shape[0]):
        a, b, c = _int64(faces[i, 0]), _int64(faces[i, 1]), _int64(faces[i, 2])
        if check and not (is_usable(vertices, a) and is_usable(vertices, b) and is_usable(vertices, c)):
            continue
        store_record(row, record_of(vertices, a, b, c, last, centre, scale), i)
        row += RECORD_BYTES


@inline
def store_record(row: int, record: Any, face: int) -> None:
    """Write a record with its words."""
    store(row, record)
    store(row + 12, _int32(face))
    store(row + 28, np.float32(0.0))
