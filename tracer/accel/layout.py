"""The wide tree's memory layout: one flat buffer, read by address and mapped from a file as it is.

::

    header   256 bytes    HEADER_* int64 words, then FRAME_* float64 words
    node     256 bytes    x_lo y_lo z_lo x_hi y_hi z_hi: 8 float32 each (one a child); 8 int32 children; 32 spare
    leaf     9 rows of n coordinates (A.x A.y A.z B.x ... C.z; float32 or float64), then n int32 primitive ids

The root is the node behind the header. A node's leaves follow it, and its inner children come in depth-first order,
so a ray's next bytes are near its last ones; a large tree's top stands first, then its subtrees, one whole one after
the other. Offsets count `UNIT` bytes from the buffer's start.

A child word is ``offset << 3`` for a node and ``-2**31 | offset << 3 | n - 1`` for a leaf of n triangles: negative
means leaf. An absent child has the box (+inf, -inf), which no ray meets.

Invariants
----------
* Boxes live in the object's own frame, ``(world - centre) * scale`` with a power-of-two scale that brings the object
  into [-1, 1]: they are rounded outward to float32. Leaves hold world coordinates, exactly as given: as float32 where
  all of the object's are float32 numbers (then 52 bytes a triangle with nodes), else as float64 (then 89).
* A triangle's three vertices stand in lexicographic order, so that coincident triangles compute equal bits and the
  lowest id wins; the ray caster derives u and v for the given order.
* A leaf row may be read `LEAF_TRIANGLES` values wide from any of its chunks: the buffer ends with `PADDING` bytes.
* The depth is at most `MAX_DEPTH`: so a traversal never needs more than `STACK_ENTRIES` postponed children.
"""

from typing import Final

VERSION: Final = 5  # of this layout and of what the builder decides; part of every cache key
MAGIC: Final = 0x31564842494C4D53  # "SMLIBHV1" as little-endian bytes

UNIT: Final = 32  # bytes; child words have 28 bits for an offset, so a buffer holds 8 GiB
HEADER_BYTES: Final = 256
NODE_BYTES: Final = 256
NODE_WIDTH: Final = 8
NODE_CHILDREN: Final = 192  # byte offset of the child words
NODE_HIGH: Final = 96  # byte offset from a row of lower bounds to its row of upper bounds
LEAF_TRIANGLES: Final = 8
LEAF_BIT: Final = -(2**31)
PADDING: Final = 1024
ORDER_BITS: Final = 3  # a leaf's word is id << ORDER_BITS | order
STOP: Final = 2  # records that are not split further: of 3 or 4, one may be the wall behind all the others
SMALL: Final = 64  # records: smaller subtrees are not worth a task of their own
LARGEST: Final = 1e100  # |coordinate| of vertices and ray origins: products of three do not overflow
MAX_BYTES: Final = 2**28 * UNIT

MAX_DEPTH: Final = 64
STACK_ENTRIES: Final = (NODE_WIDTH - 1) * MAX_DEPTH + NODE_WIDTH + 2  # and room for one whole node written at once

# int64 words of the header
HEADER_MAGIC: Final = 0
HEADER_VERSION: Final = 1
HEADER_BYTE_COUNT: Final = 2  # of the buffer, padding included
HEADER_TRIANGLES: Final = 3  # in the tree
HEADER_NODES: Final = 4
HEADER_DEPTH: Final = 5  # nodes on the longest way down
HEADER_WIDE_LEAVES: Final = 6  # 1: leaf rows are float64

# float64 words of the header
FRAME_CENTRE: Final = 8  # 8..10, world
FRAME_SCALE: Final = 11
FRAME_HALF: Final = 12  # 12..14: half extents in the frame, rounded up
