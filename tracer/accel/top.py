"""The hierarchies of a scene: the triangles' trees, where each is placed, the placements' tree, and the shapes'.

Every tree has a frame of its own (:mod:`tracer.accel.layout`), so objects that lie far apart, or differ much in size,
are each resolved as if they were alone; and a tree may be placed many times.

Invariants: ids go placement by placement, in the order given; the result depends on the input alone; the placements'
tree has one placement a leaf, for meeting one costs more than a node.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel.build import MAX_LEAF, build_over, shape_bounds
from tracer.accel.layout import HEADER_TRIANGLES
from tracer.accel.placing import AffineMap, box_of, kind_of, map_row, outline
from tracer.accel.sorting import empty_aligned
from tracer.accel.wide import build_wide
from tracer.types import (
    MAP_BOX,
    MAP_PAD,
    MAP_TOP_PAD,
    N_PLACEMENT,
    PLACED_AS_IS,
    PLACEMENT_END,
    PLACEMENT_FACE,
    PLACEMENT_FIRST,
    PLACEMENT_KIND,
    PLACEMENT_MATERIAL,
    PLACEMENT_TREE,
    Bvh,
)

_TREE_WORDS: Final = 8  # every tree begins on a cache line


class Placement(NamedTuple):
    """One use of a tree."""

    tree: int  # which of the trees
    n_faces: int
    first_face: int  # row of face_vertices
    first_material: int  # row of face_material
    there: AffineMap | None = None  # None: its vertices are in world space
    bounds: NDArray[np.float64] | None = None  # (6,) world; None: by the tree's upper boxes


def build_tree(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Build the wide tree of a mesh; see :func:`tracer.accel.wide.build_wide`.

    Returns
    -------
    int64 (n,)
        One flat buffer.
    """
    return build_wide(vertices, faces).buffer


def bounds_of(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Bound the vertices that faces use.

    Returns
    -------
    float64 (6,)
        Lower, then upper corner; (+inf, -inf) when there is no face.
    """
    bounds = np.array([np.inf] * 3 + [-np.inf] * 3)
    if len(faces):
        for axis in range(3):  # one axis at a time: (n_triangles, 3) numbers at once, not nine
            coordinates = vertices[:, axis][faces]
            bounds[axis], bounds[3 + axis] = coordinates.min(), coordinates.max()
    return bounds


def join_hierarchies(
    trees: Sequence[NDArray[np.int64]],
    placements: Sequence[Placement],
    shape_kind: NDArray[np.int32],
    shape_origin: NDArray[np.float64],
    shape_to_world: NDArray[np.float64],
) -> Bvh:
    """Put the trees of a scene together, and build what is above them and the shapes' own.

    Parameters
    ----------
    trees
        Buffers, at least one.
    placements
        At least one; a single one is not moved.
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
        A map has no inverse, a coordinate is not finite, a single placement is moved, or one of several is empty.
    """
    if not placements or (len(placements) == 1 and placements[0].there is not None):
        raise ValueError("expected several placements, or one as it is")
    if len(placements) > 1 and any(tree[HEADER_TRIANGLES] == 0 for tree in trees):
        raise ValueError("expected several placements, none of them empty, or one")
    starts = np.cumsum([0] + [-(-len(tree) // _TREE_WORDS) * _TREE_WORDS for tree in trees])
    joined = trees[0]
    if len(trees) > 1:
        joined = empty_aligned((int(starts[-1]),), np.int64)
        joined[:] = 0
        for tree, start in zip(trees, starts, strict=False):
            joined[start : start + len(tree)] = tree
    outlines = {}
    table = np.zeros((len(placements), N_PLACEMENT), np.int64)
    maps = []
    end = 0
    for row, placement in zip(table, placements, strict=True):
        row[PLACEMENT_FIRST], row[PLACEMENT_END] = end, end + placement.n_faces
        row[PLACEMENT_TREE] = starts[placement.tree]
        row[PLACEMENT_FACE], row[PLACEMENT_MATERIAL] = placement.first_face, placement.first_material
        row[PLACEMENT_KIND] = kind_of(placement.there)
        end += placement.n_faces
        tree = trees[placement.tree]
        box = placement.bounds
        if box is None:
            if placement.tree not in outlines:
                outlines[placement.tree] = outline(tree)
            box = box_of(outlines[placement.tree], placement.there)
        maps.append(map_row(tree, placement.there, box))
    placement_maps = np.array(maps)
    placement_maps[:, MAP_TOP_PAD] = placement_maps[:, MAP_PAD].max()
    boxes = np.ascontiguousarray(placement_maps[:, MAP_BOX : MAP_BOX + 6])
    bounds = shape_bounds(shape_kind, shape_origin, shape_to_world)
    # a moved object's rays may pass its box by a little; of what is as it is, the box is exact
    moved = table[:, PLACEMENT_KIND] != PLACED_AS_IS
    stray = np.where(moved, placement_maps[:, MAP_PAD] * np.abs(boxes).max(axis=1), 0.0)[:, np.newaxis]
    everything = np.concatenate([np.concatenate([boxes[:, :3] - stray, boxes[:, 3:] + stray], axis=1), bounds])
    root = np.array([everything[:, :3].min(axis=0), everything[:, 3:].max(axis=0)])
    if not (np.isfinite(root).all() or end + len(bounds) == 0):
        raise ValueError("a coordinate is not finite")
    return Bvh(joined, table, placement_maps, *build_over(boxes, 1), *build_over(bounds, MAX_LEAF), root)


def build_bvh(
    vertex_positions: NDArray[np.float64],
    face_vertices: NDArray[np.int32],
    shape_kind: NDArray[np.int32],
    shape_origin: NDArray[np.float64],
    shape_to_world: NDArray[np.float64],
) -> Bvh:
    """Build the hierarchies over triangles in one tree and the finite shapes of a scene.

    ``CompiledScene(**bvh._asdict(), ...)`` takes what it returns.

    Parameters
    ----------
    vertex_positions : float64 (n_vertices, 3), world
    face_vertices : int32 (n_triangles, 3), rows of the former
    shape_kind, shape_origin, shape_to_world
        As :func:`join_hierarchies`.

    Raises
    ------
    ValueError
        A coordinate that a face uses is not finite, or an index is out of range.
    """
    positions = np.ascontiguousarray(vertex_positions, np.float64)
    faces = np.ascontiguousarray(face_vertices, np.int32)
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
        raise ValueError("a face names a vertex that does not exist")
    bounds = bounds_of(positions, faces)
    if len(faces) and not np.isfinite(bounds).all():
        raise ValueError("a coordinate is not finite")
    placement = Placement(0, len(faces), 0, 0, bounds=bounds)
    return join_hierarchies([build_tree(positions, faces)], [placement], shape_kind, shape_origin, shape_to_world)
