"""A mesh of few triangles: eight rays side by side against every one of them, without a tree.

In float32, in the tree's frame, each triangle is a plane and three lines in it (:mod:`tracer.rays.brute_table`), which
eight rays are held against at once; no step has a branch. A ray that surely meets a triangle need not look at those
that lie farther. What is left, one triangle a ray mostly, is decided in float64, four rays at a time, as
:mod:`tracer.rays.predicate` decides it. Rays that start far away, where float32 says nothing, go through the tree.

Invariant: the answers of :mod:`tracer.rays.single`, bit for bit.

Bounds, eps = 2**-24. In the frame a triangle's corners lie within 1 of the centre on every axis, origins p within 2,
and the largest component of a direction f is in [1, 2), so a hit p + s f has s <= 3. A triangle's plane is z + m0 x +
m1 y + m2 with |m0|, |m1| <= 1, |m2| <= 3, each corner within 2**-25 of it; its lines are U = a x + b y + c with |a|,
|b| <= 1, |c| <= 2; its area is at most 4. With products and sums rounded one by one, and what they are made of rounded
to float32, U at p (at most 6) is off by 24 eps, U along f (at most 4) by 16 eps, the plane at p (at most 9) by 38 eps
and along f (at most 6) by 24 eps. So U where the ray meets the plane, times the plane along f, is off by 740 eps; the
third line, the area times the plane along f less those two, by 1950 eps: less than `_MARGIN`, 2048 eps. t is off by
(38 + 3 * 24 + 1) eps over the plane along f, and by 3 eps of its own: less than `_SLACK` over that, with room for what
the ends' roundings come to. Where the plane along f is next to 0, that is more than 3 either way.
"""

from typing import Any, Final

