"""One ray at a time through the wide tree, one triangle after the other by the predicate.

No caller but the tests: what they hold the other paths against.

Invariant: at most `STACK_ENTRIES` entries wait, which the builder's depth bound guarantees.
"""

from typing import Any, Final

from tracer.accel.emit import ORDER_BITS
from tracer.accel.layout import HEADER_WIDE_LEAVES, NODE_CHILDREN, STACK_ENTRIES, UNIT
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.children import push_children
from tracer.rays.leaf import ANY, CLOSEST, COUNT, decide, finish, keep, leaf_of, over_sum, word_of
from tracer.rays.start import END, LANES, SCRATCH_BYTES, reach_of, start_rays
from tracer.simd import (
    address_of,
    float32x8,
    load,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    splat,
    stack_memory,
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
_STATES_BYTES: Final = LANES * s.STATE_BYTES
_SLOTS_BYTES: Final = 8 * LANES
_END: Final = END & 0xFFFFFFFF  # at distance 0: never dropped
_FAR_X, _FAR_Y, _FAR_Z = s.NEAR_AND_FAR


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _visit_leaf(wide: int, base: int, word: int, state: int, mode: int) -> bool:
    """Decide about all triangles of a leaf; tells whether the ray's answer changed."""
    leaf, n = leaf_of(base, word)
    changed = False
    for k in range(n):
        met, t, u, v, w = decide(wide, leaf, n, k, state)
        nearer = met and t < load(_float64, state + s.T_BEST)
        if mode == CLOSEST:
            face = word_of(wide, leaf, n, k)
            if nearer or (met and face >> ORDER_BITS < load(_int64, state + s.BEST_ID)):
                keep(state, face, t, over_sum(u, v, w))
                changed = True
        elif nearer and mode == COUNT:
            store(state + s.BEST_ID, load(_int64, state + s.BEST_ID) + 1)
        elif nearer:
            store(state + s.BEST_ID, _int64(0))
            return True
    return changed


@kernel
def trace(base: int, state: int, stack: int, near: int, mode: int) -> None:
    """Follow a started ray to its answer, left in the state.

    Parameters
    ----------
    base
        Address of the tree.
    state, stack, near
        Addresses: the ray, `STACK_ENTRIES` int64, 8 float32.
    mode
        CLOSEST, ANY or COUNT.
    """
    wide = load(_int64, base + 8 * HEADER_WIDE_LEAVES)
    rx = _spread(state + s.R)
    ry = _spread(state + s.R + 4)
    rz = _spread(state + s.R + 8)
    near_px = _spread(state + s.P_NEAR)
    near_py = _spread(state + s.P_NEAR + 4)
    near_pz = _spread(state + s.P_NEAR + 8)
    far_px = _spread(state + s.P_FAR)
    far_py = _spread(state + s.P_FAR + 4)
    far_pz = _spread(state + s.P_FAR + 8)
    near_x = load(_int64, state + s.NEAR_X)
    near_y = load(_int64, state + s.NEAR_Y)
    near_z = load(_int64, state + s.NEAR_Z)
    far_x, far_y, far_z = _FAR_X - near_x, _FAR_Y - near_y, _FAR_Z - near_z
    first = _spread(state + s.F_MIN)
    best = load(_float32, state + s.F_BEST)
    last = splat(float32x8, best)
    limit = (_int64(to_bits(best)) << 32) | 0xFFFFFFFF
    store(stack, _int64(_END))
    top = stack + 8
    word = load(_int64, state + s.NODE)
    while True:
        while word >= 0:
            node = base + word * (UNIT // 8)
            enter = maximum(
                maximum(
                    multiply_add(load(float32x8, node + near_x), rx, near_px),
                    multiply_add(load(float32x8, node + near_y), ry, near_py),
                ),
                maximum(multiply_add(load(float32x8, node + near_z), rz, near_pz), first),
            )
            leave = minimum(
                minimum(
                    multiply_add(load(float32x8, node + far_x), rx, far_px),
                    multiply_add(load(float32x8, node + far_y), ry, far_py),
                ),
                minimum(multiply_add(load(float32x8, node + far_z), rz, far_pz), last),
            )
            hits = mask_to_bits(enter <= leave)
            children = node + NODE_CHILDREN
            if hits == 0:
                break
            store(near, enter)
            top = push_children(_int64(0), hits, near, children, top) - 8
            word = _int64(_int32(load(_int64, top)))
        if word < 0:
            if word == END:
                return
            if _visit_leaf(wide, base, word, state, mode):
                if mode == ANY:
                    return
                best = load(_float32, state + s.F_BEST)
                last = splat(float32x8, best)
                limit = (_int64(to_bits(best)) << 32) | 0xFFFFFFFF
        top -= 8
        entry = load(_int64, top)
        if mode == CLOSEST:
            while entry > limit and entry != _END:
                top -= 8
                entry = load(_int64, top)
        word = _int64(_int32(entry))


@kernel
def trace_single(
    tree: Any, rays: Any, start: int, end: int, mode: int, out_t: Any, out_primitive: Any, out_u: Any, out_v: Any
) -> None:
    """Answer rays start..end, one ray at a time.

    Parameters
    ----------
    tree
        int64 words of the tree.
    rays
        Tuple of eight int64, as :func:`tracer.rays.start.start_rays` takes it.
    start, end
        Which rays.
    mode
        CLOSEST, ANY or COUNT.
    out_t, out_primitive, out_u, out_v
        float64, int32, float64, float64; rows start..end are written. ``out_primitive`` receives the primitive or -1,
        1 or 0 for ANY, the number of crossings for COUNT; the others are written for CLOSEST alone.
    """
    base = address_of(tree)
    reach = reach_of(base)
    outputs = (address_of(out_t), address_of(out_primitive), address_of(out_u), address_of(out_v))
    states = stack_memory(_STATES_BYTES)
    slots = stack_memory(_SLOTS_BYTES)
    rest = stack_memory(SCRATCH_BYTES)
    stack = stack_memory(_STACK_BYTES)
    near = stack_memory(_NEAR_BYTES)
    for k in range(LANES):
        store(slots + 8 * k, states + k * s.STATE_BYTES)
    for i in range(start, end, LANES):
        count = min(end - i, LANES)
        start_rays(slots, base, reach, rays, i, count, _int64(0), rest)
        for k in range(count):
            state = states + k * s.STATE_BYTES
            if load(_int64, state + s.NODE) != END:
                trace(base, state, stack, near, mode)
            finish(state, i + k, mode, outputs)
