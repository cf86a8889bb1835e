"""Which four rays of a packet a triangle of a fine mesh concerns.

A packet's beam is wide beside the triangles of a fine mesh: each of them is met by a few of its rays. So when a beam
has come upon many triangles that do not cover it, lines are drawn about each four rays, and a leaf's triangles are held
against these sixteen groups in float32 before any of them is decided (:mod:`tracer.rays.tile_beam`, where the padding
is derived, :mod:`tracer.rays.tile_leaf`).

Invariant: a group is left out only where none of its rays meets the triangle's box before its end.
"""

from typing import Any, Final

from tracer.jit import kernel
from tracer.rays.tile_beam import BEAM_BYTES, LATE, draw_lines, is_resolved, leaf_pad, pad_of, slop_of, survey_tile
from tracer.simd import stand_alone

GROUPS_BYTES: Final = BEAM_BYTES  # the groups' lines
EVERY_GROUP: Final = 0xFFFF


@kernel
def draw_groups(packet: int, active: int, size: int, axes: Any, frame: Any, breadth: float, lines: int) -> float:
    """Draw the lines about each four active rays.

    Parameters
    ----------
    packet, active
        Rays of one axis and sense.
    size
        Bytes of a leaf's coordinate.
    axes, frame
        As in :mod:`tracer.rays.packet`.
    breadth
        Depth, either way, at which the lines are drawn.
    lines
        Address of `GROUPS_BYTES`.

    Returns
    -------
    float64
        What boxes need to be padded by; -1 where float32 is too coarse for these rays.
    """
    stand_alone()
    cx, cy, cz, scale, _sign = frame
    centre = max(abs(cx), abs(cy), abs(cz)) * scale
    reach = survey_tile(packet, active, axes, frame, breadth, lines)
    slop = slop_of(reach, centre)
    if not is_resolved(reach, slop, size, scale):
        return -1.0
    draw_lines(lines, breadth, pad_of(reach, breadth, slop), LATE + slop)
    return leaf_pad(centre)