from tracer.accel.layout import FRAME_CENTRE, FRAME_SCALE
from tracer.jit import inline, kernel
from tracer.rays.brute_table import FEW, PAIRS, PLANE_BYTES, PLANES, RECORD_BYTES, RECORDS, SINGLES
from tracer.rays.leaf import CLOSEST
from tracer.rays.packet_leaf import decide_lanes
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
    start_vector,
)
from tracer.simd import (
    absolute,
    address_of,
    bitcast,
    convert,
    count_trailing_zeros,
    float32x8,
    from_bits,
    int32x4,
    int32x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    prefetch,
    select,
    splat,
    stack_memory,
    stand_alone,
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

_MARGIN: Final = 2.0**-13
_SLACK: Final = 2.0**-15
_STEEP: Final = 2.0**-20  # of the plane along f, at least: `_SLACK` over it is 32
_FAR: Final = 2.0  # frame units: origins beyond go through the tree
_SIGN: Final = -(2**31)
_INF: Final = float("inf")
_WAITING: Final = 4096  # rays that go through the tree, from which they set out
_AHEAD: Final = 2 * PACKET

# What is known of eight rays in float32: rows of eight.
_P: Final = 0  # x, y, z
_F: Final = 96  # x, y, z
_NEAREST: Final = 192
_FARTHEST: Final = 224
_COARSE: Final = 256  # bytes
_COARSE_BYTES: Final = _COARSE * (PACKET // 8)
_TIMES_BYTES: Final = 32 * FEW
_WORD: Final = 32  # triangles that a word of candidates holds
_HIGH: Final = 4 * PACKET  # from the first 32 triangles' words to the others'
_NOW: Final = 2 * _HIGH  # four rays' candidates, int64
_WORDS_BYTES: Final = _NOW + STEP
_FOUND_BYTES: Final = 4 * STEP
_ALONE_BYTES: Final = 8 * (_WAITING + PACKET)


@inline
def _start(tile: int, coarse: int, frame: Any, rays: Any, first: int) -> Any:
    """Fill a tile and its float32 rows with rays first .. first + 63; returns (rays that start near, and far away)."""
    cx, cy, cz, scale = frame
    near, far = _int64(0), _int64(0)
    origins, wide_o, directions, wide_d, _t_min, _step_min, _t_max, _step_max = rays
    limit = splat(VECTOR, _FAR)
    for i in range(VECTORS):
        number = first + LANES * i
        prefetch(origins + ((number + _AHEAD) * 12 << wide_o))
        prefetch(directions + ((number + _AHEAD) * 12 << wide_d))
        valid, origin, direction = start_vector(tile, i, rays, number)
        px = (origin[0] - splat(VECTOR, cx)) * splat(VECTOR, scale)
        py = (origin[1] - splat(VECTOR, cy)) * splat(VECTOR, scale)
        pz = (origin[2] - splat(VECTOR, cz)) * splat(VECTOR, scale)
        here = mask_to_bits((absolute(px) <= limit) & (absolute(py) <= limit) & (absolute(pz) <= limit))
        at = tile + STEP * i
        row = coarse + _COARSE * (i // 2) + 16 * (i % 2)
        store(row + _P, convert(_float32, px))
        store(row + _P + 32, convert(_float32, py))
        store(row + _P + 64, convert(_float32, pz))
        store(row + _F, convert(_float32, direction[0]))
        store(row + _F + 32, convert(_float32, direction[1]))
        store(row + _F + 64, convert(_float32, direction[2]))
        store(row + _NEAREST, convert(_float32, load(VECTOR, at + T_MIN) * splat(VECTOR, scale)))
        store(row + _FARTHEST, convert(_float32, load(VECTOR, at + T_BEST) * splat(VECTOR, scale)))
        near |= (valid & here) << (LANES * i)
        far |= (valid & ~here) << (LANES * i)
    return near, far


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _flip(value: Any, sign: Any) -> Any:
    """Change the sign of the lanes whose bit is set."""
    return from_bits(to_bits(value) ^ sign)


@inline
def _line(plane: int, row: int, p: Any, f: Any, ahead: Any, slope: Any, sign: Any) -> Any:
    """Return a line's value where eight rays meet the plane, times |slope|."""
    a, b, c = _spread(plane + row), _spread(plane + row + 4), _spread(plane + row + 8)
    at_p = multiply_add(a, p[0], multiply_add(b, p[1], c))
    along = multiply_add(a, f[0], b * f[1])
    return _flip(multiply_add(at_p, slope, -(ahead * along)), sign)


@inline
def _test(plane: int, p: Any, f: Any, nearest: Any, best: Any, times: int, is_pair: bool) -> Any:
    """Hold eight rays against a triangle, or against two that make up a parallelogram.

    Parameters
    ----------
    plane
        Address of its numbers.
    p, f
        Origins and directions, in the order of the plane's axes.
    nearest, best
        Where the rays begin, and where they surely end.
    times
        Address of eight float32, of a pair sixteen, which receive the least t at which the rays may meet the triangle,
        or infinity.

    Returns
    -------
    float32x8
        Where the rays surely end now.
    """
    m0, m1 = _spread(plane), _spread(plane + 4)
    ahead = p[2] + multiply_add(m0, p[0], multiply_add(m1, p[1], _spread(plane + 8)))
    slope = f[2] + multiply_add(m0, f[0], m1 * f[1])
    sign = to_bits(slope) & splat(int32x8, _int32(_SIGN))
    u = _line(plane, 12, p, f, ahead, slope, sign)
    v = _line(plane, 24, p, f, ahead, slope, sign)
    steep = absolute(slope)
    area = _spread(plane + 36) * steep
    w = area - (u + v)
    low = minimum(u, minimum(v, w))
    inverse = splat(float32x8, _float32(1.0)) / maximum(steep, splat(float32x8, _float32(_STEEP)))
    t = _flip(-ahead, sign) * inverse
    slack = splat(float32x8, _float32(_SLACK)) * inverse
    early, late = t - slack, t + slack
    margin = splat(float32x8, _float32(_MARGIN))
    infinite = splat(float32x8, _float32(_INF))
    ends_late = late >= nearest
    store(times, select((low >= -margin) & ends_late, early, infinite))
    if is_pair:
        other = minimum(minimum(area - u, area - v), -w)
        store(times + 32, select((other >= -margin) & ends_late, early, infinite))
        low = maximum(low, other)
    return minimum(best, select((low > margin) & (early > nearest), late, infinite))


@inline
def _candidates(times: int, first: int, last: int, best: Any) -> Any:
    """Return, lane by lane, the bits of the triangles first .. last that a ray may meet before its end."""
    bits = splat(int32x8, _int32(0))
    for k in range(first, last):
        bit = splat(int32x8, _int32(_int64(1) << (k - first)))
        bits = bits | select(load(float32x8, times + 32 * k) <= best, bit, splat(int32x8, _int32(0)))
    return bits


@kernel
def _sift(table: int, coarse: int, times: int, low: int, high: int) -> Any:
    """Write eight rays' candidates to ``low`` and ``high``; returns the bits of rays that surely meet something."""
    stand_alone()
    nearest, farthest = load(float32x8, coarse + _NEAREST), load(float32x8, coarse + _FARTHEST)
    best = farthest
    plane, triangle = table + PLANES, times
    for axis in range(3):
        x, y, z = coarse + 32 * ((axis + 1) % 3), coarse + 32 * ((axis + 2) % 3), coarse + 32 * axis
        p = load(float32x8, x + _P), load(float32x8, y + _P), load(float32x8, z + _P)
        f = load(float32x8, x + _F), load(float32x8, y + _F), load(float32x8, z + _F)
        for _ in range(load(_int64, table + PAIRS + 8 * axis)):
            best = _test(plane, p, f, nearest, best, triangle, True)
            plane += PLANE_BYTES
            triangle += 64
        for _ in range(load(_int64, table + SINGLES + 8 * axis)):
            best = _test(plane, p, f, nearest, best, triangle, False)
            plane += PLANE_BYTES
            triangle += 32
    n = (triangle - times) // 32
    store(low, _candidates(times, _int64(0), min(n, _WORD), best))
    store(high, _candidates(times, _int64(_WORD), n, best))
    return mask_to_bits(best < farthest)


@inline
def _next_record(table: int, at: int, candidates: int) -> Any:
    """Return the address of a ray's first candidate, in the order of the ray's axes; ``at`` is its lane's address."""
    axis = load(_int64, at + AXIS) >> 1
    k = count_trailing_zeros(candidates) & (FEW - 1)  # without a candidate: any
    return table + RECORDS + axis * (FEW * RECORD_BYTES) + k * RECORD_BYTES


@inline
def _blend(mask: Any, a: Any, b: Any) -> Any:
    """Take ``a`` where the mask, int64 lanes of -1 or 0, is set, else ``b``."""
    return bitcast(VECTOR, (to_bits(a) & mask) | (to_bits(b) & ~mask))


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
    store(ray + T_BEST, _blend(mask, t, t_best))
    store(ray + WEIGHT_1, _blend(mask, _weight(to_bits(second), u, v, w), load(VECTOR, ray + WEIGHT_1)))
    store(ray + WEIGHT_2, _blend(mask, _weight(to_bits(third), u, v, w), load(VECTOR, ray + WEIGHT_2)))
    store(ray + WEIGHTS, _blend(mask, total, load(VECTOR, ray + WEIGHTS)))
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
        surely |= _sift(table, coarse + _COARSE * group, times, low, low + _HIGH) << (8 * group)
    met = _int64(0) if closest else surely & near
    left = near & ~met
    now = words + _NOW
    zero = splat(INTEGERS, _int64(0))
    for i in range(VECTORS):
        low = convert(_int64, load(int32x4, words + 16 * i)) & splat(INTEGERS, _int64(0xFFFFFFFF))
        high = convert(_int64, load(int32x4, words + _HIGH + 16 * i)) << 32
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
    tile, coarse = stack_memory(TILE_BYTES), stack_memory(_COARSE_BYTES)
    times, words, found = stack_memory(_TIMES_BYTES), stack_memory(_WORDS_BYTES), stack_memory(_FOUND_BYTES)
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
        near, far = _start(tile, coarse, frame, rays, first)
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
