"""A leaf against a packet's beam: its triangles side by side, before any of them meets a ray.

The beam's middle line with a half width meets each vertex; a triangle is left out when no ray of the beam can have it
between its edges.

Invariant: what is said to lie within the edges of a triangle does so by more than the predicate's bound, so that every
ray of the beam takes the predicate's rounded branch (:mod:`tracer.rays.predicate`).
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.beam import (
    BEAM_CENTRE,
    BEAM_FIRST,
    BEAM_HALF,
    BEAM_LAST,
    BEAM_SCALE,
    BEAM_SIGN,
    BEAM_SURE_FIRST,
    BEAM_SURE_LAST,
    BEAM_X_SLOPE,
    BEAM_X_SPREAD,
    BEAM_X_START,
    BEAM_X_WIDTH,
    BEAM_Y_SLOPE,
    BEAM_Y_SPREAD,
    BEAM_Y_START,
    BEAM_Y_WIDTH,
)
from tracer.rays.predicate import CERTAIN
from tracer.rays.rows import LANES, VECTOR
from tracer.simd import absolute, load, load_as_float64, mask_to_bits, maximum, minimum, splat
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int64: Final = types.int64


@inline
def _spread(address: int) -> Any:
    return splat(VECTOR, load(_float64, address))


@inline
def _from_beam(beam: int, x: Any, y: Any, z: Any) -> Any:
    """Vertices in frame units relative to the middle line: (x, y, half widths in x and y, depth)."""
    scale = _spread(beam + BEAM_SCALE)
    depth = (z - _spread(beam + BEAM_CENTRE + 16)) * scale * _spread(beam + BEAM_SIGN)
    x = (x - _spread(beam + BEAM_CENTRE)) * scale
    y = (y - _spread(beam + BEAM_CENTRE + 8)) * scale
    x = x - (_spread(beam + BEAM_X_SLOPE) * depth + _spread(beam + BEAM_X_START))
    y = y - (_spread(beam + BEAM_Y_SLOPE) * depth + _spread(beam + BEAM_Y_START))
    width = _spread(beam + BEAM_X_SPREAD) * depth + _spread(beam + BEAM_X_WIDTH)
    height = _spread(beam + BEAM_Y_SPREAD) * depth + _spread(beam + BEAM_Y_WIDTH)
    return x, y, width, height, depth


@inline
def _cut_by_beam(rows: Any, place: int, row: int, kx: int, ky: int, kz: int, beam: int) -> Any:
    """Bits of the four triangles at ``place``: some ray may meet it; all lines pass within its edges; on their way."""
    at_x, at_y, at_z = place + kx * row, place + ky * row, place + kz * row
    step = 3 * row
    ax, ay, aw, ah, az = _from_beam(
        beam,
        load_as_float64(VECTOR, rows, at_x),
        load_as_float64(VECTOR, rows, at_y),
        load_as_float64(VECTOR, rows, at_z),
    )
    at_x, at_y, at_z = at_x + step, at_y + step, at_z + step
    bx, by, bw, bh, bz = _from_beam(
        beam,
        load_as_float64(VECTOR, rows, at_x),
        load_as_float64(VECTOR, rows, at_y),
        load_as_float64(VECTOR, rows, at_z),
    )
    at_x, at_y, at_z = at_x + step, at_y + step, at_z + step
    cx, cy, cw, ch, cz = _from_beam(
        beam,
        load_as_float64(VECTOR, rows, at_x),
        load_as_float64(VECTOR, rows, at_y),
        load_as_float64(VECTOR, rows, at_z),
    )
    nearest, farthest = minimum(az, minimum(bz, cz)), maximum(az, maximum(bz, cz))
    half = _spread(beam + BEAM_HALF)
    known = (nearest >= -half) & (farthest <= half)
    w = maximum(aw, maximum(bw, cw))
    h = maximum(ah, maximum(bh, ch))
    # all vertices on one side of the beam
    out = (minimum(ax, minimum(bx, cx)) > w) | (maximum(ax, maximum(bx, cx)) < -w)
    out = out | (minimum(ay, minimum(by, cy)) > h) | (maximum(ay, maximum(by, cy)) < -h)
    # edge functions of the middle line, and how far those of other rays can be from it
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    s = bx * ay - by * ax
    xa, ya, xb, yb, xc, yc = absolute(ax), absolute(ay), absolute(bx), absolute(by), absolute(cx), absolute(cy)
    both = (w * h) * splat(VECTOR, 2.0001)
    u_off = ((yb + yc) * w + (xb + xc) * h) * splat(VECTOR, 1.0001) + both
    v_off = ((yc + ya) * w + (xc + xa) * h) * splat(VECTOR, 1.0001) + both
    s_off = ((ya + yb) * w + (xa + xb) * h) * splat(VECTOR, 1.0001) + both
    negative = (u < -u_off) | (v < -v_off) | (s < -s_off)
    positive = (u > u_off) | (v > v_off) | (s > s_off)
    out = (out | (negative & positive)) & known
    out = out | (farthest < _spread(beam + BEAM_FIRST)) | (nearest > _spread(beam + BEAM_LAST))
    # within the edges by so much that the predicate is certain, too: its bound counts the farthest vertex for each edge
    reach = maximum(maximum(maximum(xa, ya), maximum(xb, yb)), maximum(xc, yc)) + (w + h)
    sure = reach * reach * splat(VECTOR, 4.0 * CERTAIN)
    u_off, v_off, s_off = u_off + sure, v_off + sure, s_off + sure
    inside = ((u > u_off) & (v > v_off) & (s > s_off)) | ((u < -u_off) & (v < -v_off) & (s < -s_off))
    on_the_way = (nearest > _spread(beam + BEAM_SURE_FIRST)) & (farthest < _spread(beam + BEAM_SURE_LAST))
    return mask_to_bits(~out), mask_to_bits(inside & known), mask_to_bits(on_the_way)


@inline
def cut_leaf(leaf: int, n: int, size: int, axes: Any, beam: int) -> Any:
    """Sort a leaf's triangles by what the beam tells.

    Returns
    -------
    tuple of int64
        Bits of those that some ray may meet, of those between whose edges all rays' lines pass for certain, and of
        those all of which lies beyond every ray's origin and before every ray's end.
    """
    kx, ky, kz = axes
    row = n * size
    bits, inside, on_the_way = _int64(0), _int64(0), _int64(0)
    for first in range(0, n, LANES):
        place = leaf + first * size
        if size == 8:
            some, every, between = _cut_by_beam(_float64, place, row, kx, ky, kz, beam)
        else:
            some, every, between = _cut_by_beam(_float32, place, row, kx, ky, kz, beam)
        bits |= some << first
        inside |= every << first
        on_the_way |= between << first
    return bits & ((_int64(1) << n) - 1), inside, on_the_way
