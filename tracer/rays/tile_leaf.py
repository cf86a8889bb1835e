"""A leaf against a tile: which triangles may be met by which four rays, then these four rays exactly.

A triangle's box is held against the lines of sixteen groups of four rays in float32; most triangles of a fine mesh
are left to three to five of them. What is left is decided four rays at a time.

Invariant: as :mod:`tracer.rays.packet_leaf`: a lane is accepted only where the predicate would take its rounded
branch, by the same floats in the same order; lanes that are not certain go to the scalar predicate itself.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.jit import inline
from tracer.rays.packet_leaf import decide_lanes, stack_of_nine
from tracer.rays.predicate import CERTAIN, TINY, weigh
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    ROW,
    SHEAR,
    STEP,
    T_BEST,
    VECTOR,
    WEIGHT_1,
    WEIGHT_2,
    blend,
    mask_of,
)
from tracer.rays.tile import LANE_MASKS, T_MIN, WEIGHTS
from tracer.rays.tile_beam import BEGINS, ENDS, LINE, X_HIGH, X_LOW, Y_HIGH, Y_LOW, deepest_of
from tracer.simd import (
    absolute,
    convert,
    count_trailing_zeros,
    float32x8,
    float64x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    splat,
    store,
    unlikely,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_int32: Final = types.int32
_int64: Final = types.int64

BOXES_BYTES: Final = 6 * 32  # least and greatest x, y, depth of eight triangles


@inline
def _in_frame(at: int, row: int, size: int, centre: float, scale: float) -> Any:
    """Least and greatest of one coordinate of eight triangles, frame units, not rounded outward."""
    if size == 8:
        middle, s = splat(float64x8, centre), splat(float64x8, scale)
        a = convert(_float32, (load(float64x8, at) - middle) * s)
        b = convert(_float32, (load(float64x8, at + 3 * row) - middle) * s)
        c = convert(_float32, (load(float64x8, at + 6 * row) - middle) * s)
        return minimum(a, minimum(b, c)), maximum(a, maximum(b, c))
    a, b, c = load(float32x8, at), load(float32x8, at + 3 * row), load(float32x8, at + 6 * row)
    s, shift = splat(float32x8, _float32(scale)), splat(float32x8, _float32(-centre * scale))
    return multiply_add(minimum(a, minimum(b, c)), s, shift), multiply_add(maximum(a, maximum(b, c)), s, shift)


@inline
def box_triangles(leaf: int, n: int, size: int, axes: Any, frame: Any, room: float, boxes: int) -> Any:
    """Write the boxes of a leaf's triangles to ``boxes``, each side ``room`` farther out; returns them."""
    kx, ky, kz = axes
    cx, cy, cz, scale, sign = frame
    row = n * size
    off = splat(float32x8, _float32(room))
    x0, x1 = _in_frame(leaf + kx * row, row, size, cx, scale)
    y0, y1 = _in_frame(leaf + ky * row, row, size, cy, scale)
    z0, z1 = _in_frame(leaf + kz * row, row, size, cz, scale)
    x0, x1, y0, y1 = x0 - off, x1 + off, y0 - off, y1 + off
    z0, z1 = (-z1 - off, -z0 + off) if sign < 0.0 else (z0 - off, z1 + off)
    store(boxes, x0)
    store(boxes + 32, x1)
    store(boxes + 64, y0)
    store(boxes + 96, y1)
    store(boxes + 128, z0)
    store(boxes + 160, z1)
    return x0, x1, y0, y1, z0, z1


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _groups_at(beam: int, box: int) -> Any:
    """Bits of eight groups, from address ``beam`` on, some ray of which may meet a box."""
    x0, x1, y0, y1 = _spread(box), _spread(box + 32), _spread(box + 64), _spread(box + 96)
    enter = maximum(_spread(box + 128), load(float32x8, beam + BEGINS))
    leave = minimum(_spread(box + 160), load(float32x8, beam + ENDS))
    start, slope = load(float32x8, beam + X_LOW), load(float32x8, beam + X_LOW + LINE)
    reached = minimum(multiply_add(slope, enter, start), multiply_add(slope, leave, start)) <= x1
    start, slope = load(float32x8, beam + X_HIGH), load(float32x8, beam + X_HIGH + LINE)
    reached = reached & (maximum(multiply_add(slope, enter, start), multiply_add(slope, leave, start)) >= x0)
    start, slope = load(float32x8, beam + Y_LOW), load(float32x8, beam + Y_LOW + LINE)
    reached = reached & (minimum(multiply_add(slope, enter, start), multiply_add(slope, leave, start)) <= y1)
    start, slope = load(float32x8, beam + Y_HIGH), load(float32x8, beam + Y_HIGH + LINE)
    reached = reached & (maximum(multiply_add(slope, enter, start), multiply_add(slope, leave, start)) >= y0)
    return mask_to_bits(reached & (enter <= leave))


@inline
def groups_that_reach(beam: int, box: int) -> Any:
    """Bits of the sixteen groups, some ray of which may meet a triangle.

    Parameters
    ----------
    beam
        Address of the lines.
    box
        Address of the triangle's first value in what `box_triangles` wrote.
    """
    return _groups_at(beam, box) | (_groups_at(beam + 32, box) << 8)


