"""Bounces that wait: made of 64 hits at a time, kept on two stacks, taken off 64 at a time.

Deepest first, so that the stacks stay small: bounces of a depth are made by one packet's hits at a time (the first
depth's by a wave's), and gone before the next packet is traced. What mirrors and what lets through wait apart, because
neighbours on one stack then go the same way.

Source: [farmer2019 eq. 14, 15, 17, 18].
"""

import math
from typing import Any, Final

from tracer.geometry.vector import add, at, dot, is_black, multiply, negate, scale
from tracer.integrators.scratch import (
    PENDING_DIRECTION,
    PENDING_FROM,
    PENDING_ORIGIN,
    PENDING_ROWS,
    PENDING_SAMPLE,
    PENDING_SKIP,
    PENDING_THROUGHPUT,
    REFLECTED,
    TRANSMITTED,
    Scratch,
)
from tracer.jit import inline, int64, kernel
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    MASK,
    NIBBLE,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    ROW,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    shear_lanes,
)
from tracer.shading.direct import offset_origins
from tracer.shading.phong import attenuation_bound
from tracer.shading.rows import (
    DEPTH,
    DIRECTION,
    FROM,
    MATERIAL,
    NORMAL,
    SAMPLE,
    START,
    THROUGHPUT,
    choose,
    spread,
    vector_at,
)
from tracer.simd import (
    count_trailing_zeros,
    extract,
    load,
    mask_from_bits,
    mask_to_bits,
    maximum,
    population_count,
    select,
    splat,
    sqrt,
    store,
)
from tracer.simd.gateway import types
from tracer.types import (
    COUNTERS,
    FLAG_TWO_SIDED,
    LIMIT_MIN_THROUGHPUT,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    MATERIAL_ETA,
    MATERIAL_KR,
    MATERIAL_KT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    SETTING_MAX_DEPTH,
    SceneView,
)

_int64: Final = types.int64

_REFLECTION_RAYS: Final = COUNTERS.index("reflection_rays")
_TRANSMISSION_RAYS: Final = COUNTERS.index("transmission_rays")
_SKIPPED_DEPTH: Final = COUNTERS.index("bounces_skipped_depth")
_SKIPPED_THROUGHPUT: Final = COUNTERS.index("bounces_skipped_throughput")


@inline
def _stack(scratch: Scratch, which: int) -> Any:
    """Address of a stack's first row."""
    return scratch.pending + which * PENDING_ROWS * scratch.pending_row


@inline
def _write(scratch: Scratch, place: int, row: int, bits: int, value: Any) -> None:
    """Append the chosen lanes of a vector to a row of a stack."""
    at_row = place + row * scratch.pending_row
    if bits == NIBBLE:
        store(at_row, value)
        return
    while bits != 0:
        store(at_row, extract(value, count_trailing_zeros(bits)))
        bits &= bits - 1
        at_row += 8


