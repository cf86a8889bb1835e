"""Write wide nodes and leaves into the buffer.

Invariants: as :mod:`tracer.accel.layout`; `emit_subtree` writes exactly the bytes that
:func:`tracer.accel.collapse.measure` counted, so subtrees can be written side by side by several threads. Faces and
vertices lie anywhere in memory: all that a node's leaves need is asked for before the first of it is used.
"""

from typing import Any, Final

from tracer.accel import layout
from tracer.accel.binary import RECORD_BYTES
from tracer.accel.collapse import KIDS_BYTES, PLAN_BYTES, aligned, gather_children, is_leaf, leaf_bytes
from tracer.accel.layout import LEAF_BIT, NODE_BYTES, NODE_CHILDREN, NODE_HIGH, NODE_WIDTH, STACK_ENTRIES, UNIT
from tracer.jit import inline, kernel
from tracer.simd import address_of, load, prefetch, stack_memory, store
from tracer.simd.gateway import types

_float32: Final = types.float32
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64
_INF: Final = float("inf")
ORDER_BITS: Final = layout.ORDER_BITS

_SCRATCH_BYTES: Final = 2 * KIDS_BYTES
_WALK_STACK_BYTES: Final = 16 * STACK_ENTRIES

# The orders that three vertices can be sorted into, numbered: order p puts given vertex 1 at PLACE_1 >> 2p & 3
# and given vertex 2 at PLACE_2 >> 2p & 3.
ORDERS: Final = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
PLACE_1: Final = sum(order.index(1) << 2 * p for p, order in enumerate(ORDERS))
PLACE_2: Final = sum(order.index(2) << 2 * p for p, order in enumerate(ORDERS))


@inline
def _precedes(vertices: Any, a: int, b: int) -> bool:
    """Lexicographic order of two vertices."""
    if vertices[a, 0] != vertices[b, 0]:
        return bool(vertices[a, 0] < vertices[b, 0])
    if vertices[a, 1] != vertices[b, 1]:
        return bool(vertices[a, 1] < vertices[b, 1])
    return bool(vertices[a, 2] < vertices[b, 2])


@inline
def sorted_order(vertices: Any, a: int, b: int, c: int) -> Any:
    """Sort three vertices; returns (first, second, third, number of the order)."""
    if _precedes(vertices, b, a):
        if _precedes(vertices, c, b):
            return c, b, a, 5
        if _precedes(vertices, c, a):
            return b, c, a, 3
        return b, a, c, 2
    if _precedes(vertices, c, a):
        return c, a, b, 4
    if _precedes(vertices, c, b):
        return a, c, b, 1
    return a, b, c, 0


@inline
def _store_value(address: int, value: float, wide: int) -> None:
    if wide:
        store(address, _float64(value))
    else:
        store(address, _float32(value))


@inline
def _clear(address: int, end: int) -> None:
    """Zero the gap, so that equal meshes give equal files."""
    while address < end:
        store(address, _int32(0))
        address += 4


@inline
def _emit_leaf(target: int, records: int, first: int, count: int, vertices: Any, faces: Any, wide: int) -> None:
    size = 8 if wide else 4
    row = count * size
    for k in range(count):
        face = _int64(load(_int32, records + (first + k) * RECORD_BYTES + 12))
        a, b, c, order = sorted_order(vertices, _int64(faces[face, 0]), _int64(faces[face, 1]), _int64(faces[face, 2]))
        place = target + k * size
        for axis in range(3):
            _store_value(place + axis * row, vertices[a, axis], wide)
            _store_value(place + (3 + axis) * row, vertices[b, axis], wide)
            _store_value(place + (6 + axis) * row, vertices[c, axis], wide)
        store(target + 9 * row + 4 * k, _int32(face << ORDER_BITS | order))
    _clear(target + 9 * row + 4 * count, target + leaf_bytes(count, size))


@inline
def _emit_box(node: int, k: int, binary: int) -> None:
    """Write child k's box, that of a binary node."""
    for axis in range(3):
        store(node + axis * 32 + 4 * k, load(_float32, binary + 4 * axis))
        store(node + NODE_HIGH + axis * 32 + 4 * k, _float32(-load(_float32, binary + 16 + 4 * axis)))


@inline
def _emit_absent(node: int, k: int) -> None:
    """Mark child k as absent."""
    for axis in range(3):
        store(node + axis * 32 + 4 * k, _float32(_INF))
        store(node + NODE_HIGH + axis * 32 + 4 * k, _float32(-_INF))
    store(node + NODE_CHILDREN + 4 * k, _int32(0))


@inline
def _ask_for_leaves(nodes: int, plan: int, records: int, vertices: Any, faces: Any, kids: int, found: int) -> None:
    """Prefetch what the leaves among a node's children are made of: all of their faces, then all of their vertices."""
    for stage in range(2):
        for k in range(found):
            kid = load(_int64, kids + 8 * k)
            if not is_leaf(nodes, plan, kid):
                continue
            first = _int64(load(_int32, plan + kid * PLAN_BYTES + 4))
            for i in range(first, first + _int64(load(_int32, plan + kid * PLAN_BYTES))):
                face = _int64(load(_int32, records + i * RECORD_BYTES + 12))
                if stage == 0:
                    prefetch(address_of(faces) + face * 3 * faces.itemsize)
                else:
                    for corner in range(3):
                        prefetch(address_of(vertices) + _int64(faces[face, corner]) * 3 * vertices.itemsize)