@inline
def meet(
    triangle: Any,
    tile: int,
    active: int,
    groups: int,
    axes: Any,
    frame: Any,
    closest: int,
    beam: int,
    room: float,
    found: int,
) -> Any:
    """Decide a triangle for the active rays of some groups.

    Parameters
    ----------
    triangle
        (address of its first coordinate, bytes of a coordinate, bytes of a leaf's row, its word: id and vertex order).
    tile, active, groups
        Rays; bits of the vectors to look at.
    axes, frame
        As for `survey_tile`.
    closest
        1: keep hits in the tile where they are nearer, or as near with a lower id. 0: only tell.
    beam, room
        Address of the lines, whose ends are drawn in, but for so much, where hits are kept.
    found
        Address of FOUND_BYTES of scratch.

    Returns
    -------
    int64
        The rays that meet it within their ends; under ``closest``, for which it is now the nearest.
    """
    kx, ky, kz = axes
    place, size, row, word = triangle
    primitive = word >> ORDER_BITS
    c = stack_of_nine(place, size, row, kx, ky, kz)
    pax, pay, paz = splat(VECTOR, c[0]), splat(VECTOR, c[1]), splat(VECTOR, c[2])
    pbx, pby, pbz = splat(VECTOR, c[3]), splat(VECTOR, c[4]), splat(VECTOR, c[5])
    pcx, pcy, pcz = splat(VECTOR, c[6]), splat(VECTOR, c[7]), splat(VECTOR, c[8])
    zero = splat(VECTOR, 0.0)
    met_rays = _int64(0)
    while groups != 0:
        i = count_trailing_zeros(groups)
        groups &= groups - 1
        ray = tile + STEP * i
        ox = load(VECTOR, ray + ORIGIN + kx * ROW)
        oy = load(VECTOR, ray + ORIGIN + ky * ROW)
        oz = load(VECTOR, ray + ORIGIN + kz * ROW)
        shear_x = load(VECTOR, ray + SHEAR)
        shear_y = load(VECTOR, ray + SHEAR + ROW)
        az, bz, cz = paz - oz, pbz - oz, pcz - oz
        ax, ay = (pax - ox) - shear_x * az, (pay - oy) - shear_y * az
        bx, by = (pbx - ox) - shear_x * bz, (pby - oy) - shear_y * bz
        cx, cy = (pcx - ox) - shear_x * cz, (pcy - oy) - shear_y * cz
        u = cx * by - cy * bx
        v = ax * cy - ay * cx
        w = bx * ay - by * ax
        low = minimum(u, minimum(v, w))
        high = maximum(u, maximum(v, w))
        lanes = (active >> (LANES * i)) & NIBBLE & ~mask_to_bits((low < zero) & (high > zero))
        if lanes == 0:
            continue
        largest = maximum(
            maximum(maximum(absolute(ax), absolute(ay)), maximum(absolute(bx), absolute(by))),
            maximum(absolute(cx), absolute(cy)),
        )
        e = largest * largest * CERTAIN + TINY
        certain = (low > e) | (high < -e)
        shear_z = load(VECTOR, ray + SHEAR + 2 * ROW)
        ta, tb, tc = shear_z * az, shear_z * bz, shear_z * cz
        least = minimum(ta, minimum(tb, tc))
        most = maximum(ta, maximum(tb, tc))
        t_best = load(VECTOR, ray + T_BEST)
        t_min = load(VECTOR, ray + T_MIN)
        lanes &= mask_to_bits((most > t_min) & (least <= t_best))
        if lanes == 0:
            continue
        u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
        total = (u + v) + w
        t = ((u * ta + v * tb) + w * tc) / total
        t = minimum(maximum(t, least), most)
        met = lanes & mask_to_bits(certain)
        unsure = lanes & ~met
        if unlikely(unsure != 0):
            store(found, t)
            store(found + STEP, u)
            store(found + 2 * STEP, v)
            store(found + 3 * STEP, w)
            met |= decide_lanes(place, size, row, ray, kx, ky, kz, unsure, found)
            t = load(VECTOR, found)
            u = load(VECTOR, found + STEP)
            v = load(VECTOR, found + 2 * STEP)
            w = load(VECTOR, found + 3 * STEP)
            total = (u + v) + w
        if closest:
            best = load(INTEGERS, ray + PRIMITIVE)
            nearer = (t < t_best) | ((t == t_best) & (splat(INTEGERS, primitive) < best))
            met &= mask_to_bits(nearer & (t > t_min))
            if met == 0:
                continue
            mask = load(INTEGERS, tile + LANE_MASKS + STEP * met)
            order = word & ((1 << ORDER_BITS) - 1)
            second = (PLACE_1 >> (2 * order)) & 3
            third = (PLACE_2 >> (2 * order)) & 3
            weight_1 = u if second == 0 else (v if second == 1 else w)
            weight_2 = u if third == 0 else (v if third == 1 else w)
            t_best = blend(mask, t, t_best)
            store(ray + T_BEST, t_best)
            store(ray + WEIGHT_1, blend(mask, weight_1, load(VECTOR, ray + WEIGHT_1)))
            store(ray + WEIGHT_2, blend(mask, weight_2, load(VECTOR, ray + WEIGHT_2)))
            store(ray + WEIGHTS, blend(mask, total, load(VECTOR, ray + WEIGHTS)))
            store(ray + PRIMITIVE, (splat(INTEGERS, primitive) & mask) | (best & ~mask))
            store(beam + ENDS + 4 * i, deepest_of(ray, mask_of(active, i), oz, t_best, frame) + _float32(room))
        else:
            met &= mask_to_bits((t < t_best) & (t > t_min))
        met_rays |= met << (LANES * i)
    return met_rays


@inline
def word_of(leaf: int, n: int, size: int, k: int) -> Any:
    """Return a triangle's word: id and vertex order."""
    return _int64(load(_int32, leaf + 9 * n * size + 4 * k))
