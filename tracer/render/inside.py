"""Kernels of :mod:`tracer.render.solids`: whether a mesh is closed, and how far from a point it is.

Source: Ericson 2005, "Real-Time Collision Detection", section 5.1.5 (the point of a triangle nearest to another).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.geometry.vector import add, at, cross, dot, scale, subtract
from tracer.jit import inline, kernel
from tracer.rays.predicate import intersect_triangle
from tracer.types import Vec3

_M1: Final = np.uint64(0xFF51AFD7ED558CCD)
_M2: Final = np.uint64(0xC4CEB9FE1A85EC53)
_S33: Final = np.uint64(33)
_SEED: Final = np.uint64(0x9E3779B97F4A7C15)


@inline
def _mix(x: Any) -> Any:
    """Mix 64 bits (MurmurHash3's finalizer)."""
    x ^= x >> _S33
    x *= _M1
    x ^= x >> _S33
    x *= _M2
    return x ^ (x >> _S33)


@kernel
def hash_places(positions: NDArray[np.float64], words: NDArray[np.uint64], hashes: NDArray[np.uint64]) -> None:
    """Write a hash of each place; ``words`` are the bits of ``positions + 0.0`` (so that -0 is 0)."""
    for i in range(positions.shape[0]):
        h = _SEED
        for k in range(3):
            h = _mix(h ^ words[i, k])
        hashes[i] = h


@kernel
def is_closed(faces: NDArray[np.int32], hashes: NDArray[np.uint64]) -> bool:
    """Tell whether each edge belongs to an even number of triangles."""
    total = np.uint64(0)
    for i in range(faces.shape[0]):
        for k in range(3):
            a, b = hashes[faces[i, k]], hashes[faces[i, (k + 1) % 3]]
            if a != b:
                total ^= _mix(_mix(a) + _mix(b))
    return bool(total == np.uint64(0))


@inline
def _least_square(p: Vec3, q: Vec3, r: Vec3) -> float:
    """Squared distance of a triangle from the origin."""
    a, b, c = p, q, r
    ab, ac = subtract(b, a), subtract(c, a)
    d1, d2 = -dot(ab, a), -dot(ac, a)
    d3, d4 = -dot(ab, b), -dot(ac, b)
    d5, d6 = -dot(ab, c), -dot(ac, c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    nearest = a
    if d1 <= 0.0 and d2 <= 0.0:
        nearest = a
    elif d3 >= 0.0 and d4 <= d3:
        nearest = b
    elif d6 >= 0.0 and d5 <= d6:
        nearest = c
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        nearest = add(a, scale(ab, d1 / (d1 - d3)))
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        nearest = add(a, scale(ac, d2 / (d2 - d6)))
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        nearest = add(b, scale(subtract(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6))))
    else:  # within: from the plane itself, which is accurate for slim triangles, too
        n = cross(ab, ac)
        along = dot(n, a)
        return along * along / dot(n, n)
    return dot(nearest, nearest)


@kernel
def measure_ball(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    middle: NDArray[np.float64],
    inverse: NDArray[np.float64],
    distance: NDArray[np.float64],
) -> int:
    """Measure the distance of a mesh from a point, and count how often a ray from there crosses it.

    Parameters
    ----------
    positions, faces
        The mesh.
    middle : float64 (3,)
        The point.
    inverse : float64 (3,)
        What coordinates are multiplied by before distances are measured.
    distance : float64 (1,)
        Written; -1 where one to a triangle is not a number.

    Returns
    -------
    int64
        The crossings.
    """
    least, crossings = np.inf, 0
    m, s = at(middle, 0), at(inverse, 0)
    for i in range(faces.shape[0]):
        a, b, c = positions[faces[i, 0]], positions[faces[i, 1]], positions[faces[i, 2]]
        square = _least_square(
            Vec3((a[0] - m.x) * s.x, (a[1] - m.y) * s.y, (a[2] - m.z) * s.z),
            Vec3((b[0] - m.x) * s.x, (b[1] - m.y) * s.y, (b[2] - m.z) * s.z),
            Vec3((c[0] - m.x) * s.x, (c[1] - m.y) * s.y, (c[2] - m.z) * s.z),
        )
        if not square >= 0.0:
            distance[0] = -1.0
            return 0
        least = min(least, square)
        hit, t, _u, _v, _w = intersect_triangle(
            a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], m.x, m.y, m.z, 0.0, 0.0, 1.0
        )
        if hit and t > 0.0:
            crossings += 1
    distance[0] = np.sqrt(least)
    return crossings
