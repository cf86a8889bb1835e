"""Children that are met go on a stack, nearest last.

A stack entry is ``bits(near) << 32 | child word``: non-negative floats order as their bits do, so one integer
comparison orders children by distance, and drops an entry that a nearer hit has overtaken.
"""

from typing import Any, Final

from tracer.accel.layout import UNIT
from tracer.jit import inline
from tracer.simd import count_trailing_zeros, load, prefetch, store
from tracer.simd.gateway import types

_int32: Final = types.int32
_int64: Final = types.int64

_LINES: Final = 4  # cache lines asked for: a node, or most of a leaf


@inline
def expect_child(base: int, word: int) -> None:
    """Ask for the memory of a node or leaf."""
    place = base + (word & 0x7FFFFFF8) * (UNIT // 8)
    for line in range(_LINES):
        prefetch(place + 64 * line)


@inline
def push_children(base: int, hits: int, near: int, children: int, top: int) -> Any:
    """Push children, farthest first; returns the new top.

    Parameters
    ----------
    base
        Address of the tree: the children's memory is asked for. 0: it is not.
    hits
        Bits of those that are met, of eight.
    near, children
        Addresses of eight float32, non-negative distances, and of the child words.
    top
        Address of the stack's next free entry.
    """
    bottom = top
    while hits != 0:
        lane = count_trailing_zeros(hits)
        hits &= hits - 1
        word = _int64(load(_int32, children + 4 * lane))
        entry = (_int64(load(_int32, near + 4 * lane)) << 32) | (word & 0xFFFFFFFF)
        if base != 0:
            expect_child(base, word)
        slot = top
        while slot > bottom and load(_int64, slot - 8) < entry:  # few are in place already
            store(slot, load(_int64, slot - 8))
            slot -= 8
        store(slot, entry)
        top += 8
    return top
