"""Where a tree stands in the world: an affine map there and back, and what going there and back costs in accuracy.

A ray that meets a placement is moved to the object's space, and what is found there belongs to the same t. With L the
map's linear part, A its inverse with every number rounded once, B = |L| |A| and W = |L| max |vertex|, per axis:

* a vertex in the world, ``(a x + b y + c z) + origin``, is off by gamma(3) W and one rounding of its coordinates;
* the surface that rays see is the inverse image under A, off by eps B W from that under L;
* the next ray's origin o in the object's space, A (o - origin), is off by gamma(4) B W, seen from the world;
* its direction is off by gamma(6) (three roundings of the direction from its shear, three of the product), which after
  crossing the object, 2 W, comes to gamma(12) B W;
* the predicate rounds five times on coordinates of at most twice the object's size: gamma(10) B W.

The sum is below gamma(32) B W, and gamma(4) (W + |origin|) of the coordinates' own rounding: `MAP_ERROR`, by which a
hit's error bound grows, so that no ray that leaves a placement's surface meets it again. B is 1 for turns by right
angles and scales along the axes, its rows sum up to at most 3 for a rigid turn, and to more the more skewed the map.

Beside its world box a ray passes by at most gamma(8) times the row sum of B times the distance: `MAP_PAD` holds more.

Source: Higham, "Accuracy and Stability of Numerical Algorithms", 3.1, 3.5.
"""

from fractions import Fraction
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import layout
from tracer.geometry.rounding import gamma
from tracer.types import (
    MAP_BOX,
    MAP_ERROR,
    MAP_ORIGIN,
    MAP_PAD,
    MAP_TO_OBJECT,
    MAP_TO_WORLD,
    N_MAP,
    PLACED_AS_IS,
    PLACED_MIRRORED,
    PLACED_MOVED,
)

_PAD: Final = 2.0**-44  # 512 roundings: gamma(8) and the slab test's own
_OUTWARD: Final = 2.0**-48  # of a box's coordinates, for the roundings in computing it
_OUTLINE_BOXES: Final = 64  # boxes of a tree's upper nodes that bound a placement


class AffineMap(NamedTuple):
    """From an object's space to the world: p_world = origin + linear @ p_object."""

    linear: NDArray[np.float64]  # (3, 3)
    origin: NDArray[np.float64]  # (3,)

    @classmethod
    def of_rows(cls, rows: Any) -> "AffineMap":
        """Take the parts of a matrix of 4 rows (or 3) of 4 numbers."""
        matrix = np.array(rows, np.float64)
        return cls(np.ascontiguousarray(matrix[:3, :3]), matrix[:3, 3].copy())


def inverse_of(linear: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Invert a 3 x 3 matrix: every number is the exact one, rounded once.

    Returns
    -------
    float64 (3, 3) or None
        None where there is no inverse within the range of float64.
    """
    m = [[Fraction(float(number)) for number in row] for row in linear]

    def cofactor(i: int, j: int) -> Fraction:
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return m[a][c] * m[b][d] - m[a][d] * m[b][c]

    determinant = sum((m[0][j] * cofactor(0, j) for j in range(3)), Fraction())
    if determinant == 0:
        return None
    try:
        return np.array([[float(cofactor(j, i) / determinant) for j in range(3)] for i in range(3)])
    except OverflowError:
        return None


def skewness(there: AffineMap) -> float:
    """How much going to the object's space and back can magnify a rounding error: largest row sum of B; inf: no way."""
    back = inverse_of(there.linear)
    if back is None:
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        sums = (np.abs(there.linear) @ np.abs(back)).sum(axis=1)
    largest = float(sums.max())
    return largest if np.isfinite(sums).all() else np.inf


def outline(tree: NDArray[np.int64]) -> NDArray[np.float64]:
    """Bound a tree's triangles by the boxes of its upper nodes.

    Parameters
    ----------
    tree : int64 (n,)
        A tree's buffer.

    Returns
    -------
    float64 (m, 2, 3)
        Centres and half extents in the tree's own space; none for an empty tree.
    """
    floats, bytes_of = tree.view(np.float64), tree.view(np.uint8)
    centre, scale = floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3], floats[layout.FRAME_SCALE]

    def children(offset: int) -> list[tuple[NDArray[np.float64], int]]:
        rows = bytes_of[offset : offset + layout.NODE_CHILDREN].view(np.float32).reshape(2, 3, layout.NODE_WIDTH)
        words = bytes_of[offset + layout.NODE_CHILDREN :][: 4 * layout.NODE_WIDTH].view(np.int32)
        boxes = rows.astype(np.float64)
        there = np.flatnonzero(boxes[0, 0] <= boxes[1, 0])
        return [(boxes[:, :, k], int(words[k])) for k in there]

    known = children(layout.HEADER_BYTES)
    while True:
        inner = [k for k, (_, word) in enumerate(known) if word >= 0]
        if not inner or len(known) + layout.NODE_WIDTH > _OUTLINE_BOXES:
            break
        largest = max(inner, key=lambda k: float((known[k][0][1] - known[k][0][0]).sum()))
        known += children((known.pop(largest)[1] >> 3) * layout.UNIT)
    if not known:
        return np.empty((0, 2, 3))
    boxes = np.array([box for box, _ in known])
    low, high = boxes[:, 0] / scale, boxes[:, 1] / scale  # a power of two
    size = _OUTWARD * (np.abs(centre) + np.maximum(np.abs(low), np.abs(high)))
    return np.stack([centre + (low * 0.5 + high * 0.5), (high - low) * 0.5 + size], axis=1)


