"""Find out whether rays of a batch go the same way as those beside them, and whether they come in a picture's rows.

Looks at a few rays alone; what it finds decides about speed, never about an answer.
"""

import math
from typing import Any, Final

import numpy as np

from tracer.accel.layout import FRAME_SCALE
from tracer.jit import inline, kernel
from tracer.rays.predicate import shear_of
from tracer.rays.start import coordinate, four_vectors
from tracer.simd import absolute, address_of, float64x4, load, minimum, splat, store
from tracer.simd.gateway import types

_float64: Final = types.float64

LONGEST_ROW: Final = 8192
_SHORTEST_ROW: Final = 8
_GROUPS: Final = 32  # looked at, of as many rays each
_GROUP: Final = 16
_ALIKE: Final = 2.0**-4  # slopes of a group
_NEAR: Final = 2.0**-4  # origins of a group, in frame units
_PROBES: Final = 8  # rays whose neighbours in the next row are looked for
_FAR: Final = 0.5  # distance that counts as any greater one: an edge is as good as the next


@inline
def _ray(rays: Any, i: int) -> Any:
    """Return (origin, direction) of a ray, each as three float64."""
    origins, wide_o, directions, wide_d = rays[0], rays[1], rays[2], rays[3]
    o = origins + i * (12 << wide_o)
    d = directions + i * (12 << wide_d)
    return (
        (coordinate(o, wide_o, 0), coordinate(o, wide_o, 1), coordinate(o, wide_o, 2)),
        (coordinate(d, wide_d, 0), coordinate(d, wide_d, 1), coordinate(d, wide_d, 2)),
    )


@kernel
def go_together(tree: Any, rays: Any, n: int) -> float:
    """Return the share of rays, 0 to 1, that go the same way as those that follow them.

    Parameters
    ----------
    tree, rays
        As :func:`tracer.rays.single.trace_single`.
    n
        How many rays; from `_GROUP` on.
    """
    near = _NEAR / load(_float64, address_of(tree) + 8 * FRAME_SCALE)
    good = 0
    for group in range(_GROUPS):
        first = (n - _GROUP) * group // (_GROUPS - 1)
        o, d = _ray(rays, first)
        _kx, _ky, kz, sx, sy, sz = shear_of(d[0], d[1], d[2])
        alike = 0
        for i in range(first + 1, first + _GROUP):
            p, e = _ray(rays, i)
            _jx, _jy, jz, tx, ty, tz = shear_of(e[0], e[1], e[2])
            turned = max(abs(tx - sx), abs(ty - sy))
            apart = max(abs(p[0] - o[0]), abs(p[1] - o[1]), abs(p[2] - o[2]))
            if jz == kz and (tz > 0.0) == (sz > 0.0) and turned <= _ALIKE and apart <= near:
                alike += 1
        if 4 * alike >= 3 * (_GROUP - 1):
            good += 1
    return good / _GROUPS


@inline
def _add_distances(rays: Any, i: int, n_lags: int, scale: float, sums: int) -> None:
    """Add the distance of ray i from each that follows it: of origins in frame units, and of directions."""
    origins, wide_o, directions, wide_d = rays[0], rays[1], rays[2], rays[3]
    o, d = _ray(rays, i)
    size = abs(d[0]) + abs(d[1]) + abs(d[2])
    s, turn, far = splat(float64x4, scale), splat(float64x4, 1.0 / size), splat(float64x4, _FAR)
    x, y, z = splat(float64x4, o[0]), splat(float64x4, o[1]), splat(float64x4, o[2])
    dx, dy, dz = splat(float64x4, d[0]), splat(float64x4, d[1]), splat(float64x4, d[2])
    for lag in range(0, n_lags, 4):
        px, py, pz = four_vectors(origins + (i + lag) * (12 << wide_o), wide_o)
        ex, ey, ez = four_vectors(directions + (i + lag) * (12 << wide_d), wide_d)
        distance = (absolute(px - x) + absolute(py - y) + absolute(pz - z)) * s
        distance = distance + (absolute(ex - dx) + absolute(ey - dy) + absolute(ez - dz)) * turn
        store(sums + 8 * lag, load(float64x4, sums + 8 * lag) + minimum(distance, far))  # a NaN counts as far


@kernel
def _row_length(rays: Any, n: int, scale: float, n_lags: int, sums: int) -> int:
    for probe in range(_PROBES):
        _add_distances(rays, (n - n_lags) * (2 * probe + 1) // (2 * _PROBES), n_lags, scale, sums)
    best = _SHORTEST_ROW
    for lag in range(_SHORTEST_ROW, n_lags):
        if load(_float64, sums + 8 * lag) < load(_float64, sums + 8 * best):
            best = lag
    # a step to the next row is as long as one along the row: much less than eight of these
    if load(_float64, sums + 8 * best) < 0.5 * load(_float64, sums + 8 * _SHORTEST_ROW):
        return best
    return 0


@kernel
def row_length(tree: Any, rays: Any, n: int) -> int:
    """Return how many rays on the neighbour in the next row of a picture is; 0 where there seem to be no rows.

    Parameters
    ----------
    tree, rays
        As :func:`tracer.rays.single.trace_single`.
    n
        How many rays.
    """
    scale = load(_float64, address_of(tree) + 8 * FRAME_SCALE)
    n_lags = min(n // _SHORTEST_ROW, LONGEST_ROW) // 4 * 4
    if n_lags <= _SHORTEST_ROW or not math.isfinite(scale):
        return 0
    sums = np.zeros(n_lags)
    length = _row_length(rays, n, scale, n_lags, address_of(sums))
    sums[0] = 0.0  # used to the end: numba frees an array after its last use
    return length
