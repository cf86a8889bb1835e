"""Which binary nodes become wide nodes and leaves, by dynamic programming, and how many bytes they take.

For every binary node, ``cost[k]`` is the least SAH cost of its subtree as a forest of at most k wide nodes or leaves
(Ylitie et al. 2017, section 4). The recurrence over k is eight lanes wide: one row of costs is one vector.

Invariants: ``plan`` has a row (triangles, first record, choices, 0) for every binary node; where its records do not lie
side by side the first one is negative, and neither it nor a node above it becomes a leaf. Choice k is bits 4k..4k+3:
for k = 1, 0 makes a leaf of the subtree and i makes a wide node whose children are at most i roots of the left and
8 - i of the right child; for k > 1, 0 means "as k - 1" and i splits the k roots into i and k - i.
"""

from typing import Any, Final

from tracer.accel.binary import RECORD_BYTES, half_area
from tracer.accel.layout import LEAF_TRIANGLES, NODE_BYTES, NODE_WIDTH, STACK_ENTRIES, UNIT
from tracer.jit import inline, kernel
from tracer.simd import (
    address_of,
    count_trailing_zeros,
    float32x8,
    int32x8,
    iota,
    load,
    mask_to_bits,
    minimum,
    permute,
    reduce_add,
    reduce_min,
    select,
    splat,
    stack_memory,
    store,
)
from tracer.simd.gateway import types

_float32: Final = types.float32
_int32: Final = types.int32
_int64: Final = types.int64
_INF: Final = float("inf")

PLAN_BYTES: Final = 16
FORESTS: Final = NODE_WIDTH - 1  # costs for 1 .. 7 roots
# Costs relative to a node's visit, chosen and not fitted: other values tried differed by no more than noise. On AVX2
# a leaf takes its triangles four at a time.
NODE_COST: Final = 1.0
LEAF_COST: Final = 0.3
CHUNK_COST: Final = 0.7
CHUNK: Final = 4
_SCATTERED: Final = -(2**30)  # a first record that no other records lie beside
KIDS_BYTES: Final = 16 * (NODE_WIDTH + 1)
_WALK_STACK_BYTES: Final = 8 * STACK_ENTRIES


@inline
def _leaf_cost(area: float, count: int) -> Any:
    chunks = (count + CHUNK - 1) // CHUNK
    return area * (_float32(LEAF_COST) + _float32(CHUNK_COST) * _float32(chunks))


@inline
def _shifted(row: Any, lanes: Any, by: int) -> Any:
    """Move the row up by so many lanes, infinity below."""
    return select(lanes >= splat(int32x8, by), permute(row, lanes - splat(int32x8, by)), splat(float32x8, _INF))


@kernel
def plan_nodes(nodes: Any, n_nodes: int, costs: Any, plan: Any) -> None:
    """Fill the plan of a binary tree.

    Parameters
    ----------
    nodes, plan
        As the module says. A node of a negative count (word 7) is the root of a tree that is planned elsewhere: its
        rows of the plan and of the costs are the caller's to fill.
    n_nodes
        How many.
    costs
        float32 (m, 8), scratch.
    """
    node_base = address_of(nodes)
    cost_base = address_of(costs)
    plan_base = address_of(plan)
    lanes = iota(int32x8)
    infinite = splat(float32x8, _INF)
    none = splat(int32x8, 0)
    mirrored = (splat(int32x8, NODE_WIDTH) - lanes) & splat(int32x8, NODE_WIDTH - 1)
    for index in range(n_nodes - 1, -1, -1):
        node = node_base + index * RECORD_BYTES
        row = cost_base + index * RECORD_BYTES
        entry = plan_base + index * PLAN_BYTES
        count = load(_int32, node + 28)
        if count < 0:
            continue
        area = half_area(load(float32x8, node))
        child = _int64(load(_int32, node + 12))
        if count > 0:
            store(row, select(lanes > none, splat(float32x8, _leaf_cost(area, count)), infinite))
            store(entry, _int32(count))
            store(entry + 4, _int32(child))
            store(entry + 8, _int32(0))
            continue
        left = cost_base + child * RECORD_BYTES
        left_row = load(float32x8, left)
        right_row = load(float32x8, left + RECORD_BYTES)
        left_entry, right_entry = plan_base + child * PLAN_BYTES, plan_base + (child + 1) * PLAN_BYTES
        count = load(_int32, left_entry) + load(_int32, right_entry)
        # a wide node of 8 roots: i from the left, 8 - i from the right (lane 0 is infinite)
        together = left_row + permute(right_row, mirrored)
        inner = reduce_min(together)
        split = count_trailing_zeros(mask_to_bits(together == splat(float32x8, inner)) | 128)
        inner = inner + area * _float32(NODE_COST)
        leaf = _float32(_INF)
        # a leaf holds neighbouring records; groups that were joined (`tracer.accel.clusters`) lie anywhere
        first = load(_int32, left_entry + 4)
        beside = first + load(_int32, left_entry) == load(_int32, right_entry + 4)
        if count <= LEAF_TRIANGLES and beside:
            leaf = _leaf_cost(area, count)
        single = min(leaf, inner)
        choice_single = _int32(split) if inner < leaf else _int32(0)
        best = infinite
        choice = none
        for i in range(1, FORESTS):
            candidate = splat(float32x8, load(_float32, left + 4 * i)) + _shifted(right_row, lanes, i)
            better = candidate < best
            best = select(better, candidate, best)
            choice = select(better, splat(int32x8, i), choice)
        # at most k roots: the least over 1 .. k
        best = select(lanes == splat(int32x8, 1), splat(float32x8, single), best)
        least = minimum(best, _shifted(best, lanes, 1))
        least = minimum(least, _shifted(least, lanes, 2))
        least = minimum(least, _shifted(least, lanes, 4))
        choice = select(best < _shifted(least, lanes, 1), choice, none)
        choice = select(lanes == splat(int32x8, 1), splat(int32x8, choice_single), choice)
        store(row, least)
        store(entry, _int32(count))
        store(entry + 4, first if beside else _int32(_SCATTERED))
        store(entry + 8, reduce_add(choice << (lanes << 2)))


