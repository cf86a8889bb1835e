"""Packets: up to 64 rays of one dominant axis and sense through the wide tree together.

The rays' hull is a beam. Along the dominant axis, counted in the sense of travel (the *depth*), each ray is a straight
line x(depth), y(depth) with slopes of at most 1 in size; the least of them is concave in the depth and the greatest
convex, so the chord between two depths bounds all rays between these. A node is visited when one of its boxes, cut to
the depths at which a ray can still find something, reaches between the four chords: 8 boxes at once, in float32,
padded by what its rounding and the predicate's can amount to (:mod:`tracer.rays.state` counts the same). Leaves are
float64 and exact (:mod:`tracer.rays.packet_leaf`).

Invariants: a ray's answer does not depend on the others of its packet, nor on whether it travels in one: the least
(t, id) of all triangles it meets. A node is left out only if no ray of the packet can find anything in it.

Sources: Reshetov, Soupikov and Hurley 2005 (beams of rays); Boulos, Wald and Benthin 2008 (interval culling).
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS
from tracer.accel.layout import (
    FRAME_CENTRE,
    FRAME_HALF,
    FRAME_SCALE,
    HEADER_WIDE_LEAVES,
    NODE_CHILDREN,
    NODE_HIGH,
    STACK_ENTRIES,
    UNIT,
)
from tracer.jit import inline, kernel
from tracer.rays import packet_corners
from tracer.rays.beam import (
    BEAM_CENTRE,
    BEAM_FIRST,
    BEAM_HALF,
    BEAM_LAST,
    BEAM_MEMORY,
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
    BEGIN,
    EXTREMES_X,
    EXTREMES_Y,
    FIRST_END,
    LAST_BEGIN,
    LAST_END,
    LATE,
    REACH,
    chords,
    deepest_end,
    survey,
    survey_pencil,
)
from tracer.rays.children import push_children
from tracer.rays.leaf import ANY, CLOSEST, SHADE, leaf_of
from tracer.rays.packet_corners import ACROSS, APART, coincide, judge_triangle
from tracer.rays.packet_cut import cut_leaf
from tracer.rays.packet_leaf import FOUND_BYTES, meet_triangle, meet_within
from tracer.rays.packet_shade import LIGHT_BYTES, dim, keep_light, lets_nothing_through, restore_light
from tracer.rays.rows import (
    AXIS,
    INTEGERS,
    LANES,
    SKIP,
    STEP,
    VECTORS,
    WEIGHT_1,
    axes_of,
)
from tracer.rays.sift import EVERY_GROUP, GROUPS_BYTES, draw_groups
from tracer.rays.start import ROOT
from tracer.rays.tile_beam import groups_of
from tracer.rays.tile_leaf import BOXES_BYTES, box_triangles, groups_that_reach
from tracer.simd import (
    count_trailing_zeros,
    float32x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    population_count,
    splat,
    stack_memory,
    stand_alone,
    store,
    to_bits,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

SOLE: Final = 4  # what do all rays between four meet? PENCIL, ENDING or PARALLEL is added
# Added to a mode: what is known of the rays.
FROM_POINT: Final = 16  # one origin, and no end
TO_POINT: Final = 32  # what they end in is one point
PENCIL: Final = packet_corners.PENCIL << 6  # for SOLE: what beam the four rays 0 to 3 are the corners of
ENDING: Final = packet_corners.ENDING << 6
PARALLEL: Final = packet_corners.PARALLEL << 6
UNLIMITED: Final = 2**62  # a budget
NONE: Final = -1  # answers of SOLE: no triangle
SEVERAL: Final = -2  # more than one, or one at the edge

MODES: Final = 15
_KIND_BITS: Final = 6
_TINIEST: Final = 2.0**200  # of scales: beyond, CERTAIN's TINY counts
_STACK_BYTES: Final = 8 * STACK_ENTRIES
_NEAR_BYTES: Final = 32
_NODE: Final = 1  # of what is counted as work
_LEAF: Final = 2
_TRIANGLE: Final = 4
_TRIES: Final = 4  # triangles at the beam's edge, from which it pays to look at each four rays apart
_ROUNDING: Final = 2.0**-21  # of float32 slopes, starts and products, and room
_THINNEST: Final = 2.0**-10  # depth over which the chords are drawn at least


@inline
def _spread(value: float) -> Any:
    return splat(float32x8, _float32(value))


@inline
def _skips(packet: int, active: int, primitive: int) -> Any:
    """Return the active rays that skip a primitive."""
    same = _int64(0)
    wanted = splat(INTEGERS, primitive)
    for i in range(VECTORS):
        same |= mask_to_bits(load(INTEGERS, packet + SKIP + STEP * i) == wanted) << (LANES * i)
    return same & active


@kernel
def trace_packet(
    base: int, packet: int, active: int, mode: int, kt: int, face_material: int, stride: int, budget: int
) -> Any:
    """Follow the active rays of a packet, all of one AXIS.

    Parameters
    ----------
    base
        Address of the tree.
    packet
        Address of the rays (:mod:`tracer.rays.rows`): ORIGIN, SHEAR, SPEED, AXIS, T_BEST and SKIP are set; for CLOSEST
        PRIMITIVE is -1 too, for SHADE LIGHT is 1 and LIGHT_REST 0.
    active
        Set of rays, not empty.
    mode
        One of the following, plus FROM_POINT or TO_POINT where it is true of all active rays. CLOSEST: T_BEST,
        PRIMITIVE and the weights of the nearest hits are written. ANY: nothing is. SHADE: LIGHT is multiplied by kt of
        every triangle that is met within the ray's end. SOLE: what holds for any ray between
        rays 0 to 3, the corners of a PENCIL, or of shadow rays ENDING in a point or PARALLEL; for a pencil WEIGHT_1
        holds (int64) the triangle's address in its leaf, the bytes of a row of that leaf, and its word there.
    kt, face_material, stride
        For SHADE and shadow rays of SOLE: address of the first material's kt, of the faces' materials (int32), and
        bytes from material to material.
    budget
        Work after which the packet is given up; or `UNLIMITED`, always for SOLE.

    Returns
    -------
    tuple of int64
        First the rays that met something (ANY), or have no light left (SHADE); 0 for CLOSEST. For SOLE the id of
        the one triangle that all of a pencil meet, or of an opaque one that all shadow rays meet; `NONE`: nobody meets
        anything; `SEVERAL`: it is not that simple. Second the rays that must travel alone; CLOSEST has left them with
        the nearest hit so far, SHADE with their light as it was.
    """
    stand_alone()
    nobody = _int64(0)
    if load(_float64, base + 8 * FRAME_HALF) < 0.0:  # an empty tree
        return _int64(NONE if mode & MODES == SOLE else 0), nobody
    axis = load(_int64, packet + AXIS + 8 * count_trailing_zeros(active))
    kx, ky, kz = axes = axes_of(axis)
    sign = -1.0 if axis & 1 else 1.0
    scale = load(_float64, base + 8 * FRAME_SCALE)
    cx = load(_float64, base + 8 * FRAME_CENTRE + 8 * kx)
    cy = load(_float64, base + 8 * FRAME_CENTRE + 8 * ky)
    cz = load(_float64, base + 8 * FRAME_CENTRE + 8 * kz)
    half = load(_float64, base + 8 * FRAME_HALF + 8 * kz)
    frame = (cx, cy, cz, scale, sign)
    breadth = max(half, _THINNEST)
    beam = stack_memory(BEAM_MEMORY)
    one_origin = mode & FROM_POINT != 0
    surveyed = False
    if one_origin:
        surveyed = survey_pencil(packet, active, axes, frame, breadth, beam, False)
    elif mode & TO_POINT:
        surveyed = survey_pencil(packet, active, axes, frame, breadth, beam, True)
    if not surveyed:
        survey(packet, active, axes, frame, breadth, beam)
    kind = mode >> _KIND_BITS
    mode &= MODES
    believed = _int64(-1 if scale < _TINIEST else 0)  # where weights may underflow, no triangle is met for certain
    # what float64 does not resolve of coordinates so far out, in frame units
    centre = max(abs(cx), abs(cy), abs(cz)) * scale
    slop = 2.0**-46 * (1.0 + load(_float64, beam + REACH) + centre)
    first_depth = max(load(_float64, beam + BEGIN), -half) - slop
    last_depth = min(load(_float64, beam + LAST_END) + LATE, half) + slop
    if first_depth > last_depth:
        return _int64(NONE if mode == SOLE else 0), nobody
    x_low, x_low_start, x_high, x_high_start = chords(beam + EXTREMES_X, breadth, slop)
    y_low, y_low_start, y_high, y_high_start = chords(beam + EXTREMES_Y, breadth, slop)
    store(beam + BEAM_CENTRE, cx)
    store(beam + BEAM_CENTRE + 8, cy)
    store(beam + BEAM_CENTRE + 16, cz)
    store(beam + BEAM_SCALE, scale)
    store(beam + BEAM_SIGN, sign)
    store(beam + BEAM_HALF, breadth)
    store(beam + BEAM_FIRST, first_depth - slop)
    store(beam + BEAM_LAST, last_depth + slop)
    # what lies between these is met by all or by none
    store(beam + BEAM_SURE_FIRST, load(_float64, beam + LAST_BEGIN) + slop)
    store(beam + BEAM_SURE_LAST, load(_float64, beam + FIRST_END) - LATE - slop)
    store(beam + BEAM_X_SLOPE, 0.5 * (x_low + x_high))
    store(beam + BEAM_X_START, 0.5 * (x_low_start + x_high_start))
    store(beam + BEAM_X_SPREAD, 0.5 * (x_high - x_low))
    store(beam + BEAM_X_WIDTH, 0.5 * (x_high_start - x_low_start) + slop)
    store(beam + BEAM_Y_SLOPE, 0.5 * (y_low + y_high))
    store(beam + BEAM_Y_START, 0.5 * (y_low_start + y_high_start))
    store(beam + BEAM_Y_SPREAD, 0.5 * (y_high - y_low))
    store(beam + BEAM_Y_WIDTH, 0.5 * (y_high_start - y_low_start) + slop)
    skip = load(_int64, packet + SKIP + 8 * count_trailing_zeros(active))
    alike = _skips(packet, active, skip) == active
    # the lines in float32, each slope split by sign: rising parts count at one end of a box, falling ones at the other
    deepest = breadth + slop
    pad = _ROUNDING * (abs(x_low_start) + abs(x_low) * deepest) + slop
    xl_up, xl_down, xl = _spread(max(x_low, 0.0)), _spread(min(x_low, 0.0)), _spread(x_low_start - pad)
    pad = _ROUNDING * (abs(x_high_start) + abs(x_high) * deepest) + slop
    xh_up, xh_down, xh = _spread(max(x_high, 0.0)), _spread(min(x_high, 0.0)), _spread(x_high_start + pad)
    pad = _ROUNDING * (abs(y_low_start) + abs(y_low) * deepest) + slop
    yl_up, yl_down, yl = _spread(max(y_low, 0.0)), _spread(min(y_low, 0.0)), _spread(y_low_start - pad)
    pad = _ROUNDING * (abs(y_high_start) + abs(y_high) * deepest) + slop
    yh_up, yh_down, yh = _spread(max(y_high, 0.0)), _spread(min(y_high, 0.0)), _spread(y_high_start + pad)
    nearest = _spread(first_depth - _ROUNDING * abs(first_depth))
    farthest_depth = last_depth + _ROUNDING * abs(last_depth)
    farthest = _spread(farthest_depth)
    flip = _spread(sign)
    x_row, y_row = 32 * kx, 32 * ky
    near_row = 32 * kz + (NODE_HIGH if axis & 1 else 0)
    far_row = 32 * kz + (0 if axis & 1 else NODE_HIGH)
    size = _int64(8 if load(_int64, base + 8 * HEADER_WIDE_LEAVES) else 4)
    stack = stack_memory(_STACK_BYTES)
    near, found, light = stack_memory(_NEAR_BYTES), stack_memory(FOUND_BYTES), stack_memory(LIGHT_BYTES)
    lines, boxes = stack_memory(GROUPS_BYTES), stack_memory(BOXES_BYTES)
    tries, room = _int64(0), -1.0
    work = dimmed = nobody
    alive = groups_of(active)
    ended = _int64(NONE if mode == SOLE else 0)
    closest = _int64(1 if mode == CLOSEST else 0)
    top = stack
    word = _int64(ROOT)
    limit = to_bits(_float32(farthest_depth - first_depth) * _float32(1.000001))
    while True:
        while word >= 0:
            work += _NODE
            node = base + word * (UNIT // 8)
            enter = maximum(load(float32x8, node + near_row) * flip, nearest)
            leave = minimum(load(float32x8, node + far_row) * flip, farthest)
            least_x = multiply_add(xl_up, enter, multiply_add(xl_down, leave, xl))
            most_x = multiply_add(xh_up, leave, multiply_add(xh_down, enter, xh))
            least_y = multiply_add(yl_up, enter, multiply_add(yl_down, leave, yl))
            most_y = multiply_add(yh_up, leave, multiply_add(yh_down, enter, yh))
            inside = (enter <= leave) & (load(float32x8, node + x_row) <= most_x)
            inside = inside & (load(float32x8, node + NODE_HIGH + x_row) >= least_x)
            inside = inside & (load(float32x8, node + y_row) <= most_y)
            inside = inside & (load(float32x8, node + NODE_HIGH + y_row) >= least_y)
            hits = mask_to_bits(inside)
            if hits == 0:
                break
            children = node + NODE_CHILDREN
            if hits & (hits - 1) == 0:
                word = _int64(load(_int32, children + 4 * count_trailing_zeros(hits)))
                continue
            store(near, enter - nearest)
            top = push_children(base, hits, near, children, top) - 8
            word = _int64(_int32(load(_int64, top)))
        if word < 0:
            leaf, n = leaf_of(base, word)
            row = n * size
            ids = leaf + 9 * row
            work += _LEAF
            changed = _int64(0)
            by_groups = room >= 0.0
            if by_groups:
                x0, x1, y0, y1, z0, z1 = box_triangles(leaf, n, size, axes, frame, room, boxes)
                enter, leave = maximum(z0, nearest), minimum(z1, farthest)
                reach = (enter <= leave) & (x0 <= multiply_add(xh_up, leave, multiply_add(xh_down, enter, xh)))
                reach = reach & (x1 >= multiply_add(xl_up, enter, multiply_add(xl_down, leave, xl)))
                reach = reach & (y0 <= multiply_add(yh_up, leave, multiply_add(yh_down, enter, yh)))
                reach = reach & (y1 >= multiply_add(yl_up, enter, multiply_add(yl_down, leave, yl)))
                candidates = mask_to_bits(reach) & ((_int64(1) << n) - 1)
                inside = covers = _int64(0)
            else:
                candidates, inside, on_the_way = cut_leaf(leaf, n, size, axes, beam)
                inside &= believed
                covers = inside & on_the_way
                at_edge = candidates & ~inside
                if at_edge != 0 and mode != SOLE and tries < _TRIES:
                    tries += population_count(at_edge)
                    if tries >= _TRIES:  # a mesh finer than the beam: from the next leaf on by groups
                        room = draw_groups(packet, active, size, axes, frame, breadth, lines)
            while candidates != 0:
                k = count_trailing_zeros(candidates)
                candidates &= candidates - 1
                face = _int64(load(_int32, ids + 4 * k))
                if alike and face >> ORDER_BITS == skip:  # all of them start on it
                    continue
                if mode == SOLE:
                    place = leaf + k * size
                    verdict = judge_triangle(place, size, row, packet, axes, kind)
                    if verdict == APART:
                        continue
                    if kind != packet_corners.PENCIL:  # what darkens all needs not be alone
                        material = kt + stride * _int64(load(_int32, face_material + 4 * (face >> ORDER_BITS)))
                        if verdict == ACROSS and lets_nothing_through(material):
                            return face >> ORDER_BITS, nobody
                        ended = _int64(SEVERAL)
                        tries += 1
                        if tries > _TRIES:
                            return ended, nobody
                        continue
                    if verdict != ACROSS or (ended != NONE and not coincide(place, row, packet, size)):
                        return _int64(SEVERAL), nobody
                    if ended == NONE or face >> ORDER_BITS < ended:
                        ended = face >> ORDER_BITS
                        store(packet + WEIGHT_1, place)
                        store(packet + WEIGHT_1 + 8, row)
                        store(packet + WEIGHT_1 + 16, face)
                    continue
                if mode != CLOSEST and alike and (covers >> k) & 1:
                    met = active
                elif mode == CLOSEST and alike and (inside >> k) & 1:
                    met = meet_within(leaf + k * size, size, row, face, packet, active, axes, one_origin)
                else:
                    groups = _int64(EVERY_GROUP)
                    if by_groups:
                        groups = groups_that_reach(lines, boxes + 4 * k) & alive
                        if groups == 0:
                            continue
                    work += _TRIANGLE
                    met = meet_triangle(
                        leaf + k * size,
                        size,
                        row,
                        face,
                        packet,
                        active,
                        groups,
                        axes,
                        closest,
                        alike,
                        one_origin,
                        found,
                    )
                changed |= met
                if mode == ANY:
                    ended |= met
                    active &= ~met
                    alive = groups_of(active)
                elif mode == SHADE and met != 0:
                    material = kt + stride * _int64(load(_int32, face_material + 4 * (face >> ORDER_BITS)))
                    if dimmed == 0:
                        keep_light(packet, light)
                    dimmed |= met
                    dark = dim(packet, met, material)
                    ended |= dark
                    active &= ~dark
                    alive = groups_of(active)
            if active == 0:
                return ended, nobody
            if work > budget:
                if dimmed & active != 0:
                    restore_light(packet, light, active)
                return ended, active
            if changed != 0 and mode == CLOSEST:
                farthest_depth = min(farthest_depth, deepest_end(packet, active, kz, frame) + slop + LATE)
                farthest_depth += _ROUNDING * abs(farthest_depth)
                farthest = _spread(farthest_depth)
                store(beam + BEAM_LAST, farthest_depth)
                limit = to_bits(max(_float32(farthest_depth - first_depth) * _float32(1.000001), _float32(0.0)))
        while True:
            if top == stack:
                return ended, nobody
            top -= 8
            entry = load(_int64, top)
            if (entry >> 32) <= limit:
                break
        word = _int64(_int32(entry))
