"""A mesh of few triangles as :mod:`tracer.rays.brute` reads it: planes and lines in float32, corners in float64.

::

    64 bytes        int64: pairs of triangles whose plane's normal is nearest to x, to y, to z; single ones
    FEW planes      10 float32: m0 m1 m2 of the plane, then a b c of two lines in it, the area; those nearest to x
                    first, of them the pairs
    3 FEW records   9 float64, A.kx A.ky A.kz B.kx ... C.kz for kz = x, y, z; 3 int64: primitive; which of the corners
                    (0 .. 2) are the face's second and third as given

A plane's third axis is the one that its normal is nearest to, the first two follow in cyclic order. In the frame of
the tree it is the points with z + m0 x + m1 y + m2 = 0, and a point of it lies in the triangle when a x + b y + c is
positive for both lines, and their sum is below the area. Lines and area are divided by the longest edge. Two triangles
that make up a parallelogram, within the rounding that :mod:`tracer.rays.brute` allows for, share a plane: in the
second one both are below the area, and their sum is above.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel import layout
from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.accel.wide import WideBvh

FEW: Final = 64  # triangles
PAIRS: Final = 0
SINGLES: Final = 24
PLANES: Final = 64
PLANE_BYTES: Final = 40
RECORDS: Final = PLANES + FEW * PLANE_BYTES
RECORD_BYTES: Final = 96
_BYTES: Final = RECORDS + 3 * FEW * RECORD_BYTES
_SAME: Final = 2.0**-26  # frame units
_ROOT: Final = layout.HEADER_BYTES // layout.UNIT


def _leaves(bvh: WideBvh) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int32]]]:
    """Yield (9 rows of coordinates, words) of each leaf."""
    memory = bvh.buffer.view(np.uint8)
    dtype = np.float64 if bvh.buffer[layout.HEADER_WIDE_LEAVES] else np.float32
    waiting = [_ROOT << 3]
    while waiting:
        word = waiting.pop()
        start = (word & 0x7FFFFFF8) // 8 * layout.UNIT
        if word >= 0:
            node = memory[start : start + layout.NODE_BYTES]
            there = np.isfinite(node[:32].view(np.float32))
            waiting += node[layout.NODE_CHILDREN :].view(np.int32)[:8][there].tolist()
        else:
            n = (word & 7) + 1
            end = start + 9 * n * np.dtype(dtype).itemsize
            yield (
                memory[start:end].view(dtype).reshape(9, n).astype(np.float64),
                memory[end : end + 4 * n].view(np.int32),
            )


def _planes(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (n . x + d = 0 of each triangle's plane, its largest number 1; the axis of that).

    Of a triangle so slim that rounding turns its plane, one through its longest edge: the third corner is as near.
    """
    a, b, c = corners
    n = len(a)
    rows = np.arange(n)
    edges = np.stack([b - a, c - b, a - c])
    longest = edges[np.abs(edges).max(2).argmax(0), rows]
    across = np.zeros((n, 3))
    across[rows, np.abs(longest).argmin(1)] = 1.0
    best, off = np.zeros((n, 4)), np.full(n, np.inf)
    for normal in (np.cross(edges[0], edges[1]), np.cross(longest, across), across):
        size = np.abs(normal).max(1)
        unit = normal / np.where(size > 0.0, size, 1.0)[:, None]
        d = -(unit * a).sum(1)
        apart = np.abs((corners * unit).sum(2) + d).max(0)
        better = (size > 0.0) & (apart <= off) & (off > 2.0**-26)
        best[better], off[better] = np.column_stack([unit, d])[better], apart[better]
    axis = np.abs(best[:, :3]).argmax(1)
    return best / best[rows, axis][:, None], axis


