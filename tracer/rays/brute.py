"""A mesh of few triangles: eight rays side by side against every one of them, without a tree.

In float32, in the tree's frame, each triangle is a plane and three lines in it (:mod:`tracer.rays.brute_table`), which
eight rays are held against at once; no step has a branch. A ray that surely meets a triangle need not look at those
that lie farther. What is left, one triangle a ray mostly, is decided in float64, four rays at a time, as
:mod:`tracer.rays.predicate` decides it. Rays that start far away, where float32 says nothing, go through the tree.

Invariant: the answers of :mod:`tracer.rays.single`, bit for bit.
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_CENTRE, FRAME_SCALE
from tracer.jit import inline, kernel
from tracer.rays.brute_sift import COARSE, COARSE_BYTES, HIGH, TIMES_BYTES, sift, start_strip
from tracer.rays.brute_table import FEW, RECORD_BYTES, RECORDS
from tracer.rays.leaf import CLOSEST
from tracer.rays.packet_leaf import FOUND_BYTES, decide_lanes
from tracer.rays.predicate import CERTAIN, TINY, weigh
from tracer.rays.rows import (
    AXIS,
    INTEGERS,
    LANES,
    NIBBLE,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    ROW,
    SHEAR,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    WEIGHT_1,
    WEIGHT_2,
    blend,
)
from tracer.rays.stream import follow
from tracer.rays.tile import (
    LANE_MASKS,
    T_MIN,
    TILE_BYTES,
    WEIGHTS,
    expect_outputs,
    finish_any,
    finish_closest,
    prepare_tile,
)
from tracer.simd import (
    absolute,
    address_of,
    convert,
    count_trailing_zeros,
    int32x4,
    load,
    mask_to_bits,
    maximum,
    minimum,
    select,
    splat,
    stack_memory,
    store,
    to_bits,
    transpose,
    unlikely,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

_WAITING: Final = 4096  # rays that go through the tree, from which they set out
_NOW: Final = 2 * HIGH  # four rays' candidates, int64
_WORDS_BYTES: Final = _NOW + STEP
_ALONE_BYTES: Final = 8 * (_WAITING + PACKET)


@inline
def _next_record(table: int, at: int, candidates: int) -> Any:
    """Return the address of a ray's first candidate, in the order of the ray's axes; ``at`` is its lane's address."""
    axis = load(_int64, at + AXIS) >> 1
    k = count_trailing_zeros(candidates) & (FEW - 1)  # without a candidate: any
    return table + RECORDS + axis * (FEW * RECORD_BYTES) + k * RECORD_BYTES


@inline
def _weight(which: Any, u: Any, v: Any, w: Any) -> Any:
    """Choose, lane by lane, U, V or W by 0, 1 or 2."""
    one = splat(INTEGERS, _int64(1))
    return select(which < one, u, select(which == one, v, w))


