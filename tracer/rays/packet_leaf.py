"""A leaf against a packet: four rays at once, each decided as :mod:`tracer.rays.predicate` decides it.

What is left of a leaf after :mod:`tracer.rays.packet_cut`, triangle by triangle.

Invariant: a lane is accepted here only where the predicate would take its rounded branch, by the same floats in the
same order; lanes that are not certain go to the scalar predicate itself. Edge functions of strictly mixed signs miss
for certain: rounding is monotone, so a rounded difference of products has the exact one's sign or is zero.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.jit import inline, kernel
from tracer.rays.predicate import CERTAIN, TINY, intersect_triangle, weigh
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    ROW,
    SHEAR,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    WEIGHT_1,
    WEIGHT_2,
    axes_of,
    mask_of,
    put,
    put_integers,
)
from tracer.simd import (
    absolute,
    count_trailing_zeros,
    load,
    mask_to_bits,
    maximum,
    minimum,
    splat,
    stand_alone,
    store,
    unlikely,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int64: Final = types.int64


FOUND_BYTES: Final = 4 * STEP  # of `decide_lanes`


@kernel
def decide_lanes(place: int, size: int, row: int, ray: int, kx: int, ky: int, kz: int, unsure: int, found: int) -> Any:
    """Decide lanes of a vector by the scalar predicate.

    Parameters
    ----------
    place, size, row
        Address of the triangle's first coordinate, bytes of a coordinate and of a leaf's row.
    ray
        Address of the vector's first lane in the packet.
    unsure
        Bits of the lanes to decide.
    found
        Address of 4 vectors: t, U, V, W. Written for the lanes that are met.

    Returns
    -------
    int64
        Bits of those met.
    """
    stand_alone()
    met = _int64(0)
    c = stack_of_nine(place, size, row, kx, ky, kz)
    while unsure != 0:
        lane = count_trailing_zeros(unsure)
        unsure &= unsure - 1
        at = ray + 8 * lane
        hit, t, u, v, w = intersect_triangle(
            c[0],
            c[1],
            c[2],
            c[3],
            c[4],
            c[5],
            c[6],
            c[7],
            c[8],
            load(_float64, at + ORIGIN + kx * ROW),
            load(_float64, at + ORIGIN + ky * ROW),
            load(_float64, at + ORIGIN + kz * ROW),
            load(_float64, at + SHEAR),
            load(_float64, at + SHEAR + ROW),
            load(_float64, at + SHEAR + 2 * ROW),
        )
        if hit:
            store(found + 8 * lane, t)
            store(found + STEP + 8 * lane, u)
            store(found + 2 * STEP + 8 * lane, v)
            store(found + 3 * STEP + 8 * lane, w)
            met |= _int64(1) << lane
    return met


@inline
def coordinate(address: int, size: int) -> Any:
    """Load a leaf's coordinate of 4 or 8 bytes."""
    return load(_float64, address) if size == 8 else _float64(load(_float32, address))


@inline
def stack_of_nine(place: int, size: int, row: int, kx: int, ky: int, kz: int) -> Any:
    """Return a triangle's coordinates in the order kx, ky, kz, vertex by vertex."""
    return (
        coordinate(place + kx * row, size),
        coordinate(place + ky * row, size),
        coordinate(place + kz * row, size),
        coordinate(place + (3 + kx) * row, size),
        coordinate(place + (3 + ky) * row, size),
        coordinate(place + (3 + kz) * row, size),
        coordinate(place + (6 + kx) * row, size),
        coordinate(place + (6 + ky) * row, size),
        coordinate(place + (6 + kz) * row, size),
    )


@inline
def _relative(c: Any, ray: int, axes: Any) -> Any:
    """Subtract a ray's origin from a triangle's coordinates."""
    kx, ky, kz = axes
    x, y = load(_float64, ray + ORIGIN + kx * ROW), load(_float64, ray + ORIGIN + ky * ROW)
    z = load(_float64, ray + ORIGIN + kz * ROW)
    return c[0] - x, c[1] - y, c[2] - z, c[3] - x, c[4] - y, c[5] - z, c[6] - x, c[7] - y, c[8] - z


@inline
def sheared(c: Any, ray: int, axes: Any, one_origin: bool) -> Any:
    """Sheared coordinates of a triangle for four rays (:mod:`tracer.rays.predicate`): x, y, z of each vertex.

    ``c`` is relative to the origin already where that is ``one_origin`` for all.
    """
    kx, ky, kz = axes
    ax, ay, az = splat(VECTOR, c[0]), splat(VECTOR, c[1]), splat(VECTOR, c[2])
    bx, by, bz = splat(VECTOR, c[3]), splat(VECTOR, c[4]), splat(VECTOR, c[5])
    cx, cy, cz = splat(VECTOR, c[6]), splat(VECTOR, c[7]), splat(VECTOR, c[8])
    if not one_origin:
        ox, oy = load(VECTOR, ray + ORIGIN + kx * ROW), load(VECTOR, ray + ORIGIN + ky * ROW)
        oz = load(VECTOR, ray + ORIGIN + kz * ROW)
        ax, ay, az = ax - ox, ay - oy, az - oz
        bx, by, bz = bx - ox, by - oy, bz - oz
        cx, cy, cz = cx - ox, cy - oy, cz - oz
    shear_x, shear_y = load(VECTOR, ray + SHEAR), load(VECTOR, ray + SHEAR + ROW)
    return (
        ax - shear_x * az,
        ay - shear_y * az,
        az,
        bx - shear_x * bz,
        by - shear_y * bz,
        bz,
        cx - shear_x * cz,
        cy - shear_y * cz,
        cz,
    )


