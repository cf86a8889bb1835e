"""One ray at a time through the wide tree: nearest children first, the rest postponed on a stack.

A stack entry is ``bits(near) << 32 | child word``: non-negative floats order as their bits do, so one integer
comparison orders children by distance, and drops an entry that a nearer hit has overtaken.

Invariant: at most `STACK_ENTRIES` entries wait, which the builder's depth bound guarantees.
"""

from typing import Any, Final

from tracer.accel.layout import HEADER_BYTES, NODE_CHILDREN, NODE_HIGH, STACK_ENTRIES, UNIT
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.leaf import ANY, CLOSEST, COUNT, barycentrics, visit_leaf
from tracer.simd import (
    address_of,
    bytes_of,
    count_trailing_zeros,
    element_type,
    float32x8,
    load,
    load_as_float64,
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
_TIMES_BYTES: Final = 64
_STATE_BYTES: Final = s.STATE_BYTES
_END: Final = 0xFFFFFFFF  # child word -1 (no leaf has it) at distance 0: never dropped
_ROOT: Final = HEADER_BYTES // UNIT << 3


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _far(near_row: int) -> int:
    """Return the far row of an axis from its near row: the other of k and k + NODE_HIGH."""
    return near_row + NODE_HIGH if near_row < NODE_HIGH else near_row - NODE_HIGH


@inline
def _key(near: int, children: int, lane: int) -> Any:
    return (_int64(load(_int32, near + 4 * lane)) << 32) | (_int64(load(_int32, children + 4 * lane)) & 0xFFFFFFFF)


@inline
def _word(entry: int) -> Any:
    return _int64(_int32(entry))


@inline
def _push_many(hits: int, near: int, children: int, top: int) -> int:
    """Push all hit children, farthest first; returns the new top."""
    bottom = top
    while hits != 0:
        entry = _key(near, children, count_trailing_zeros(hits))
        hits &= hits - 1
        slot = top
        while slot > bottom and load(_int64, slot - 8) < entry:  # few are in place already
            store(slot, load(_int64, slot - 8))
            slot -= 8
        store(slot, entry)
        top += 8
    return top


@inline
def trace(rows: Any, base: int, state: int, stack: int, near: int, times: int, mode: int) -> None:
    """Follow a started ray to its answer, left in the state.

    Parameters
    ----------
    rows
        Scalar type of the leaf rows.
    base
        Address of the tree.
    state, stack, near, times
        Addresses: the ray, `STACK_ENTRIES` int64, 8 float32, 8 float64.
    mode
        CLOSEST, ANY or COUNT.
    """
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
    far_x, far_y, far_z = _far(near_x), _far(near_y), _far(near_z)
    first = _spread(state + s.F_MIN)
    best = load(_float32, state + s.F_BEST)
    last = splat(float32x8, best)
    up = splat(float32x8, _float32(s.UP))
    limit = (_int64(to_bits(best)) << 32) | 0xFFFFFFFF
    store(stack, _int64(_END))
    top = stack + 8
    word = _int64(_ROOT)
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
            hits = mask_to_bits(enter <= leave * up)
            children = node + NODE_CHILDREN
            if hits == 0:
                break
            i = count_trailing_zeros(hits)
            rest = hits & (hits - 1)
            if rest == 0:
                word = _int64(load(_int32, children + 4 * i))
                continue
            store(near, enter)
            a = _key(near, children, i)
            b = _key(near, children, count_trailing_zeros(rest))
            rest &= rest - 1
            if rest == 0:
                store(top, max(a, b))
                top += 8
                word = _word(min(a, b))
                continue
            c = _key(near, children, count_trailing_zeros(rest))
            rest &= rest - 1
            if rest == 0:
                low, high = min(a, b), max(a, b)
                least, other = min(low, c), max(low, c)
                store(top, max(high, other))
                store(top + 8, min(high, other))
                top += 16
                word = _word(least)
                continue
            top = _push_many(hits, near, children, top) - 8
            word = _word(load(_int64, top))
        if word < 0:
            if word == -1:
                return
            leaf = base + ((word & 0x7FFFFFF8) * (UNIT // 8))
            if visit_leaf(rows, leaf, (word & 7) + 1, state, times, mode):
                if mode == ANY:
                    return
                s.update_frame_best(state)
                best = load(_float32, state + s.F_BEST)
                last = splat(float32x8, best)
                limit = (_int64(to_bits(best)) << 32) | 0xFFFFFFFF
        top -= 8
        entry = load(_int64, top)
        if mode == CLOSEST:
            while entry > limit and entry != _END:
                top -= 8
                entry = load(_int64, top)
        word = _word(entry)


@inline
def start_from_arrays(state: int, base: int, rays: Any, kinds: Any, i: int) -> bool:
    """Start ray i of arrays given by address: see `addresses_of`."""
    origins, directions, t_min, t_min_step, t_max, t_max_step = rays
    kind_o, kind_d = kinds
    o = origins + 3 * i * bytes_of(kind_o)
    d = directions + 3 * i * bytes_of(kind_d)
    size_o = bytes_of(kind_o)
    size_d = bytes_of(kind_d)
    return bool(
        s.start_ray(
            state,
            base,
            load_as_float64(_float64, kind_o, o),
            load_as_float64(_float64, kind_o, o + size_o),
            load_as_float64(_float64, kind_o, o + 2 * size_o),
            load_as_float64(_float64, kind_d, d),
            load_as_float64(_float64, kind_d, d + size_d),
            load_as_float64(_float64, kind_d, d + 2 * size_d),
            load(_float64, t_min + t_min_step * i),
            load(_float64, t_max + t_max_step * i),
        )
    )


@inline
def addresses_of(origins: Any, directions: Any, t_min: Any, t_max: Any) -> Any:
    """Return the arrays' addresses and the steps of the limits: 0 where one limit serves all rays."""
    return (
        address_of(origins),
        address_of(directions),
        address_of(t_min),
        8 if t_min.shape[0] > 1 else 0,
        address_of(t_max),
        8 if t_max.shape[0] > 1 else 0,
    )


@kernel
def closest_single(
    rows: Any, tree: Any, origins: Any, directions: Any, t_min: Any, t_max: Any, start: int, end: int, hits: Any
) -> None:
    """Find the closest hits of rays start..end, one ray at a time.

    Parameters
    ----------
    rows
        Empty array of the leaf rows' dtype.
    tree
        int64 words of the tree.
    origins, directions
        (n, 3) float32 or float64.
    t_min, t_max
        float64, (n,) or (1,) for all.
    start, end
        Which rays.
    hits
        Tuple (t float64, primitive int32, u float64, v float64), each (n,); rows start..end are written.
    """
    out_t, out_primitive, out_u, out_v = hits
    base = address_of(tree)
    rays = addresses_of(origins, directions, t_min, t_max)
    kinds = (element_type(origins), element_type(directions))
    row_kind = element_type(rows)
    state = stack_memory(_STATE_BYTES)
    stack = stack_memory(_STACK_BYTES)
    near = stack_memory(_NEAR_BYTES)
    times = stack_memory(_TIMES_BYTES)
    for i in range(start, end):
        if start_from_arrays(state, base, rays, kinds, i):
            trace(row_kind, base, state, stack, near, times, CLOSEST)
        primitive = load(_int64, state + s.BEST_ID)
        out_primitive[i] = primitive
        if primitive >= 0:
            out_t[i] = load(_float64, state + s.T_BEST) * load(_float64, state + s.UNIT_T)
            out_u[i], out_v[i] = barycentrics(row_kind, state)
        else:
            out_t[i] = float("inf")
            out_u[i] = 0.0
            out_v[i] = 0.0


@kernel
def any_single(
    rows: Any, tree: Any, origins: Any, directions: Any, t_min: Any, t_max: Any, start: int, end: int, met: Any
) -> None:
    """Tell which of the rays start..end meet anything; ``met`` is bool (n,), the rest as `closest_single`."""
    base = address_of(tree)
    rays = addresses_of(origins, directions, t_min, t_max)
    kinds = (element_type(origins), element_type(directions))
    row_kind = element_type(rows)
    state = stack_memory(_STATE_BYTES)
    stack = stack_memory(_STACK_BYTES)
    near = stack_memory(_NEAR_BYTES)
    times = stack_memory(_TIMES_BYTES)
    for i in range(start, end):
        if start_from_arrays(state, base, rays, kinds, i):
            trace(row_kind, base, state, stack, near, times, ANY)
        met[i] = load(_int64, state + s.BEST_ID) >= 0


@kernel
def count_single(
    rows: Any, tree: Any, origins: Any, directions: Any, t_min: Any, t_max: Any, start: int, end: int, counts: Any
) -> None:
    """Count the crossings of the rays start..end; ``counts`` is int32 (n,), the rest as `closest_single`."""
    base = address_of(tree)
    rays = addresses_of(origins, directions, t_min, t_max)
    kinds = (element_type(origins), element_type(directions))
    row_kind = element_type(rows)
    state = stack_memory(_STATE_BYTES)
    stack = stack_memory(_STACK_BYTES)
    near = stack_memory(_NEAR_BYTES)
    times = stack_memory(_TIMES_BYTES)
    for i in range(start, end):
        ready = start_from_arrays(state, base, rays, kinds, i)
        store(state + s.BEST_ID, _int64(0))
        if ready:
            trace(row_kind, base, state, stack, near, times, COUNT)
        counts[i] = load(_int64, state + s.BEST_ID)
