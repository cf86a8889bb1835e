"""Rays through the renderer's packets, from arrays: for the tests that hold one path against another."""

import numpy as np

from tests.tracer.rays.packets import put_direction
from tracer.jit import int64, kernel
from tracer.rays.bundle import trace_alone, trace_bundle
from tracer.rays.leaf import ANY, CLOSEST
from tracer.rays.packet import UNLIMITED, trace_packet
from tracer.rays.predicate import unit_of
from tracer.rays.rows import AXIS, ORIGIN, PRIMITIVE, RAY_ROWS, ROW, SKIP, T_BEST
from tracer.simd import address_of, count_trailing_zeros, load, store
from tracer.simd.gateway import types

_float64, _int64 = types.float64, types.int64
BUNDLES = -1
BUDGETS = (BUNDLES, UNLIMITED, 20)


@kernel
def trace_lanes(base, packet, lanes, mode, budget):
    """All lanes in one bundle; or, with a budget, each axis' in one packet, and alone when that is spent."""
    no = int64(0)
    if budget < 0:
        return trace_bundle(base, packet, lanes, mode, no, no, no)
    ended = no
    while lanes != 0:
        axis = load(_int64, packet + AXIS + 8 * count_trailing_zeros(lanes))
        chosen = no
        for i in range(64):
            chosen |= int64(load(_int64, packet + AXIS + 8 * i) == axis) << i
        chosen &= lanes
        lanes &= ~chosen
        done, left = trace_packet(base, packet, chosen, mode, no, no, no, budget)
        ended |= done
        if left != 0:
            ended |= trace_alone(base, packet, left, mode, no, no, no)
    return ended


@kernel
def trace_arrays(tree, memory, origins, directions, ends, skips, budget, times, primitives, met):
    base, packet = address_of(tree), address_of(memory)
    n = origins.shape[0]
    for first in range(0, n, 64):
        lanes = int64(0)
        for i in range(64):
            k = min(first + i, n - 1)  # lanes beyond the end hold the last ray, and are not in the set
            at = packet + 8 * i
            for c in range(3):
                store(at + ORIGIN + c * ROW, origins[k, c])
            # as the caster counts t; without it a t of a denormal's size is rounded otherwise
            unit = unit_of(directions[k, 0], directions[k, 1], directions[k, 2])
            put_direction(packet, i, directions[k, 0] * unit, directions[k, 1] * unit, directions[k, 2] * unit)
            store(at + T_BEST, ends[k] / unit)
            store(at + PRIMITIVE, int64(-1))
            store(at + SKIP, skips[k])
            if first + i < n:
                lanes |= int64(1) << i
        ended = trace_lanes(base, packet, lanes, int64(ANY), budget)
        trace_lanes(base, packet, lanes, int64(CLOSEST), budget)
        for i in range(min(64, n - first)):
            k = first + i
            met[k] = (ended >> i) & 1 != 0
            primitives[k] = load(_int64, packet + 8 * i + PRIMITIVE)
            unit = unit_of(directions[k, 0], directions[k, 1], directions[k, 2])
            times[k] = load(_float64, packet + 8 * i + T_BEST) * unit if primitives[k] >= 0 else np.inf


def by_packets(bvh, origins, directions, ends=np.inf, skips=-1, budget=BUNDLES):
    """(t, primitive, met) of each ray, 64 at a time in the order given; ``skips``: a face that each cannot meet.

    ``budget``: of work, for all of 64 that have one axis; or BUNDLES: as the renderer parts them.
    """
    n = len(origins)
    times, primitives, met = np.empty(n), np.empty(n, np.int64), np.empty(n, np.bool_)
    memory = np.zeros((RAY_ROWS + 1) * 64 + 8)
    memory = memory[(-memory.ctypes.data % 64) // 8 :][: RAY_ROWS * 64]
    origins, directions = np.ascontiguousarray(origins, np.float64), np.ascontiguousarray(directions, np.float64)
    ends = np.ascontiguousarray(np.broadcast_to(np.asarray(ends, np.float64), n))
    skips = np.ascontiguousarray(np.broadcast_to(np.asarray(skips, np.int64), n))
    trace_arrays(bvh.buffer, memory, origins, directions, ends, skips, np.int64(budget), times, primitives, met)
    return times, primitives, met
