"""A tile's rays of one axis and sense through the wide tree together, or up to a bound of work.

The traversal is that of :mod:`tracer.rays.packet`, in float32: a node is visited when one of its boxes reaches between
the lines that bound the rays. Where triangles are smaller than the gaps between rays, most of a leaf's triangles are
met by none of them, and single rays are faster: after so much work the tile is given up, and its rays travel alone.

Invariants: a ray's answer does not depend on the others, nor on whether it travels alone. A node is left out only if
no ray of the tile can find anything in it.
"""

from typing import Any, Final

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
from tracer.rays.children import push_children
from tracer.rays.leaf import leaf_of
from tracer.rays.packet_leaf import FOUND_BYTES
from tracer.rays.rows import AXIS, axes_of
from tracer.rays.start import ROOT
from tracer.rays.tile_beam import (
    BEAM_BYTES,
    BEGINS,
    ENDS,
    LATE,
    LINE,
    X_HIGH,
    X_LOW,
    Y_HIGH,
    Y_LOW,
    draw_lines,
    greatest_of,
    groups_of,
    is_resolved,
    leaf_pad,
    least_of,
    pad_of,
    slop_of,
    survey_tile,
    whole_line,
)
from tracer.rays.tile_leaf import BOXES_BYTES, box_triangles, groups_that_reach, meet, word_of
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

_STACK_BYTES: Final = 8 * STACK_ENTRIES
_NEAR_BYTES: Final = 32
_THINNEST: Final = 2.0**-10  # depth over which the lines are drawn at least

# What is counted as work, in units of one vector of rays against one triangle
_NODE: Final = 2
_TRIANGLE: Final = 2


@inline
def _spread(value: float) -> Any:
    return splat(float32x8, _float32(value))