@inline
def _decide(table: int, tile: int, vector: int, words: int, found: int, closest: bool) -> Any:
    """Decide about the next candidate of each of four rays.

    Parameters
    ----------
    words
        Address of four int64, the rays' candidates; of each, the lowest is meant.
    found
        Address of 4 vectors.
    closest
        Keep hits that are nearest, in the tile.

    Returns
    -------
    int64
        Bits of the rays that met theirs; under ``closest``, of those for which it is the nearest so far.
    """
    ray = tile + STEP * vector
    word_0, word_1 = load(_int64, words), load(_int64, words + 8)
    word_2, word_3 = load(_int64, words + 16), load(_int64, words + 24)
    meant = _int64(word_0 != 0) | _int64(word_1 != 0) << 1 | _int64(word_2 != 0) << 2 | _int64(word_3 != 0) << 3
    a, b = _next_record(table, ray, word_0), _next_record(table, ray + 8, word_1)
    c, d = _next_record(table, ray + 16, word_2), _next_record(table, ray + 24, word_3)
    axis = load(INTEGERS, ray + AXIS)
    along_z, along_x = axis >= splat(INTEGERS, _int64(4)), axis < splat(INTEGERS, _int64(2))
    x, y, z = load(VECTOR, ray + ORIGIN), load(VECTOR, ray + ORIGIN + ROW), load(VECTOR, ray + ORIGIN + 2 * ROW)
    ox = select(along_z, x, select(along_x, y, z))
    oy = select(along_z, y, select(along_x, z, x))
    oz = select(along_z, z, select(along_x, x, y))
    ax, ay, az, bx = transpose(load(VECTOR, a), load(VECTOR, b), load(VECTOR, c), load(VECTOR, d))
    by, bz, cx, cy = transpose(load(VECTOR, a + 32), load(VECTOR, b + 32), load(VECTOR, c + 32), load(VECTOR, d + 32))
    cz, primitive, second, third = transpose(
        load(VECTOR, a + 64), load(VECTOR, b + 64), load(VECTOR, c + 64), load(VECTOR, d + 64)
    )
    shear_x, shear_y = load(VECTOR, ray + SHEAR), load(VECTOR, ray + SHEAR + ROW)
    shear_z = load(VECTOR, ray + SHEAR + 2 * ROW)
    az, bz, cz = az - oz, bz - oz, cz - oz
    ax, ay = (ax - ox) - shear_x * az, (ay - oy) - shear_y * az
    bx, by = (bx - ox) - shear_x * bz, (by - oy) - shear_y * bz
    cx, cy = (cx - ox) - shear_x * cz, (cy - oy) - shear_y * cz
    u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
    largest = maximum(
        maximum(maximum(absolute(ax), absolute(ay)), maximum(absolute(bx), absolute(by))),
        maximum(absolute(cx), absolute(cy)),
    )
    # as in tracer.rays.leaf_four: the weights themselves, at twice the predicate's bound
    e = largest * largest * (2.0 * CERTAIN) + 2.0 * TINY
    low = minimum(u, minimum(v, w))
    high = maximum(u, maximum(v, w))
    ta, tb, tc = shear_z * az, shear_z * bz, shear_z * cz
    least, most = minimum(ta, minimum(tb, tc)), maximum(ta, maximum(tb, tc))
    total = (u + v) + w
    t = ((u * ta + v * tb) + w * tc) / total
    t = minimum(maximum(t, least), most)
    met = mask_to_bits((low > e) | (high < -e)) & meant
    unsure = mask_to_bits((low >= -e) | (high <= e)) & meant & ~met
    if unlikely(unsure != 0):
        store(found, t)
        store(found + STEP, u)
        store(found + 2 * STEP, v)
        store(found + 3 * STEP, w)
        while unsure != 0:
            lane = count_trailing_zeros(unsure)
            unsure &= unsure - 1
            k = load(_int64, ray + 8 * lane + AXIS) >> 1
            record = a if lane == 0 else (b if lane == 1 else (c if lane == 2 else d))
            record += (2 - k) * (FEW * RECORD_BYTES)  # in the order x, y, z
            met |= decide_lanes(
                record, _int64(8), _int64(8), ray, (k + 1) % 3, (k + 2) % 3, k, _int64(1) << lane, found
            )
        t = load(VECTOR, found)
        u = load(VECTOR, found + STEP)
        v = load(VECTOR, found + 2 * STEP)
        w = load(VECTOR, found + 3 * STEP)
        total = (u + v) + w
    t_best = load(VECTOR, ray + T_BEST)
    after = t > load(VECTOR, ray + T_MIN)
    if not closest:
        return met & mask_to_bits(after & (t < t_best))
    best = load(INTEGERS, ray + PRIMITIVE)
    ids = to_bits(primitive)
    met &= mask_to_bits(after & ((t < t_best) | ((t == t_best) & (ids < best))))
    mask = load(INTEGERS, tile + LANE_MASKS + STEP * met)
    store(ray + T_BEST, blend(mask, t, t_best))
    store(ray + WEIGHT_1, blend(mask, _weight(to_bits(second), u, v, w), load(VECTOR, ray + WEIGHT_1)))
    store(ray + WEIGHT_2, blend(mask, _weight(to_bits(third), u, v, w), load(VECTOR, ray + WEIGHT_2)))
    store(ray + WEIGHTS, blend(mask, total, load(VECTOR, ray + WEIGHTS)))
    store(ray + PRIMITIVE, (ids & mask) | (best & ~mask))
    return met


