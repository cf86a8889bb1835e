"""What all rays between four do with a triangle, told by the four: the corners of a beam.

For lines through one point the edge functions of a triangle, and its plane's inverse distance counted from that point,
are linear functions of the direction (before it is made unit); for parallel lines from a plane they and the distance
are linear in the origin. So what holds for the four corners of a beam, with room for rounding, holds for all between.
A beam's bounding lines (:mod:`tracer.rays.packet_cut`) are coarse beside that: a floor goes on behind a block, and its
outline surrounds the beam; a wall goes on beside the place that a ray leaves.

Invariant: a thing is said only where it holds by more than rounding can amount to. With Q the largest difference of
coordinates, a sheared one is off by less than 4 eps Q, an edge function by 20 eps Q**2, eps = 2**-53. And the rays
between are not quite there: with R the largest coordinate of an origin, or of the face that they start on, these are
off by less than 32 eps (Q + R), which moves an edge function by 256 eps (Q + R) Q. The predicate's own bound
(:data:`tracer.rays.predicate.CERTAIN`) is less.
"""

from typing import Any, Final

from tracer.jit import inline, kernel
from tracer.rays.packet_leaf import coordinate, sheared, stack_of_nine
from tracer.rays.predicate import TINY
from tracer.rays.rows import LIGHT, ORIGIN, ROW, SHEAR, T_BEST, VECTOR, WEIGHT_1, WEIGHT_2
from tracer.simd import absolute, all_lanes, load, maximum, select, splat, stand_alone
from tracer.simd.gateway import types

_int64: Final = types.int64

# Kinds of beams.
PENCIL: Final = 1  # lines through one point, WEIGHT_2 before the origins; T_BEST is where they end, on one plane
ENDING: Final = 2  # from a plane to one point, t = 1
PARALLEL: Final = 3  # from a plane, endless
APART: Final = 0  # answers: no ray meets it on its way
ACROSS: Final = 1  # all rays pass within its edges and, but for a pencil, on their way
UNSURE: Final = 2
_EDGE: Final = 2.0**-44  # of Q (Q + R): what an edge function is off, and room
_CLEAR: Final = 2.0**-30  # of the way, besides


@inline
def _signs(value: Any, off: Any) -> Any:
    """Return (whether four edge functions are negative for certain, whether positive)."""
    return all_lanes(value < -off), all_lanes(value > off)


@kernel
def judge_triangle(place: int, size: int, row: int, packet: int, axes: Any, kind: int) -> Any:
    """Tell what all rays between four do with a triangle.

    Parameters
    ----------
    place, size, row
        The triangle, as for :func:`tracer.rays.packet_leaf.meet_triangle`.
    packet
        Address of the rays, lanes 0 to 3; LIGHT holds the largest coordinate of what they start on.
    axes
        (kx, ky, kz).
    kind
        Of the beam.

    Returns
    -------
    int64
        `APART`, `ACROSS` or `UNSURE`.
    """
    stand_alone()
    c = stack_of_nine(place, size, row, axes[0], axes[1], axes[2])
    ax, ay, az, bx, by, bz, cx, cy, cz = sheared(c, packet, axes, False)
    shear_z = load(VECTOR, packet + SHEAR + 2 * ROW)
    ta, tb, tc = shear_z * az, shear_z * bz, shear_z * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    q = maximum(maximum(absolute(az), absolute(bz)), absolute(cz))
    q = maximum(q, maximum(maximum(absolute(ax), absolute(bx)), absolute(cx)))
    q = maximum(q, maximum(maximum(absolute(ay), absolute(by)), absolute(cy)))
    r = maximum(absolute(load(VECTOR, packet + ORIGIN)), load(VECTOR, packet + LIGHT))
    r = maximum(
        r, maximum(absolute(load(VECTOR, packet + ORIGIN + ROW)), absolute(load(VECTOR, packet + ORIGIN + 2 * ROW)))
    )
    edge = q * (q + r) * splat(VECTOR, _EDGE) + splat(VECTOR, TINY)
    u_down, u_up = _signs(u, edge)
    v_down, v_up = _signs(v, edge)
    w_down, w_up = _signs(w, edge)
    if (u_down or v_down or w_down) and (u_up or v_up or w_up):
        return _int64(APART)
    within = (u_down and v_down and w_down) or (u_up and v_up and w_up)
    total = (u + v) + w
    weighted = (u * ta + v * tb) + w * tc  # t times the total
    total_off = edge * splat(VECTOR, 4.0)
    weighted_off = edge * splat(VECTOR, 8.0) * (absolute(shear_z) * q)
    clear = splat(VECTOR, _CLEAR)
    zero = splat(VECTOR, 0.0)
    negative = total < zero
    total, weighted = absolute(total), select(negative, -weighted, weighted)
    if kind == PENCIL:
        before = load(VECTOR, packet + WEIGHT_2)
        end = load(VECTOR, packet + T_BEST) + before
        weighted_off = weighted_off + before * total_off
        weighted = weighted + before * total
        size_of = absolute(weighted)
        over = weighted - total * end
        over = select(weighted < zero, -over, over)  # the plane's inverse distance is less than the end's
        off = weighted_off + end * total_off + clear * size_of
        if all_lanes((size_of > weighted_off) & (over > off)):
            return _int64(APART)
        # where the point lies on the triangle's plane, rounding decides whether a ray meets it
        return _int64(ACROSS if within and all_lanes(size_of > weighted_off) else UNSURE)
    if kind == ENDING:
        past = weighted - total
        off = weighted_off + total_off + clear * total
        if all_lanes((weighted > off) & (past > off)) or all_lanes((weighted < -off) & (past < -off)):
            return _int64(APART)
        on_the_way = all_lanes((weighted > off) & (past < -off) & (total > total_off))
    else:
        off = weighted_off * splat(VECTOR, 4.0)
        if all_lanes((total > total_off) & (weighted < -off)):
            return _int64(APART)
        on_the_way = all_lanes((total > total_off) & (weighted > off + clear * total * q))
    return _int64(ACROSS if within and on_the_way else UNSURE)


@inline
def coincide(place: int, row: int, packet: int, size: int) -> bool:
    """Tell whether a triangle has the vertices of the one that SOLE has found: then the lower id counts."""
    other, other_row = load(_int64, packet + WEIGHT_1), load(_int64, packet + WEIGHT_1 + 8)
    same = True
    for k in range(9):
        same = same and coordinate(place + k * row, size) == coordinate(other + k * other_row, size)
    return same