@inline
def choice_of(plan: int, node: int, roots: int) -> Any:
    """Read choice k of a binary node."""
    return (_int64(load(_int32, plan + node * PLAN_BYTES + 8)) >> (4 * roots)) & 15


@inline
def is_leaf(nodes: int, plan: int, node: int) -> Any:
    """Tell whether a chosen root becomes a leaf."""
    return load(_int32, nodes + node * RECORD_BYTES + 28) > 0 or choice_of(plan, node, 1) == 0


@inline
def leaf_bytes(count: int, value_bytes: int) -> int:
    """Bytes of a leaf of so many triangles."""
    return (count * (9 * value_bytes + 4) + UNIT - 1) // UNIT * UNIT


@inline
def aligned(offset: int) -> int:
    """Round up to a cache line, where every node begins."""
    return (offset + 63) // 64 * 64


@inline
def gather_children(nodes: int, plan: int, node: int, kids: int, stack: int) -> int:
    """Write the binary nodes that a wide node's children are into ``kids`` (int64 each); return how many."""
    found = 0
    child = _int64(load(_int32, nodes + node * RECORD_BYTES + 12))
    split = choice_of(plan, node, 1)
    store(stack, child + 1)
    store(stack + 8, NODE_WIDTH - split)
    store(stack + 16, child)
    store(stack + 24, split)
    top = stack + 32
    while top > stack:
        top -= 16
        here = load(_int64, top)
        roots = load(_int64, top + 8)
        split = 0
        while roots > 1 and split == 0:
            split = choice_of(plan, here, roots)
            if split == 0:
                roots -= 1
        if roots == 1:
            store(kids + 8 * found, here)
            found += 1
            continue
        child = _int64(load(_int32, nodes + here * RECORD_BYTES + 12))
        store(top, child + 1)
        store(top + 8, roots - split)
        store(top + 16, child)
        store(top + 24, split)
        top += 32
    return found


@kernel
def measure(nodes: Any, plan: Any, value_bytes: int) -> Any:
    """Return (bytes, wide nodes, depth) of the wide tree whose root is the binary one's."""
    node_base = address_of(nodes)
    plan_base = address_of(plan)
    kids = stack_memory(KIDS_BYTES)
    forest = stack_memory(KIDS_BYTES)
    stack = stack_memory(_WALK_STACK_BYTES)
    store(stack, _int64(1))
    top = stack + 8
    size = 0
    n_nodes = 0
    depth = 0
    while top > stack:
        top -= 8
        word = load(_int64, top)
        level = word & 255
        depth = max(depth, level)
        n_nodes += 1
        size += NODE_BYTES
        for k in range(gather_children(node_base, plan_base, word >> 8, kids, forest)):
            kid = load(_int64, kids + 8 * k)
            if is_leaf(node_base, plan_base, kid):
                size += leaf_bytes(_int64(load(_int32, plan_base + kid * PLAN_BYTES)), value_bytes)
            else:
                store(top, kid << 8 | (level + 1))
                top += 8
        size = aligned(size)
    return size, n_nodes, depth
