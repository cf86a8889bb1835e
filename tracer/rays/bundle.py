"""Share out rays into packets that travel well together.

Rays of one packet need one dominant axis and sense; the nearer their origins and slopes, the narrower the beam. A
bundle is parted greedily: the first ray left takes those along that are close to it. Those with few companions
travel alone, many in flight (:mod:`tracer.rays.stream`), and so do all that are left once a packet has cost more work
than its rays would alone: it goes through a mesh that is finer than its beam.

Invariant: how rays are parted changes the time, not an answer (:mod:`tracer.rays.packet`).
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_SCALE
from tracer.jit import kernel
from tracer.rays.company import companions
from tracer.rays.packet import MODES, trace_packet
from tracer.rays.rows import ROW
from tracer.rays.stream import follow_all
from tracer.simd import (
    count_trailing_zeros,
    load,
    population_count,
    stack_memory,
    stand_alone,
    store,
)
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64

_NEAR: Final = 2.0**-5  # of origins, in frame units (the scene is 1 to 2 wide)
_ALIKE: Final = 2.0**-4  # of slopes
_FEWEST: Final = 8  # rays that make a packet
_PATIENCE: Final = 16  # work a ray, about what it costs alone


@kernel
def trace_alone(base: int, packet: int, lanes: int, mode: int, kt: int, face_material: int, stride: int) -> Any:
    """Follow any rays of a packet, each by itself; as `trace_bundle`. For CLOSEST the nearest hit so far counts."""
    stand_alone()
    no, numbers, n = _int64(0), stack_memory(ROW), _int64(0)
    while lanes != 0:
        store(numbers + 8 * n, _int64(count_trailing_zeros(lanes)))
        lanes &= lanes - 1
        n += 1
    no_rays, no_outputs = (no, no, no, no, no, no, no, no), (no, no, no, no)
    return follow_all(base, no_rays, (packet, kt, face_material, stride), numbers, no, n, mode & MODES, no_outputs)


@kernel
def trace_bundle(base: int, packet: int, lanes: int, mode: int, kt: int, face_material: int, stride: int) -> Any:
    """Follow any rays of a packet, whatever their AXIS.

    Parameters are those of :func:`tracer.rays.packet.trace_packet`, without SOLE; so is the first of its results.
    """
    stand_alone()
    ended = alone = _int64(0)
    near = _NEAR / load(_float64, base + 8 * FRAME_SCALE)
    while lanes != 0:
        chosen = companions(packet, lanes, near, _ALIKE)
        lanes &= ~chosen
        n = population_count(chosen)
        if n < _FEWEST:
            alone |= chosen
            continue
        done, left = trace_packet(base, packet, chosen, mode, kt, face_material, stride, _PATIENCE * n)
        ended |= done
        if left != 0:  # so would the others be
            alone |= left | lanes
            break
    if alone != 0:
        ended |= trace_alone(base, packet, alone, mode, kt, face_material, stride)
    return ended
