"""Four rays side by side, each against one triangle of its own leaf, as :mod:`tracer.rays.predicate` decides it.

What is left of a leaf after :func:`tracer.rays.leaf.sift_leaf` is about one triangle a ray: four lanes of one ray would
hold one, so four rays share them.

Invariant: a lane is accepted here only where the predicate would take its rounded branch, by the same floats in the
same order. Here that is judged by the weights themselves, each within 1.5 ulp, at twice the predicate's bound e:
its own edge function, off by less than 0.8 e, is then beyond e on the same side. Lanes that are not certain, and
triangles as near as the nearest so far, go to the scalar predicate.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS
from tracer.jit import inline
from tracer.rays import state as s
from tracer.rays.leaf import ANY, CLOSEST, COUNT, SHADE, decide, keep, leaf_of, over_sum, word_of
from tracer.rays.packet_shade import dim_four
from tracer.rays.predicate import CERTAIN, TINY, weigh
from tracer.rays.rows import LANES, STEP
from tracer.simd import (
    absolute,
    convert,
    count_trailing_zeros,
    extract,
    float32x4,
    float64x4,
    insert,
    load,
    mask_to_bits,
    maximum,
    minimum,
    splat,
    store,
    transpose,
    unlikely,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

RAYS: Final = 4


@inline
def _row_and_place(wide: int, base: int, state: int) -> Any:
    """Return (bytes of a row of the ray's leaf, address of its next candidate in the leaf's first row)."""
    leaf, n = leaf_of(base, load(_int64, state + s.NODE))
    return n << (2 + wide), leaf + (count_trailing_zeros(load(_int64, state + s.CANDIDATES)) << (2 + wide))


@inline
def _four_narrow(a: int, b: int, c: int, d: int) -> Any:
    values = splat(float32x4, load(_float32, a))
    values = insert(values, 1, load(_float32, b))
    values = insert(values, 2, load(_float32, c))
    return convert(_float64, insert(values, 3, load(_float32, d)))


@inline
def _four_wide(a: int, b: int, c: int, d: int) -> Any:
    values = splat(float64x4, load(_float64, a))
    values = insert(values, 1, load(_float64, b))
    values = insert(values, 2, load(_float64, c))
    return insert(values, 3, load(_float64, d))


@inline
def _vertices(wide: int, states: Any, places: Any, rows: Any, axis: int) -> Any:
    """Load the coordinate that is each ray's kx, ky or kz, of A, B and C."""
    a = places[0] + load(_int64, states[0] + axis) * rows[0]
    b = places[1] + load(_int64, states[1] + axis) * rows[1]
    c = places[2] + load(_int64, states[2] + axis) * rows[2]
    d = places[3] + load(_int64, states[3] + axis) * rows[3]
    a3, b3, c3, d3 = a + 3 * rows[0], b + 3 * rows[1], c + 3 * rows[2], d + 3 * rows[3]
    a6, b6, c6, d6 = a + 6 * rows[0], b + 6 * rows[1], c + 6 * rows[2], d + 6 * rows[3]
    if wide != 0:
        return _four_wide(a, b, c, d), _four_wide(a3, b3, c3, d3), _four_wide(a6, b6, c6, d6)
    return _four_narrow(a, b, c, d), _four_narrow(a3, b3, c3, d3), _four_narrow(a6, b6, c6, d6)


@inline
def _four_rows(states: Any, field: int) -> Any:
    """Load four float64 fields of four rays."""
    return transpose(
        load(float64x4, states[0] + field),
        load(float64x4, states[1] + field),
        load(float64x4, states[2] + field),
        load(float64x4, states[3] + field),
    )


@inline
def _stop(state: int) -> None:
    """Leave the ray nothing to look at."""
    store(state + s.CANDIDATES, _int64(0))
    store(state + s.STACK_TOP, load(_int64, state + s.STACK) + 4)


@inline
def _next_word(wide: int, base: int, state: int) -> Any:
    """Load the leaf's word of the ray's next candidate."""
    leaf, n = leaf_of(base, load(_int64, state + s.NODE))
    return word_of(wide, leaf, n, count_trailing_zeros(load(_int64, state + s.CANDIDATES)))


@inline
def _end(state: int) -> None:
    """Note that the ray has met what it looks for."""
    store(state + s.BEST_ID, _int64(0))
    _stop(state)