@inline
def _push(
    view: SceneView, scratch: Scratch, which: int, ray: int, bits: int, depth: int, d: Any, weight: Any, material: int
) -> None:
    """Put four hits' bounces on a stack, those of ``bits`` that are not too deep or too weak."""
    counters = scratch.counters
    if depth > view.settings[SETTING_MAX_DEPTH]:
        counters[_SKIPPED_DEPTH] += population_count(bits)
        return
    a = view.materials[N_MATERIAL * material + MATERIAL_A]
    greatest = maximum(weight.x, maximum(weight.y, weight.z)) * splat(VECTOR, attenuation_bound(a))
    weak = mask_to_bits(greatest < splat(VECTOR, view.limits[LIMIT_MIN_THROUGHPUT])) & bits
    counters[_SKIPPED_THROUGHPUT] += population_count(weak)
    bits &= ~weak
    if bits == 0:
        return
    n = population_count(bits)
    counters[_REFLECTION_RAYS if which == REFLECTED else _TRANSMISSION_RAYS] += n
    heights = scratch.heights + which * scratch.heights_row
    height = load(_int64, heights)
    store(heights, height + n)
    store(heights + 8 * depth, load(_int64, heights + 8 * depth) + n)
    # nothing is attenuated by 1 / (1 + 0 D + 0 D^2)
    plain = (
        a == 1.0
        and view.materials[N_MATERIAL * material + MATERIAL_B] == 0.0
        and view.materials[N_MATERIAL * material + MATERIAL_C] == 0.0
    )
    place = _stack(scratch, which) + 8 * height
    o = offset_origins(ray, d)
    _write(scratch, place, PENDING_ORIGIN, bits, o.x)
    _write(scratch, place, PENDING_ORIGIN + 1, bits, o.y)
    _write(scratch, place, PENDING_ORIGIN + 2, bits, o.z)
    _write(scratch, place, PENDING_DIRECTION, bits, d.x)
    _write(scratch, place, PENDING_DIRECTION + 1, bits, d.y)
    _write(scratch, place, PENDING_DIRECTION + 2, bits, d.z)
    _write(scratch, place, PENDING_THROUGHPUT, bits, weight.x)
    _write(scratch, place, PENDING_THROUGHPUT + 1, bits, weight.y)
    _write(scratch, place, PENDING_THROUGHPUT + 2, bits, weight.z)
    _write(scratch, place, PENDING_SAMPLE, bits, load(INTEGERS, ray + SAMPLE))
    _write(scratch, place, PENDING_FROM, bits, splat(INTEGERS, _int64(-1) if plain else material))
    _write(scratch, place, PENDING_SKIP, bits, load(INTEGERS, ray + START))


@kernel
def _bounce_off(view: SceneView, scratch: Scratch, lanes: int, behind_lanes: int, material: int) -> None:
    """Send on what a material mirrors and lets through, of the hits on it."""
    i = N_MATERIAL * material
    kr, kt = at(view.materials, i + MATERIAL_KR), at(view.materials, i + MATERIAL_KT)
    clear = not is_black(kt)
    two_sided = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TWO_SIDED] != 0
    eta = view.materials[i + MATERIAL_ETA]
    mirror, both, pass_on = spread(kr), spread(add(kr, kt)), spread(kt)
    mirrors, all_mirror = not is_black(kr), not is_black(add(kr, kt))
    zero, one = splat(VECTOR, 0.0), splat(VECTOR, 1.0)
    for k in range(VECTORS):
        bits = (lanes >> (LANES * k)) & NIBBLE
        if bits == 0:
            continue
        ray = scratch.hits + STEP * k
        d, n = vector_at(ray + DIRECTION), vector_at(ray + NORMAL)
        depth = load(_int64, ray + DEPTH + 8 * count_trailing_zeros(bits)) + 1  # the same in all of a packet
        weight = mirror
        mirrored = bits if mirrors else _int64(0)
        if clear:
            behind = mask_from_bits(MASK, (behind_lanes >> (LANES * k)) & NIBBLE)
            facing = n if two_sided else choose(behind, negate(n), n)
            ratio = select(behind, splat(VECTOR, eta), splat(VECTOR, 1.0 / eta))
            along = ratio * -dot(d, facing)
            square = (one - ratio) * (one + ratio) + along * along
            through = square >= zero
            step = along - sqrt(maximum(square, zero))
            u_t = add(scale(d, ratio), scale(facing, step))
            passed = mask_to_bits(through) & bits
            if passed != 0:
                _push(
                    view,
                    scratch,
                    int64(TRANSMITTED),
                    ray,
                    passed,
                    depth,
                    u_t,
                    multiply(pass_on, vector_at(ray + THROUGHPUT)),
                    material,
                )
            weight = choose(through, mirror, both)  # total internal reflection sends the kt share along
            if all_mirror:
                mirrored |= bits & ~passed
        if mirrored != 0:
            twice = splat(VECTOR, 2.0) * dot(d, n)
            u_r = add(d, negate(scale(n, twice)))
            _push(
                view,
                scratch,
                int64(REFLECTED),
                ray,
                mirrored,
                depth,
                u_r,
                multiply(weight, vector_at(ray + THROUGHPUT)),
                material,
            )


