"""Build a two-way hierarchy over boxes, those of the finite shapes or of placements, by the surface-area heuristic.

Invariants: primitives are bounded exactly (traversal, not the boxes, pays for rounding); a leaf holds at most so many
primitives as its maker says, by ascending id; the depth is at most :data:`MAX_DEPTH`, whatever the input, because
ranges that the heuristic cannot split (equal centroids) or that sit too deep are halved by count; the result depends on
the input alone.

Sources: Wald 2007 (binning); MacDonald and Booth 1990 (heuristic).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.native.entries import entry
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_CYLINDER_OPEN, SHAPE_DISK, SHAPE_SPHERE

MAX_DEPTH: Final = 60  # inner nodes on a path; traversal's stack holds one entry for each
MAX_LEAF: Final = 4  # shapes: the test of one costs about as much as a node, larger leaves lose

_build_tree = entry("tracer.accel.binned.build_tree")


def shape_bounds(
    kind: NDArray[np.int32], origin: NDArray[np.float64], to_world: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World bounds of shapes.

    Parameters
    ----------
    kind : int32 (n,), SHAPE_*
    origin : float64 (n, 3), world
    to_world : float64 (n, 3, 3)

    Returns
    -------
    float64 (n, 6)
        Lower, then upper corners, in world units; rounding is left to the traversal's padding.
    """
    bounds = np.empty((len(kind), 6))
    for i, (which, matrix) in enumerate(zip(kind, to_world, strict=True)):
        x, y, z = np.abs(matrix).T
        disk = np.hypot(matrix[:, 0], matrix[:, 1])  # reach of the unit circle in the local xy plane, per world axis
        if which == SHAPE_SPHERE:
            reach = np.sqrt((matrix * matrix).sum(axis=1))
            low, high = -reach, reach
        elif which == SHAPE_BOX:
            low, high = -(x + y + z), x + y + z
        elif which == SHAPE_DISK:
            low, high = -disk, disk
        elif which in {SHAPE_CYLINDER_OPEN, SHAPE_CYLINDER_CAPPED}:
            axis = matrix[:, 2]
            low, high = np.minimum(axis, 0.0) - disk, np.maximum(axis, 0.0) + disk
        else:
            raise ValueError(f"shape {i}: unknown kind {which}")
        bounds[i, :3] = origin[i] + low
        bounds[i, 3:] = origin[i] + high
    return bounds


def build_over(
    bounds: NDArray[np.float64], max_leaf: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Build a hierarchy over boxes.

    Parameters
    ----------
    bounds : float64 (n, 6)
        Lower, then upper corners.
    max_leaf
        Most boxes of a leaf.

    Returns
    -------
    tuple
        Bounds, children and slots as `bvh_bounds`, `bvh_children` and `bvh_slots` of
        :class:`tracer.types.CompiledScene`.
    """
    room = max(len(bounds), 1)
    node_bounds, children = np.empty((room, 12)), np.empty((room, 4), np.int32)
    slots = np.empty(len(bounds), np.int32)
    n_nodes, depth = _build_tree(bounds, max_leaf, node_bounds, children, slots)
    if depth > MAX_DEPTH:
        raise AssertionError(f"hierarchy of depth {depth}")
    return node_bounds[:n_nodes].copy(), children[:n_nodes].copy(), slots