def _same(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which of the points p, (n, 3), are which of q, (m, 3): (n, m)."""
    return np.asarray((np.abs(p[:, None] - q[None, :]) <= _SAME).all(2))


def _parallelograms(corners: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Find pairs of triangles that make up a parallelogram: (triangle, triangle, corner of the first off both)."""
    found: list[tuple[int, int, int]] = []
    for k in range(3):
        a, b, c = (corners[(k + step) % 3] for step in range(3))
        for off in range(3):
            d, e, g = (corners[(off + step) % 3] for step in range(3))
            match = _same(b + c - a, d) & ((_same(b, e) & _same(c, g)) | (_same(b, g) & _same(c, e)))
            found += [(int(i), int(j), k) for i, j in np.argwhere(match) if i < j]
    taken: set[int] = set()
    pairs = []
    for i, j, k in sorted(found):
        if i not in taken and j not in taken:
            taken |= {i, j}
            pairs.append((i, j, k))
    return pairs


def _lines(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 7): a b c of the lines on which the weight of B is 0, and that of C; the area. Corners are (n, 2)."""
    longest = np.abs([b - a, c - b, a - c]).max((0, 2))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    unit = np.where(area < 0.0, -1.0, 1.0) / np.where(longest > 0.0, longest, 1.0)
    numbers = []
    for p, q in ((c, a), (a, b)):
        x, y = (p[:, 1] - q[:, 1]) * unit, (q[:, 0] - p[:, 0]) * unit
        numbers += [x, y, -(x * p[:, 0] + y * p[:, 1])]
    return np.column_stack([*numbers, area * unit])


def tabulate(bvh: WideBvh) -> NDArray[np.float64]:
    """Make the table of a tree of at most `FEW` triangles.

    Returns
    -------
    float64
        The bytes as the module says, aligned to 64.
    """
    leaves = list(_leaves(bvh))
    rows = np.concatenate([leaf for leaf, _ in leaves], 1) if leaves else np.empty((9, 0))
    words = np.concatenate([word for _, word in leaves]).astype(np.int64) if leaves else np.empty(0, np.int64)
    floats = bvh.buffer.view(np.float64)
    centre, scale = floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3], floats[layout.FRAME_SCALE]
    corners = (rows.T.reshape(-1, 3, 3).transpose(1, 0, 2) - centre) * scale
    planes, axis = _planes(corners)

    pairs = _parallelograms(corners)
    second = {j for _, j, _ in pairs}
    partner = {i: (j, k) for i, j, k in pairs}
    firsts = sorted((i for i in range(len(words)) if i not in second), key=lambda i: (axis[i], i not in partner))
    slots = np.array([slot for i in firsts for slot in ((i, partner[i][0]) if i in partner else (i,))], np.int64)
    turn = np.array([partner[i][1] if i in partner else 0 for i in firsts], np.int64)

    memory: NDArray[Any] = np.zeros(_BYTES + 64, np.uint8)
    skip = -memory.ctypes.data % 64
    table = memory[skip : skip + _BYTES]
    for k in range(3):
        along = [i in partner for i in firsts if axis[i] == k]
        table[PAIRS : PAIRS + 24].view(np.int64)[k] = sum(along)
        table[SINGLES : SINGLES + 24].view(np.int64)[k] = len(along) - sum(along)
    n = len(firsts)
    numbers = table[PLANES:RECORDS].view(np.float32).reshape(FEW, 10)
    turned = (axis[firsts][:, None] + np.array([1, 2, 0])) % 3
    numbers[:n, :2] = np.take_along_axis(planes[firsts, :3], turned, 1)[:, :2]
    numbers[:n, 2] = planes[firsts, 3]
    flat = [np.take_along_axis(corners[(turn + k) % 3, firsts], turned, 1)[:, :2] for k in range(3)]
    numbers[:n, 3:] = _lines(*flat)
    records = table[RECORDS:].view(np.float64).reshape(3, FEW, RECORD_BYTES // 8)
    n, order = len(slots), words[slots] & ((1 << ORDER_BITS) - 1)
    for kz in range(3):
        cyclic = [3 * corner + (kz + k) % 3 for corner in range(3) for k in (1, 2, 0)]
        records[kz, :n, :9] = rows[cyclic][:, slots].T
        integers = records[kz].view(np.int64)
        integers[:n, 9] = words[slots] >> ORDER_BITS
        integers[:n, 10] = (PLACE_1 >> 2 * order) & 3
        integers[:n, 11] = (PLACE_2 >> 2 * order) & 3
    return table.view(np.float64)