@inline
def _emit_node(
    nodes: int,
    plan: int,
    records: int,
    vertices: Any,
    faces: Any,
    binary: int,
    base: int,
    offset: int,
    wide: int,
    scratch: int,
    inner: int,
) -> Any:
    """Write one wide node and its leaves; its inner children go to ``inner`` as pairs (binary node, word's offset).

    Returns (offset behind it, inner children).
    """
    start = offset
    node = base + start
    offset += NODE_BYTES
    n_inner = 0
    found = gather_children(nodes, plan, binary, scratch, scratch + KIDS_BYTES)
    _ask_for_leaves(nodes, plan, records, vertices, faces, scratch, found)
    for k in range(NODE_WIDTH):
        if k >= found:
            _emit_absent(node, k)
            continue
        kid = load(_int64, scratch + 8 * k)
        _emit_box(node, k, nodes + kid * RECORD_BYTES)
        if is_leaf(nodes, plan, kid):
            count = _int64(load(_int32, plan + kid * PLAN_BYTES))
            first = _int64(load(_int32, plan + kid * PLAN_BYTES + 4))
            _emit_leaf(base + offset, records, first, count, vertices, faces, wide)
            store(node + NODE_CHILDREN + 4 * k, _int32(LEAF_BIT | (offset // UNIT) << 3 | (count - 1)))
            offset += leaf_bytes(count, 8 if wide else 4)
        else:
            store(inner + 16 * n_inner, kid)
            store(inner + 16 * n_inner + 8, start + NODE_CHILDREN + 4 * k)
            n_inner += 1
    _clear(node + NODE_CHILDREN + 32, node + NODE_BYTES)
    _clear(base + offset, base + aligned(offset))
    return aligned(offset), n_inner


@kernel
def emit_node(
    nodes: Any,
    plan: Any,
    records: Any,
    vertices: Any,
    faces: Any,
    binary: int,
    buffer: Any,
    offset: int,
    wide: int,
    inner: Any,
) -> Any:
    """Write one wide node with its leaves, and list its inner children.

    Parameters
    ----------
    nodes, plan, records, vertices, faces, buffer, wide
        As for :func:`emit_subtree`.
    binary
        Chosen inner root.
    offset
        Byte at which the node goes.
    inner
        int64 (8, 2); receives (binary node, offset of its child word) of the inner children.

    Returns
    -------
    tuple of int
        (offset behind the node and its leaves, inner children).
    """
    scratch = stack_memory(_SCRATCH_BYTES)
    return _emit_node(
        address_of(nodes),
        address_of(plan),
        address_of(records),
        vertices,
        faces,
        binary,
        address_of(buffer),
        offset,
        wide,
        scratch,
        address_of(inner),
    )


@kernel
def emit_single_leaf(
    nodes: Any, records: Any, count: int, vertices: Any, faces: Any, buffer: Any, offset: int, wide: int
) -> int:
    """Write a root whose only child is a leaf of up to 8 records (none: no child); returns the offset behind it."""
    node = address_of(buffer) + offset
    for k in range(NODE_WIDTH):
        _emit_absent(node, k)
    _clear(node + NODE_CHILDREN + 32, node + NODE_BYTES)
    leaf = offset + NODE_BYTES
    if count == 0:
        return leaf
    _emit_box(node, 0, address_of(nodes))
    _emit_leaf(address_of(buffer) + leaf, address_of(records), 0, count, vertices, faces, wide)
    store(node + NODE_CHILDREN, _int32(LEAF_BIT | (leaf // UNIT) << 3 | (count - 1)))
    end = leaf + leaf_bytes(count, 8 if wide else 4)
    _clear(address_of(buffer) + end, address_of(buffer) + aligned(end))
    return int(aligned(end))


@kernel
def emit_subtree(
    nodes: Any, plan: Any, records: Any, vertices: Any, faces: Any, buffer: Any, offset: int, wide: int
) -> None:
    """Write the wide tree whose root is the binary one's.

    Parameters
    ----------
    nodes, plan, records
        The binary tree as float32 (m, 8), its plan as int32 (m, 4), the records as float32 (n, 8).
    vertices, faces
        (nv, 3) float32 or float64; (nf, 3) integers.
    buffer
        int64 words.
    offset
        Byte at which the subtree's root goes.
    wide
        1: leaf rows are float64.
    """
    node_base = address_of(nodes)
    plan_base = address_of(plan)
    record_base = address_of(records)
    base = address_of(buffer)
    scratch = stack_memory(_SCRATCH_BYTES)
    stack = stack_memory(_WALK_STACK_BYTES)
    store(stack, _int64(0))
    store(stack + 8, _int64(0))  # the root's word is the caller's to write
    top = stack + 16
    while top > stack:
        top -= 16
        index = load(_int64, top)
        word = load(_int64, top + 8)
        if word != 0:
            store(base + word, _int32((offset // UNIT) << 3))
        offset, n_inner = _emit_node(
            node_base, plan_base, record_base, vertices, faces, index, base, offset, wide, scratch, top
        )
        top += 16 * n_inner