@kernel
def trace_tile(base: int, tile: int, active: int, closest: int, budget: int) -> Any:
    """Follow the active rays of a tile, all of one AXIS.

    Parameters
    ----------
    base
        Address of the tree.
    tile
        Address of the rays (:mod:`tracer.rays.tile`).
    active
        Set of rays, not empty.
    closest
        1: T_BEST, PRIMITIVE and the weights of the nearest hits are written. 0: nothing is.
    budget
        Work after which the tile is given up.

    Returns
    -------
    tuple of int64
        The rays that met something (0 for closest), and those that must travel alone: then what was written of them
        is not their answer.
    """
    stand_alone()
    axis = load(_int64, tile + AXIS + 8 * count_trailing_zeros(active))
    kx, ky, kz = axes = axes_of(axis)
    sign = -1.0 if axis & 1 else 1.0
    scale = load(_float64, base + 8 * FRAME_SCALE)
    cx = load(_float64, base + 8 * FRAME_CENTRE + 8 * kx)
    cy = load(_float64, base + 8 * FRAME_CENTRE + 8 * ky)
    cz = load(_float64, base + 8 * FRAME_CENTRE + 8 * kz)
    half = load(_float64, base + 8 * FRAME_HALF + 8 * kz)
    frame = (cx, cy, cz, scale, sign)
    size = _int64(8 if load(_int64, base + 8 * HEADER_WIDE_LEAVES) else 4)
    if half < 0.0:  # an empty tree
        return _int64(0), _int64(0)
    breadth = max(half, _THINNEST)
    beam = stack_memory(BEAM_BYTES)
    reach = survey_tile(tile, active, axes, frame, breadth, beam)
    centre = max(abs(cx), abs(cy), abs(cz)) * scale
    slop = slop_of(reach, centre)
    if not is_resolved(reach, slop, size, scale):
        return _int64(0), active
    room = LATE + slop
    first_depth = _float32(max(least_of(beam + BEGINS), -half) - room)
    last_depth = min(greatest_of(beam + ENDS), _float32(half)) + _float32(room)
    if first_depth > last_depth:
        return _int64(0), _int64(0)
    pad = pad_of(reach, breadth, slop)
    xl, xl_slope = whole_line(least_of(beam + X_LOW), least_of(beam + X_LOW + LINE), breadth)
    xh, xh_slope = whole_line(greatest_of(beam + X_HIGH), greatest_of(beam + X_HIGH + LINE), breadth)
    yl, yl_slope = whole_line(least_of(beam + Y_LOW), least_of(beam + Y_LOW + LINE), breadth)
    yh, yh_slope = whole_line(greatest_of(beam + Y_HIGH), greatest_of(beam + Y_HIGH + LINE), breadth)
    draw_lines(beam, breadth, pad, room)
    # each slope split by sign: rising parts count at one end of a box, falling ones at the other
    nothing = _float32(0.0)
    xl_up, xl_down, xl = _spread(max(xl_slope, nothing)), _spread(min(xl_slope, nothing)), _spread(xl - pad)
    xh_up, xh_down, xh = _spread(max(xh_slope, nothing)), _spread(min(xh_slope, nothing)), _spread(xh + pad)
    yl_up, yl_down, yl = _spread(max(yl_slope, nothing)), _spread(min(yl_slope, nothing)), _spread(yl - pad)
    yh_up, yh_down, yh = _spread(max(yh_slope, nothing)), _spread(min(yh_slope, nothing)), _spread(yh + pad)
    nearest, farthest, flip = _spread(first_depth), _spread(last_depth), _spread(sign)
    x_row, y_row = 32 * kx, 32 * ky
    near_row = 32 * kz + (NODE_HIGH if axis & 1 else 0)
    far_row = 32 * kz + (0 if axis & 1 else NODE_HIGH)
    outward = leaf_pad(centre)
    stack = stack_memory(_STACK_BYTES)
    near = stack_memory(_NEAR_BYTES)
    boxes = stack_memory(BOXES_BYTES)
    found = stack_memory(FOUND_BYTES)
    groups = groups_of(active)
    ended = _int64(0)
    work = _int64(0)
    top = stack
    word = _int64(ROOT)
    limit = to_bits(last_depth - first_depth)
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
            top = push_children(_int64(0), hits, near, children, top) - 8
            word = _int64(_int32(load(_int64, top)))
        if word < 0:
            leaf, n = leaf_of(base, word)
            x0, x1, y0, y1, z0, z1 = box_triangles(leaf, n, size, axes, frame, outward, boxes)
            enter, leave = maximum(z0, nearest), minimum(z1, farthest)
            inside = (enter <= leave) & (x0 <= multiply_add(xh_up, leave, multiply_add(xh_down, enter, xh)))
            inside = inside & (x1 >= multiply_add(xl_up, enter, multiply_add(xl_down, leave, xl)))
            inside = inside & (y0 <= multiply_add(yh_up, leave, multiply_add(yh_down, enter, yh)))
            inside = inside & (y1 >= multiply_add(yl_up, enter, multiply_add(yl_down, leave, yl)))
            candidates = mask_to_bits(inside) & ((_int64(1) << n) - 1)
            work += _NODE
            changed = _int64(0)
            while candidates != 0:
                k = count_trailing_zeros(candidates)
                candidates &= candidates - 1
                reached = groups_that_reach(beam, boxes + 4 * k) & groups
                work += _TRIANGLE + population_count(reached)
                if reached == 0:
                    continue
                triangle = (leaf + k * size, size, n * size, word_of(leaf, n, size, k))
                met = meet(triangle, tile, active, reached, axes, frame, closest, beam, room, found)
                changed |= met
                if closest == 0 and met != 0:
                    ended |= met
                    active &= ~met
                    groups = groups_of(active)
            if work > budget:
                return ended, active
            if changed != 0:
                if active == 0:
                    return ended, _int64(0)
                if closest != 0:
                    last_depth = min(last_depth, greatest_of(beam + ENDS))
                    farthest = _spread(last_depth)
                    limit = to_bits(max(last_depth - first_depth, nothing))
        while True:
            if top == stack:
                return ended, _int64(0)
            top -= 8
            entry = load(_int64, top)
            if (entry >> 32) <= limit:
                break
        word = _int64(_int32(entry))