@inline
def _keep(ray: int, mask: Any, word: int, t: Any, u: Any, v: Any, w: Any) -> None:
    """Write hits of a triangle: t, the weights of its second and third vertex as given, its id."""
    total = (u + v) + w
    order = word & ((1 << ORDER_BITS) - 1)
    second = (PLACE_1 >> (2 * order)) & 3
    third = (PLACE_2 >> (2 * order)) & 3
    weight_1 = u if second == 0 else (v if second == 1 else w)
    weight_2 = u if third == 0 else (v if third == 1 else w)
    put(ray + T_BEST, mask, t)
    put(ray + WEIGHT_1, mask, weight_1 / total)
    put(ray + WEIGHT_2, mask, weight_2 / total)
    put_integers(ray + PRIMITIVE, mask, splat(INTEGERS, word >> ORDER_BITS))


@inline
def meet_within(
    place: int, size: int, row: int, word: int, packet: int, active: int, axes: Any, one_origin: bool
) -> Any:
    """As `meet_triangle` for the nearest hits, where all active rays' lines pass within the edges for certain."""
    c = stack_of_nine(place, size, row, axes[0], axes[1], axes[2])
    if one_origin:
        c = _relative(c, packet + 8 * count_trailing_zeros(active), axes)
    zero = splat(VECTOR, 0.0)
    primitive = splat(INTEGERS, word >> ORDER_BITS)
    met_lanes = _int64(0)
    for i in range(VECTORS):
        lanes = (active >> (LANES * i)) & NIBBLE
        if lanes == 0:
            continue
        ray = packet + STEP * i
        ax, ay, az, bx, by, bz, cx, cy, cz = sheared(c, ray, axes, one_origin)
        shear_z = load(VECTOR, ray + SHEAR + 2 * ROW)
        ta, tb, tc = shear_z * az, shear_z * bz, shear_z * cz
        least = minimum(ta, minimum(tb, tc))
        most = maximum(ta, maximum(tb, tc))
        t_best = load(VECTOR, ray + T_BEST)
        u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
        t = ((u * ta + v * tb) + w * tc) / ((u + v) + w)
        t = minimum(maximum(t, least), most)
        nearer = (t < t_best) | ((t == t_best) & (primitive < load(INTEGERS, ray + PRIMITIVE)))
        lanes &= mask_to_bits(nearer & (t > zero))
        if lanes == 0:
            continue
        _keep(ray, mask_of(lanes, 0), word, t, u, v, w)
        met_lanes |= lanes << (LANES * i)
    return met_lanes


@kernel
def meet_known(
    packet: int, active: int, place: int, size: int, row: int, word: int, axis: int, one_origin: bool
) -> None:
    """Intersect rays with a triangle that all of them meet for certain, first of all triangles.

    Parameters
    ----------
    packet, active
        The rays; T_BEST, PRIMITIVE and the weights are written.
    place, size, row, word
        The triangle, as for `meet_triangle`.
    axis
        AXIS of the rays.
    one_origin
        All of them start in one point.
    """
    stand_alone()
    meet_within(place, size, row, word, packet, active, axes_of(axis), one_origin)


@inline
def meet_triangle(
    place: int,
    size: int,
    row: int,
    word: int,
    packet: int,
    active: int,
    groups: int,
    axes: Any,
    closest: int,
    alike: bool,
    one_origin: bool,
    found: int,
) -> Any:
    """Test a triangle against the active rays.

    Parameters
    ----------
    place, size, row
        As `decide_lanes`.
    word
        The leaf's word of the triangle: id and vertex order.
    packet, active
        Rays.
    groups
        Bits of the vectors to look at.
    axes
        (kx, ky, kz).
    closest
        1: keep hits in the packet where they are nearer, or as near with a lower id. 0: only tell.
    alike
        True: no ray skips this triangle. False: look at SKIP.
    one_origin
        All active rays start in one point.
    found
        Address of scratch for 4 vectors.

    Returns
    -------
    int64
        The rays that meet it within their ends; under ``closest``, for which it is now the nearest.
    """
    kx, ky, kz = axes
    primitive = word >> ORDER_BITS
    c = stack_of_nine(place, size, row, kx, ky, kz)
    if one_origin:
        c = _relative(c, packet + 8 * count_trailing_zeros(active), axes)
    zero = splat(VECTOR, 0.0)
    met_lanes = _int64(0)
    while groups != 0:
        i = count_trailing_zeros(groups)
        groups &= groups - 1
        lanes = (active >> (LANES * i)) & NIBBLE
        if lanes == 0:
            continue
        ray = packet + STEP * i
        ax, ay, az, bx, by, bz, cx, cy, cz = sheared(c, ray, axes, one_origin)
        u = cx * by - cy * bx
        v = ax * cy - ay * cx
        w = bx * ay - by * ax
        low = minimum(u, minimum(v, w))
        high = maximum(u, maximum(v, w))
        lanes &= ~mask_to_bits((low < zero) & (high > zero))
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
        lanes &= mask_to_bits((most > zero) & (least <= t_best))
        if not alike:
            lanes &= ~mask_to_bits(load(INTEGERS, ray + SKIP) == splat(INTEGERS, primitive))
        if lanes == 0:
            continue
        u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
        t = ((u * ta + v * tb) + w * tc) / ((u + v) + w)
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
        if closest:
            best = load(INTEGERS, ray + PRIMITIVE)
            nearer = (t < t_best) | ((t == t_best) & (splat(INTEGERS, primitive) < best))
            met &= mask_to_bits(nearer & (t > zero))
            if met == 0:
                continue
            _keep(ray, mask_of(met, 0), word, t, u, v, w)
        else:
            met &= mask_to_bits((t < t_best) & (t > zero))
        met_lanes |= met << (LANES * i)
    return met_lanes