@inline
def _trace_tile(
    table: int, tile: int, coarse: int, times: int, words: int, found: int, near: int, closest: bool
) -> Any:
    """Answer a tile's rays; ``near`` are those that can meet anything. Returns the bits of those that did."""
    surely = _int64(0)
    for group in range(PACKET // 8):
        low = words + 32 * group
        surely |= sift(table, coarse + COARSE * group, times, low, low + HIGH) << (8 * group)
    met = _int64(0) if closest else surely & near
    left = near & ~met
    now = words + _NOW
    zero = splat(INTEGERS, _int64(0))
    for i in range(VECTORS):
        low = convert(_int64, load(int32x4, words + 16 * i)) & splat(INTEGERS, _int64(0xFFFFFFFF))
        high = convert(_int64, load(int32x4, words + HIGH + 16 * i)) << 32
        four = (low | high) & load(INTEGERS, tile + LANE_MASKS + STEP * ((left >> (LANES * i)) & NIBBLE))
        while mask_to_bits(four != zero) != 0:
            store(now, four)
            met |= _decide(table, tile, i, now, found, closest) << (LANES * i)
            four = four & (four - splat(INTEGERS, _int64(1)))
    return met


@kernel
def trace_brute(
    tree: Any,
    rays: Any,
    start: int,
    end: int,
    mode: int,
    out_t: Any,
    out_primitive: Any,
    out_u: Any,
    out_v: Any,
    table: int,
) -> None:
    """Answer rays start..end; parameters as :func:`tracer.rays.single.trace_single`, without COUNT.

    Parameters
    ----------
    table
        Address of what :func:`tracer.rays.brute_table.tabulate` made of the tree.
    """
    base = address_of(tree)
    outputs = (address_of(out_t), address_of(out_primitive), address_of(out_u), address_of(out_v))
    tile, coarse = stack_memory(TILE_BYTES), stack_memory(COARSE_BYTES)
    times, words, found = stack_memory(TIMES_BYTES), stack_memory(_WORDS_BYTES), stack_memory(FOUND_BYTES)
    alone = stack_memory(_ALONE_BYTES)
    prepare_tile(tile)
    centre = base + 8 * FRAME_CENTRE
    scale = load(_float64, base + 8 * FRAME_SCALE)
    frame = load(_float64, centre), load(_float64, centre + 8), load(_float64, centre + 16), scale
    n_alone = _int64(0)
    if end - start < PACKET:
        follow(base, rays, _int64(0), start, end, mode, outputs)
        return
    for strip in range(start, end, PACKET):
        first = min(strip, end - PACKET)  # the last one overlaps: whoever comes second writes the same
        near, far = start_strip(tile, coarse, frame, rays, first)
        if mode == CLOSEST:
            expect_outputs(outputs, first, _int64(0), _int64(4))
            _trace_tile(table, tile, coarse, times, words, found, near, True)
            finish_closest(tile, outputs, first, _int64(0), _int64(4))
        else:
            met = _trace_tile(table, tile, coarse, times, words, found, near, False)
            finish_any(met, outputs, first, _int64(0), _int64(4))
        while far != 0:
            store(alone + 8 * n_alone, first + count_trailing_zeros(far))
            far &= far - 1
            n_alone += 1
        if n_alone >= _WAITING:
            follow(base, rays, alone, _int64(0), n_alone, mode, outputs)
            n_alone = _int64(0)
    if n_alone > 0:
        follow(base, rays, alone, _int64(0), n_alone, mode, outputs)