def box_of(outlines: NDArray[np.float64], there: AffineMap | None) -> NDArray[np.float64]:
    """Bound outlines in the world.

    Returns
    -------
    float64 (6,)
        Lower, then upper corner; (+inf, -inf) for none.
    """
    if len(outlines) == 0:
        return np.array([np.inf] * 3 + [-np.inf] * 3)
    middle, half = outlines[:, 0], outlines[:, 1]
    if there is not None:
        size = np.abs(there.linear)
        slack = _OUTWARD * (np.abs(there.origin) + np.abs(middle) @ size.T + half @ size.T)
        middle, half = there.origin + middle @ there.linear.T, half @ size.T + slack
    return np.concatenate([(middle - half).min(axis=0), (middle + half).max(axis=0)])


def kind_of(there: AffineMap | None) -> int:
    """Return the PLACED_* of a map; None is the identity."""
    if there is None:
        return PLACED_AS_IS
    m = [[Fraction(float(number)) for number in row] for row in there.linear]
    determinant = sum(
        m[0][j] * (m[1][(j + 1) % 3] * m[2][(j + 2) % 3] - m[1][(j + 2) % 3] * m[2][(j + 1) % 3]) for j in range(3)
    )
    return PLACED_MIRRORED if determinant < 0 else PLACED_MOVED


def map_row(tree: NDArray[np.int64], there: AffineMap | None, box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make a row of `placement_maps`.

    Parameters
    ----------
    tree
        Its tree's buffer.
    there
        None: as it is.
    box : float64 (6,)
        World bounds.

    Raises
    ------
    ValueError
        The map has no inverse.
    """
    row = np.zeros(N_MAP)
    row[MAP_TO_WORLD : MAP_TO_WORLD + 9 : 4] = row[MAP_TO_OBJECT : MAP_TO_OBJECT + 9 : 4] = 1.0
    row[MAP_BOX : MAP_BOX + 6] = box
    row[MAP_PAD] = _PAD
    if there is None:
        return row
    back = inverse_of(there.linear)
    if back is None:
        raise ValueError("a placement's map has no inverse")
    floats = tree.view(np.float64)
    frame = floats[layout.FRAME_HALF : layout.FRAME_HALF + 3] / floats[layout.FRAME_SCALE]
    reach = np.abs(floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3]) + np.maximum(frame, 0.0)
    size = np.abs(there.linear)
    both, extent = size @ np.abs(back), size @ reach
    row[MAP_ORIGIN : MAP_ORIGIN + 3] = there.origin
    row[MAP_TO_WORLD : MAP_TO_WORLD + 9] = there.linear.ravel()
    row[MAP_TO_OBJECT : MAP_TO_OBJECT + 9] = back.ravel()
    row[MAP_ERROR : MAP_ERROR + 3] = gamma(32) * (both @ extent) + gamma(4) * (extent + np.abs(there.origin))
    row[MAP_PAD] = _PAD * both.sum(axis=1).max()
    return row