@inline
def _dim(state: int, primitive: int, shading: Any) -> None:
    """Weaken the light of a packet's ray by a primitive."""
    packet, kt, face_material, stride = shading
    material = kt + stride * _int64(load(_int32, face_material + 4 * primitive))
    lane = load(_int64, state + s.RAY_INDEX)
    if dim_four(packet + STEP * (lane // LANES), _int64(1) << lane % LANES, material) != 0:
        _end(state)


@inline
def _note(wide: int, base: int, state: int, t: float, weights: Any, mode: int, shading: Any) -> None:
    """Note a hit that is the ray's nearest so far; ``weights`` as `keep` takes them."""
    if mode == COUNT:
        store(state + s.BEST_ID, load(_int64, state + s.BEST_ID) + 1)
        return
    word = _next_word(wide, base, state)
    if unlikely(word >> ORDER_BITS == _int64(load(_int32, state + s.SKIP))):
        return
    if mode == ANY:
        _end(state)
    elif mode == SHADE:
        _dim(state, word >> ORDER_BITS, shading)
    else:
        keep(state, word, t, weights)


@inline
def _note_by_predicate(wide: int, base: int, state: int, mode: int, shading: Any) -> None:
    """Decide about the ray's next candidate by the scalar predicate, and note what it brings."""
    leaf, n = leaf_of(base, load(_int64, state + s.NODE))
    met, t, u, v, w = decide(wide, leaf, n, count_trailing_zeros(load(_int64, state + s.CANDIDATES)), state)
    if not met:
        return
    best = load(_float64, state + s.T_BEST)
    primitive = _next_word(wide, base, state) >> ORDER_BITS
    if t < best or (mode == CLOSEST and t == best and primitive < load(_int64, state + s.BEST_ID)):
        _note(wide, base, state, t, over_sum(u, v, w), mode, shading)


@inline
def visit_next(wide: int, base: int, places: int, count: int, mode: int, shading: Any) -> None:
    """Test the next candidate of one to four rays and note what it brings.

    Parameters
    ----------
    wide
        1: the leaves' rows are float64; 0: float32.
    base
        Address of the tree.
    places
        Address of four int64, addresses of rays at leaves, with a candidate each; the same one may fill up the four.
    count
        How many of them are meant.
    mode
        CLOSEST: the least (t, id) is kept in the state. ANY: BEST_ID becomes 0. COUNT: BEST_ID, from -1, is increased.
        SHADE: the packet's light is multiplied, and BEST_ID becomes 0 when none is left.
    shading
        For SHADE: addresses of the packet, of the first material's kt and of the faces' materials (int32), and the
        bytes from material to material.
    """
    states = load(_int64, places), load(_int64, places + 8), load(_int64, places + 16), load(_int64, places + 24)
    row_0, place_0 = _row_and_place(wide, base, states[0])
    row_1, place_1 = _row_and_place(wide, base, states[1])
    row_2, place_2 = _row_and_place(wide, base, states[2])
    row_3, place_3 = _row_and_place(wide, base, states[3])
    rows = row_0, row_1, row_2, row_3
    first = place_0, place_1, place_2, place_3
    shear_x, shear_y, shear_z, ox = _four_rows(states, s.SHEAR_X)
    oy, oz, t_min, t_best = _four_rows(states, s.ORIGIN_Y)
    az, bz, cz = _vertices(wide, states, first, rows, s.AXIS_Z)
    az, bz, cz = az - oz, bz - oz, cz - oz
    ax, bx, cx = _vertices(wide, states, first, rows, s.AXIS_X)
    ax = (ax - ox) - shear_x * az
    bx = (bx - ox) - shear_x * bz
    cx = (cx - ox) - shear_x * cz
    ay, by, cy = _vertices(wide, states, first, rows, s.AXIS_Y)
    ay = (ay - oy) - shear_y * az
    by = (by - oy) - shear_y * bz
    cy = (cy - oy) - shear_y * cz
    u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
    largest = maximum(
        maximum(maximum(absolute(ax), absolute(ay)), maximum(absolute(bx), absolute(by))),
        maximum(absolute(cx), absolute(cy)),
    )
    e = largest * largest * (2.0 * CERTAIN) + 2.0 * TINY
    low = minimum(u, minimum(v, w))
    high = maximum(u, maximum(v, w))
    ta = shear_z * az
    tb = shear_z * bz
    tc = shear_z * cz
    least = minimum(ta, minimum(tb, tc))
    most = maximum(ta, maximum(tb, tc))
    total = (u + v) + w
    t = ((u * ta + v * tb) + w * tc) / total
    t = minimum(maximum(t, least), most)
    meant = (1 << count) - 1
    certain = mask_to_bits((low > e) | (high < -e))
    met = mask_to_bits((t > t_min) & (t <= t_best)) & certain & meant
    nearer = mask_to_bits(t < t_best) & met
    possible = mask_to_bits(((low >= -e) | (high <= e)) & (most > t_min) & (least <= t_best)) & ~certain & meant
    weights = transpose(u / total, v / total, w / total, t)
    if nearer & 1 != 0:
        _note(wide, base, states[0], extract(t, 0), weights[0], mode, shading)
    if nearer & 2 != 0:
        _note(wide, base, states[1], extract(t, 1), weights[1], mode, shading)
    if nearer & 4 != 0:
        _note(wide, base, states[2], extract(t, 2), weights[2], mode, shading)
    if nearer & 8 != 0:
        _note(wide, base, states[3], extract(t, 3), weights[3], mode, shading)
    rest = possible | (met & ~nearer)
    while rest != 0:
        lane = count_trailing_zeros(rest)
        rest &= rest - 1
        _note_by_predicate(wide, base, load(_int64, places + 8 * lane), mode, shading)
