"""Many rays in flight through the wide tree, so that waiting for memory and for branches of one ray serves others.

Each ray has a state and a stack of its own. Rays whose next stop is a node stand in one list, those at a leaf in a
second, those of whose leaf a triangle may be met in a third, those that are done in a fourth. A round goes through each
list, the first until few rays are left in it, takes every ray one step further and asks for the memory of its next
stop. A node's step has no branch that depends on the ray: the eight keys are sorted by a network, missed children last,
all are written, and the stack grows by those that were met; one that empties its stack there is found out among those
at leaves, so that a node's step has two lists to write to. Triangles are decided for four rays at a time
(:mod:`tracer.rays.leaf_four`); a ray waits for three others as long as there is something else to do.

Invariant: the answer is that of :mod:`tracer.rays.single`, bit for bit: a leaf decides alike on every path, and what is
left is the least (t, id), in whatever order leaves are visited.
"""

from typing import Any, Final

from tracer.accel.layout import HEADER_DEPTH, HEADER_WIDE_LEAVES, NODE_CHILDREN, NODE_WIDTH, STACK_ENTRIES, UNIT
from tracer.jit import inline, kernel
from tracer.rays import state as s
from tracer.rays.children import expect_child
from tracer.rays.leaf import CLOSEST, finish, leaf_of, sift_leaf
from tracer.rays.leaf_four import RAYS, visit_next
from tracer.rays.packet_start import FOUR_BYTES, finish_lane, start_lanes
from tracer.rays.start import END, LANES, SCRATCH_BYTES, reach_of, start_rays
from tracer.simd import (
    address_of,
    float32x8,
    int32x8,
    iota,
    load,
    mask8,
    mask_from_bits,
    mask_to_bits,
    maximum,
    minimum,
    multiply_add,
    permute,
    population_count,
    prefetch,
    select,
    splat,
    stack_memory,
    store,
    to_bits,
    unlikely,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_int32: Final = types.int32
_int64: Final = types.int64

IN_FLIGHT: Final = 40
_FEW: Final = 8  # rays at nodes at which they wait for the others: a list's end costs a mispredicted branch, too
_WIDEST: Final = 64 * ((4 * STACK_ENTRIES + 63) // 64 | 1)
# From near distances, those of all rays together, to child words: an odd number of cache lines, for other L1 sets.
_WORDS: Final = IN_FLIGHT * _WIDEST + 64
_ALL_STACKS_BYTES: Final = 2 * _WORDS
_ALL_STATES_BYTES: Final = IN_FLIGHT * s.STATE_BYTES
_LIST_BYTES: Final = 8 * IN_FLIGHT + 64
_REST_BYTES: Final = max(SCRATCH_BYTES, FOUR_BYTES)
_BOTTOM: Final = -(2**31)  # nearer than anything: never dropped
_FAR_X, _FAR_Y, _FAR_Z = s.NEAR_AND_FAR


@inline
def _stack_bytes(depth: int) -> Any:
    """Bytes from one ray's stack to the next one's, as many as a tree of this depth needs: the fewer pages the better.

    An odd number of cache lines, so that the stacks' bottoms do not share L1 sets.
    """
    entries = (NODE_WIDTH - 1) * depth + NODE_WIDTH + 2
    return min(64 * ((4 * entries + 63) // 64 | 1), _WIDEST)


@inline
def _spread(address: int) -> Any:
    return splat(float32x8, load(_float32, address))


@inline
def _compare_exchange(keys: Any, lanes: Any, distance: int, high_first: int) -> Any:
    """Order the keys of lanes i and i ^ distance; lanes of ``high_first`` receive the higher one."""
    other = permute(keys, lanes ^ splat(int32x8, distance))
    return select(mask_from_bits(mask8, high_first), maximum(keys, other), minimum(keys, other))


@inline
def _sorted(keys: Any, lanes: Any) -> Any:
    """Sort eight keys, the highest into lane 0 (bitonic, Batcher 1968)."""
    keys = _compare_exchange(keys, lanes, 1, 0b10011001)
    keys = _compare_exchange(keys, lanes, 2, 0b11000011)
    keys = _compare_exchange(keys, lanes, 1, 0b10100101)
    keys = _compare_exchange(keys, lanes, 4, 0b00001111)
    keys = _compare_exchange(keys, lanes, 2, 0b00110011)
    return _compare_exchange(keys, lanes, 1, 0b01010101)


@inline
def _visit_node(base: int, state: int) -> Any:
    """Test the children of the ray's node, push those that are met, the nearest last; returns the stack's new top."""
    node = base + load(_int64, state + s.NODE) * (UNIT // 8)
    near_x = load(_int64, state + s.NEAR_X)
    near_y = load(_int64, state + s.NEAR_Y)
    near_z = load(_int64, state + s.NEAR_Z)
    rx = _spread(state + s.R)
    ry = _spread(state + s.R + 4)
    rz = _spread(state + s.R + 8)
    enter = maximum(
        maximum(
            multiply_add(load(float32x8, node + near_x), rx, _spread(state + s.P_NEAR)),
            multiply_add(load(float32x8, node + near_y), ry, _spread(state + s.P_NEAR + 4)),
        ),
        maximum(
            multiply_add(load(float32x8, node + near_z), rz, _spread(state + s.P_NEAR + 8)), _spread(state + s.F_MIN)
        ),
    )
    leave = minimum(
        minimum(
            multiply_add(load(float32x8, node + (_FAR_X - near_x)), rx, _spread(state + s.P_FAR)),
            multiply_add(load(float32x8, node + (_FAR_Y - near_y)), ry, _spread(state + s.P_FAR + 4)),
        ),
        minimum(
            multiply_add(load(float32x8, node + (_FAR_Z - near_z)), rz, _spread(state + s.P_FAR + 8)),
            _spread(state + s.F_BEST),
        ),
    )
    met = enter <= leave
    lanes = iota(int32x8)
    # the three lowest bits of the distance, rounded down, make room for the child's number
    keys = (to_bits(enter) & splat(int32x8, -8)) | lanes
    keys = _sorted(select(met, keys, splat(int32x8, -1)), lanes)
    top = load(_int64, state + s.STACK_TOP)
    store(top, keys)
    store(top + _WORDS, permute(load(int32x8, node + NODE_CHILDREN), keys & splat(int32x8, 7)))
    return top + 4 * population_count(mask_to_bits(met))


@inline
def _go_to(base: int, state: int, top: int) -> Any:
    """Take the stack's upmost entry as the ray's next stop, and ask for its memory; returns its child word."""
    top -= 4
    word = _int64(load(_int32, top + _WORDS))
    store(state + s.STACK_TOP, top)
    store(state + s.NODE, word)
    expect_child(base, word)
    return word


@inline
def _step(base: int, state: int, nodes: int, leaves: int) -> Any:
    """Visit the ray's node and append the ray to the list of its next stop; returns both lists' new ends."""
    word = _go_to(base, state, _visit_node(base, state))
    store(nodes, state)
    store(leaves, state)
    is_leaf = 8 * (word >> 63)
    return nodes + 8 + is_leaf, leaves - is_leaf


@inline
def _without_overtaken(state: int, top: int) -> Any:
    """Drop the upmost entries that a hit has overtaken; returns the new top."""
    limit = load(_int32, state + s.F_BEST)
    while load(_int32, top - 4) > limit:
        top -= 4
    return top


@inline
def _enlist(word: int, state: int, nodes: int, leaves: int, done: int) -> Any:
    """Append a ray to the list of its next stop, without a branch; returns the lists' new ends."""
    store(nodes, state)
    store(leaves, state)
    store(done, state)
    is_end = 8 * _int64(word == END)
    is_leaf = -8 * (word >> 63)
    return nodes + 8 - is_leaf, leaves + is_leaf - is_end, done + is_end


@inline
def _sort_out(candidates: int, state: int, found: int, ready: int) -> Any:
    """Note a ray's candidates, and append it to those with any or to those without; returns the lists' new ends."""
    store(state + s.CANDIDATES, candidates)
    store(found, state)
    store(ready, state)
    nothing = 8 * _int64(candidates == 0)
    return found + 8 - nothing, ready + nothing


@inline
def _sift_leaves(wide: int, base: int, first: int, last: int, found: int, ready: int, done: int) -> Any:
    """Sift the leaves of listed rays; returns the ends of the lists of those with candidates, without, and done."""
    for place in range(first, last, 8):
        state = load(_int64, place)
        word = load(_int64, state + s.NODE)
        if unlikely(word == END):
            store(done, state)
            done += 8
            continue
        leaf, n = leaf_of(base, word)
        found, ready = _sort_out(sift_leaf(wide, leaf, n, state), state, found, ready)
    return found, ready, done


@inline
def _expect(outputs: Any, i: int) -> None:
    """Ask for the memory that the answer of ray i will be written to."""
    prefetch(outputs[0] + 8 * i)
    prefetch(outputs[1] + 4 * i)
    prefetch(outputs[2] + 8 * i)
    prefetch(outputs[3] + 8 * i)


@kernel
def trace_stream(
    tree: Any, rays: Any, start: int, end: int, mode: int, out_t: Any, out_primitive: Any, out_u: Any, out_v: Any
) -> None:
    """Answer rays start..end, many in flight; parameters as :func:`tracer.rays.single.trace_single`."""
    outputs = (address_of(out_t), address_of(out_primitive), address_of(out_u), address_of(out_v))
    follow(address_of(tree), rays, _int64(0), start, end, mode, outputs)


@inline
def follow(base: int, rays: Any, listed: int, start: int, end: int, mode: int, outputs: Any) -> None:
    """Answer rays of arrays, many in flight; parameters as for `follow_all`."""
    no = _int64(0)
    follow_all(base, rays, (no, no, no, no), listed, start, end, mode, outputs)


@kernel
def follow_all(base: int, rays: Any, shading: Any, listed: int, start: int, end: int, mode: int, outputs: Any) -> Any:
    """Answer rays, many in flight.

    Parameters
    ----------
    base
        Address of the tree.
    rays, mode
        As for :func:`tracer.rays.single.trace_single`. Without meaning for rays of a packet.
    shading
        0: the rays are those of arrays. Else their packet's address, and more as :mod:`tracer.rays.leaf_four` says.
    listed
        Address of int64, the rays' numbers, of which start .. end are meant; 0: the numbers are start .. end.
    outputs
        Addresses of what :func:`tracer.rays.single.trace_single` writes. Without meaning for rays of a packet.

    Returns
    -------
    int64
        A packet's rays that met something (ANY), or have no light left (SHADE); else 0.
    """
    packet = shading[0]
    ended = _int64(0)
    wide = load(_int64, base + 8 * HEADER_WIDE_LEAVES)
    reach = reach_of(base)
    states = stack_memory(_ALL_STATES_BYTES)
    stacks = stack_memory(_ALL_STACKS_BYTES)
    nodes = stack_memory(_LIST_BYTES)
    leaves = stack_memory(_LIST_BYTES)
    done = stack_memory(_LIST_BYTES)
    free = stack_memory(_LIST_BYTES)
    found = stack_memory(_LIST_BYTES)
    ready = stack_memory(_LIST_BYTES)
    rest = stack_memory(_REST_BYTES)
    stack_bytes = _stack_bytes(load(_int64, base + 8 * HEADER_DEPTH))
    for k in range(IN_FLIGHT):
        state = states + k * s.STATE_BYTES
        stack = stacks + k * stack_bytes
        store(free + 8 * k, state)
        store(state + s.STACK, stack)
        store(stack, _int32(_BOTTOM))
        store(stack + _WORDS, _int32(END))
    nodes_end, leaves_end, found_end, done_end = nodes, leaves, found, done
    free_end = free + 8 * IN_FLIGHT
    i = start
    while i < end or free_end < free + 8 * IN_FLIGHT:
        while i < end and free_end >= free + 8 * LANES:
            free_end -= 8 * LANES
            count = min(end - i, LANES)
            if packet != 0:
                start_lanes(free_end, base, reach, packet, listed + 8 * i, count, mode, rest)
            else:
                start_rays(free_end, base, reach, rays, i, count, listed, rest)
            for k in range(count):
                state = load(_int64, free_end + 8 * k)
                store(state + s.STACK_TOP, load(_int64, state + s.STACK) + 4)
                store(state + s.RAY_INDEX, load(_int64, listed + 8 * (i + k)) if listed != 0 else i + k)
                if unlikely(load(_int64, state + s.NODE) == END):
                    store(done_end, state)
                    done_end += 8
                else:
                    nodes_end, leaves_end = _step(base, state, nodes_end, leaves_end)
            for k in range(count, LANES):  # behind the last ray
                store(free_end + 8 * (k - count), load(_int64, free_end + 8 * k))
            free_end += 8 * (LANES - count)
            if mode == CLOSEST and packet == 0:
                _expect(outputs, load(_int64, listed + 8 * i) if listed != 0 else i)
            i += count
        while True:
            last, nodes_end = nodes_end, nodes
            for place in range(nodes, last, 8):
                nodes_end, leaves_end = _step(base, load(_int64, place), nodes_end, leaves_end)
            if nodes_end <= nodes + 8 * _FEW:
                break
        last, leaves_end, ready_end = leaves_end, leaves, ready
        # written out for both: what is common to them could not have the loads as parts of its instructions
        if wide != 0:
            found_end, ready_end, done_end = _sift_leaves(_int64(1), base, leaves, last, found_end, ready_end, done_end)
        else:
            found_end, ready_end, done_end = _sift_leaves(_int64(0), base, leaves, last, found_end, ready_end, done_end)
        others = nodes_end - nodes + (ready_end - ready) + (done_end - done)
        enough = found + 8 * (RAYS if others > 0 else 1)
        while found_end >= enough:
            count = min((found_end - found) // 8, RAYS)
            found_end -= 8 * count
            first, last = found_end, found_end + 8 * count
            for place in range(last, first + 8 * RAYS, 8):
                store(place, load(_int64, first))
            visit_next(wide, base, first, count, mode, shading)
            for place in range(first, last, 8):
                state = load(_int64, place)
                candidates = load(_int64, state + s.CANDIDATES)
                found_end, ready_end = _sort_out(candidates & (candidates - 1), state, found_end, ready_end)
        for place in range(ready, ready_end, 8):
            state = load(_int64, place)
            word = _go_to(base, state, _without_overtaken(state, load(_int64, state + s.STACK_TOP)))
            nodes_end, leaves_end, done_end = _enlist(word, state, nodes_end, leaves_end, done_end)
        for place in range(done, done_end, 8):
            state = load(_int64, place)
            if packet != 0:
                ended |= finish_lane(state, packet, mode)
            else:
                finish(state, load(_int64, state + s.RAY_INDEX), mode, outputs)
            store(free_end, state)
            free_end += 8
        done_end = done
    return ended
