"""Build the hierarchies of a scene: the triangles' wide tree, and a two-way one over its finite shapes.

The latter by the binned surface-area heuristic.

Invariants: primitives are bounded exactly (traversal, not the boxes, pays for rounding); a leaf holds at most
:data:`MAX_LEAF` primitives, by ascending id; the depth is at most :data:`MAX_DEPTH`, whatever the input, because ranges
that the heuristic cannot split (equal centroids) or that sit too deep are halved by count; the result depends on
the input alone.

Sources: Wald 2007 (binning); MacDonald and Booth 1990 (heuristic).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.accel.wide import build_wide
from tracer.native.entries import entry
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_CYLINDER_OPEN, SHAPE_DISK, SHAPE_SPHERE, Bvh

MAX_DEPTH: Final = 60  # inner nodes on a path; traversal's stack holds one entry for each
MAX_LEAF: Final = 4  # an exact triangle test costs about as much as a node: larger leaves lose

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


def build_bvh(
    vertex_positions: NDArray[np.float64],
    face_vertices: NDArray[np.int32],
    shape_kind: NDArray[np.int32],
    shape_origin: NDArray[np.float64],
    shape_to_world: NDArray[np.float64],
) -> Bvh:
    """Build the hierarchies over the triangles and the finite shapes of a scene.

    ``CompiledScene(**bvh._asdict(), ...)`` takes what it returns.

    Parameters
    ----------
    vertex_positions : float64 (n_vertices, 3), world
    face_vertices : int32 (n_triangles, 3), rows of the former
    shape_kind : int32 (n_shapes,), SHAPE_*
    shape_origin : float64 (n_shapes, 3), world
    shape_to_world : float64 (n_shapes, 3, 3)

    Returns
    -------
    Bvh
        Arrays as :class:`tracer.types.CompiledScene` describes them.

    Raises
    ------
    ValueError
        A coordinate that a face uses is not finite, or an index is out of range.
    """
    positions = np.ascontiguousarray(vertex_positions, np.float64)
    faces = np.ascontiguousarray(face_vertices, np.int32)
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
        raise ValueError("a face names a vertex that does not exist")
    bounds = shape_bounds(shape_kind, shape_origin, shape_to_world)
    root = np.array([bounds[:, :3].min(axis=0, initial=np.inf), bounds[:, 3:].max(axis=0, initial=-np.inf)])
    for axis in range(3):  # one axis at a time: (n_triangles, 3) numbers at once, not nine
        coordinates = positions[:, axis][faces]
        root[0, axis] = min(root[0, axis], coordinates.min(initial=np.inf))
        root[1, axis] = max(root[1, axis], coordinates.max(initial=-np.inf))
    if not (np.isfinite(root).all() or len(faces) + len(shape_kind) == 0):
        raise ValueError("a coordinate is not finite")
    tree = build_wide(positions, faces).buffer
    room = max(len(bounds), 1)
    node_bounds, children = np.empty((room, 12)), np.empty((room, 4), np.int32)
    slots = np.empty(len(bounds), np.int32)
    n_nodes, depth = _build_tree(bounds, node_bounds, children, slots)
    if depth > MAX_DEPTH:
        raise AssertionError(f"hierarchy of depth {depth}")
    return Bvh(tree, node_bounds[:n_nodes].copy(), children[:n_nodes].copy(), slots, root)
