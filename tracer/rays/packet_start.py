"""Rays of a packet as states of the stream, and their answers back in the packet.

Invariant: a state's shear has the packet's bits (times a power of two), so the predicate decides as it does there. The
direction, which the node test and the sieve read in float32, is made from the shear again: a rounding in float64 off,
for which their bounds have room (:mod:`tracer.rays.state`).
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays import state as s
from tracer.rays.leaf import CLOSEST, barycentrics
from tracer.rays.rows import (
    AXIS,
    INTEGERS,
    LANES,
    ORIGIN,
    PRIMITIVE,
    ROW,
    SHEAR,
    SKIP,
    SPEED,
    T_BEST,
    VECTOR,
    WEIGHT_1,
    WEIGHT_2,
    direction_lanes,
)
from tracer.rays.start import as_intervals, fill_states
from tracer.simd import load, select, splat, store
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64

# copied one by one, whatever their type
_COPIED: Final = (ORIGIN, ORIGIN + ROW, ORIGIN + 2 * ROW, SHEAR, SHEAR + ROW, SPEED, T_BEST, PRIMITIVE, SKIP, AXIS)
FOUR_BYTES: Final = AXIS + ROW


@inline
def start_lanes(
    places: int, base: int, reach: float, packet: int, listed: int, count: int, mode: int, four: int
) -> None:
    """Start rays of a packet, 1 to 4 of them; behind the last come rays that meet nothing.

    Parameters
    ----------
    places, base, reach
        As for :func:`tracer.rays.start.start_four`.
    packet
        Address of the rays (:mod:`tracer.rays.rows`); what was found so far counts for CLOSEST.
    listed, count
        Address of int64, the numbers of the lanes; how many.
    mode
        What is looked for.
    four
        Address of `FOUR_BYTES`.
    """
    for k in range(count):
        ray, own = packet + 8 * load(_int64, listed + 8 * k), four + 8 * k
        for row in _COPIED:
            store(own + row, load(_int64, ray + row))
    for k in range(count, LANES):
        for row in _COPIED:
            store(four + 8 * k + row, _int64(0))  # no direction, no ray
    states = load(_int64, places), load(_int64, places + 8), load(_int64, places + 16), load(_int64, places + 24)
    origin = load(VECTOR, four + ORIGIN), load(VECTOR, four + ORIGIN + ROW), load(VECTOR, four + ORIGIN + 2 * ROW)
    dx, dy, dz = direction_lanes(four)
    none = splat(INTEGERS, _int64(-1))
    valid, unit, fx, fy, fz, t_min, t_max = as_intervals(
        origin[0], origin[1], origin[2], dx, dy, dz, splat(VECTOR, 0.0), load(VECTOR, four + T_BEST)
    )
    axis = load(INTEGERS, four + AXIS)
    on_z, on_y = axis >= splat(INTEGERS, _int64(4)), axis >= splat(INTEGERS, _int64(2))
    major = select(on_z, fz, select(on_y, fy, fx))
    shear = (
        load(VECTOR, four + SHEAR),
        load(VECTOR, four + SHEAR + ROW),
        splat(VECTOR, 1.0) / major,
        major,
        on_z,
        on_y,
    )
    best = load(INTEGERS, four + PRIMITIVE) if mode == CLOSEST else none
    interval = valid, unit, t_min, t_max
    fill_states(states, base, reach, origin, (fx, fy, fz), interval, shear, best, load(INTEGERS, four + SKIP))


@inline
def finish_lane(state: int, packet: int, mode: int) -> Any:
    """Write the answer of a packet's ray for CLOSEST; returns its bit where it has ended, for the other modes."""
    lane = load(_int64, state + s.RAY_INDEX)
    primitive = load(_int64, state + s.BEST_ID)
    if mode != CLOSEST:
        return _int64(primitive >= 0) << lane
    ray = packet + 8 * lane
    if primitive != load(_int64, ray + PRIMITIVE):
        u, v = barycentrics(state)
        store(ray + T_BEST, load(_float64, state + s.T_BEST) * load(_float64, state + s.UNIT_T))
        store(ray + PRIMITIVE, primitive)
        store(ray + WEIGHT_1, u)
        store(ray + WEIGHT_2, v)
    return _int64(0)