@kernel
def make_bounces(view: SceneView, scratch: Scratch, lanes: int, behind_lanes: int) -> None:
    """Put what mirrors and lets through on the stacks.

    Parameters
    ----------
    view, scratch
        The scene; ``scratch.hits`` with all rows of the ray and of the hit.
    lanes
        The hits.
    behind_lanes
        Those that were met from behind.
    """
    while lanes != 0:
        material = load(_int64, scratch.hits + MATERIAL + 8 * count_trailing_zeros(lanes))
        wanted = splat(INTEGERS, material)
        same = _int64(0)
        for k in range(VECTORS):
            if (lanes >> (LANES * k)) & NIBBLE != 0:
                found = load(INTEGERS, scratch.hits + MATERIAL + STEP * k) == wanted
                same |= mask_to_bits(found) << (LANES * k)
        same &= lanes
        lanes &= ~same
        i = N_MATERIAL * material
        if not (is_black(at(view.materials, i + MATERIAL_KR)) and is_black(at(view.materials, i + MATERIAL_KT))):
            _bounce_off(view, scratch, same, behind_lanes, material)


@inline
def _deepest(scratch: Scratch, which: int, max_depth: int) -> Any:
    """Depth of a stack's topmost bounce, 0 when it is empty."""
    heights = scratch.heights + which * scratch.heights_row
    if load(_int64, heights) == 0:
        return _int64(0)
    depth = _int64(max_depth)
    while load(_int64, heights + 8 * depth) == 0:
        depth -= 1
    return depth


@inline
def n_mirrored(scratch: Scratch) -> Any:
    """Count the mirrored bounces of depth 1 that wait."""
    return load(_int64, scratch.heights + REFLECTED * scratch.heights_row + 8)


@kernel
def take_bounces(view: SceneView, scratch: Scratch, kept: int) -> Any:
    """Take up to 64 bounces of one depth off a stack, and make them the rays of ``scratch.hits``.

    Parameters
    ----------
    view, scratch
        The scene; stacks and rays.
    kept
        Mirrored bounces of depth 1 that stay, and with them all of depth 1 that is let through; -1: nothing stays.

    Returns
    -------
    int64
        How many; 0 when none waits.
    """
    max_depth = view.settings[SETTING_MAX_DEPTH]
    mirrored, passed = _deepest(scratch, int64(REFLECTED), max_depth), _deepest(scratch, int64(TRANSMITTED), max_depth)
    depth = max(mirrored, passed)
    if depth == 0:
        return _int64(0)
    which = int64(REFLECTED) if mirrored == depth else int64(TRANSMITTED)
    heights = scratch.heights + which * scratch.heights_row
    n = load(_int64, heights + 8 * depth)
    if kept >= 0 and depth == 1:
        n = n - kept if which == REFLECTED else _int64(0)
        if n <= 0:
            return _int64(0)
    n = min(_int64(PACKET), n)
    height = load(_int64, heights) - n
    store(heights, height)
    store(heights + 8 * depth, load(_int64, heights + 8 * depth) - n)
    stack = _stack(scratch, which) + 8 * height
    row = scratch.pending_row
    endless, none = splat(VECTOR, math.inf), splat(INTEGERS, _int64(-1))
    for step in range(0, 8 * n, STEP):
        source, ray = stack + step, scratch.hits + step
        for k in range(3):
            store(ray + ORIGIN + k * ROW, load(VECTOR, source + (PENDING_ORIGIN + k) * row))
            store(ray + DIRECTION + k * ROW, load(VECTOR, source + (PENDING_DIRECTION + k) * row))
            store(ray + THROUGHPUT + k * ROW, load(VECTOR, source + (PENDING_THROUGHPUT + k) * row))
        d = vector_at(ray + DIRECTION)
        shear_lanes(scratch.hits, step // STEP, d.x, d.y, d.z)
        store(ray + SAMPLE, load(INTEGERS, source + PENDING_SAMPLE * row))
        store(ray + FROM, load(INTEGERS, source + PENDING_FROM * row))
        store(ray + SKIP, load(INTEGERS, source + PENDING_SKIP * row))
        store(ray + DEPTH, splat(INTEGERS, depth))
        store(ray + T_BEST, endless)
        store(ray + PRIMITIVE, none)
    return n
