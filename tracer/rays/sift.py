"""Which four rays of a packet a triangle of a fine mesh concerns.

A packet's beam is wide beside the triangles of a fine mesh: each of them is met by a few of its rays. So when a beam
has come upon many triangles that do not cover it, lines are drawn about each four rays, and a leaf's triangles are held
against these sixteen groups in float32 before any of them is decided (:mod:`tracer.rays.tile_beam`, where the padding
is derived, :mod:`tracer.rays.tile_leaf`).

Invariant: a group is left out only where none of its rays meets the triangle's box before its end.
"""

from typing import Any, Final

from tracer.jit import kernel
from tracer.rays.tile_beam import BEAM_BYTES, draw_lines, pad_of, survey_tile
from tracer.simd import stand_alone

GROUPS_BYTES: Final = BEAM_BYTES  # the groups' lines
EVERY_GROUP: Final = 0xFFFF
_LATE: Final = 2.0**-18  # depth, and room, by which a hit's t and its float32 can be off
_FARTHEST: Final = 64.0  # origin, frame units: beyond, float32 lines are too coarse
_COARSEST: Final = 2.0**-16  # slop
_SCALES: Final = 1e15  # float32 leaves are brought into the frame in float32 within these


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
    slop = 2.0**-46 * (1.0 + reach + centre)
    if not (reach <= _FARTHEST and slop <= _COARSEST and (size == 8 or 1.0 / _SCALES < scale < _SCALES)):
        return -1.0
    draw_lines(lines, breadth, pad_of(reach, breadth, slop), _LATE + slop)
    return float(2.0**-22 * (2.0 + centre))  # what a leaf's coordinates lose on their way into the frame
