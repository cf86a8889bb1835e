"""Trees and placements put together: ids, places, bounds, and what is refused."""

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import random_turn
from tracer.accel import Placement, build_tree, join_hierarchies
from tracer.accel.placing import AffineMap
from tracer.accel.wide import WideBvh
from tracer.rays import RayCaster
from tracer.types import (
    MAP_BOX,
    MAP_PAD,
    MAP_TOP_PAD,
    PLACEMENT_END,
    PLACEMENT_FACE,
    PLACEMENT_FIRST,
    PLACEMENT_KIND,
    PLACEMENT_MATERIAL,
    PLACEMENT_TREE,
)

NO_SHAPES = (np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def test_ids_trees_and_boxes():
    rng = np.random.default_rng(1)
    meshes = [icosphere(0), icosphere(2)]
    trees = [build_tree(*mesh) for mesh in meshes]
    maps = [AffineMap(random_turn(rng) * 10.0**k, rng.uniform(-9, 9, 3)) for k in (-1, 0, 1)]
    placements = [
        Placement(1, 320, 20, 0),
        Placement(0, 20, 0, 320, maps[0]),
        Placement(1, 320, 20, 0, maps[1]),
        Placement(0, 20, 0, 340, maps[2]),
    ]
    bvh = join_hierarchies(trees, placements, *NO_SHAPES)
    assert bvh.placements[:, PLACEMENT_FIRST].tolist() == [0, 320, 340, 660]
    assert bvh.placements[:, PLACEMENT_END].tolist() == [320, 340, 660, 680]
    assert bvh.placements[:, PLACEMENT_FACE].tolist() == [20, 0, 20, 0]
    assert bvh.placements[:, PLACEMENT_MATERIAL].tolist() == [0, 320, 0, 340]
    assert bvh.placements[:, PLACEMENT_KIND].tolist() == [0, 1, 1, 1]
    assert (bvh.placements[:, PLACEMENT_TREE] * 8 % 64 == 0).all()
    assert bvh.trees.ctypes.data % 64 == 0
    for placement, row in zip(placements, bvh.placements, strict=True):
        tree = bvh.trees[row[PLACEMENT_TREE] :][: len(trees[placement.tree])]
        assert RayCaster.from_bvh(WideBvh(tree.copy())).any_hit([[0.0, 0, 0]], [[1.0, 0.3, 0]])[0]
    boxes = bvh.placement_maps[:, MAP_BOX : MAP_BOX + 6]
    assert (bvh.bvh_root[0] <= boxes[:, :3].min(0)).all()
    assert (bvh.bvh_root[1] >= boxes[:, 3:].max(0)).all()
    assert (bvh.placement_maps[:, MAP_TOP_PAD] == bvh.placement_maps[:, MAP_PAD].max()).all()
    leaves = bvh.top_children.reshape(-1, 2)
    assert sorted(bvh.top_slots[leaves[leaves[:, 1] == 1, 0]].tolist()) == [0, 1, 2, 3]
    assert set(leaves[:, 1].tolist()) == {0, 1}  # one placement a leaf


def test_what_is_refused():
    tree, empty = build_tree(*icosphere(0)), build_tree(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    there = AffineMap(np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="several placements, or one as it is"):
        join_hierarchies([tree], [], *NO_SHAPES)
    with pytest.raises(ValueError, match="several placements, or one as it is"):
        join_hierarchies([tree], [Placement(0, 20, 0, 0, there)], *NO_SHAPES)
    with pytest.raises(ValueError, match="none of them empty"):
        join_hierarchies([tree, empty], [Placement(0, 20, 0, 0), Placement(1, 0, 20, 20)], *NO_SHAPES)
    flat = AffineMap(np.diag([1.0, 1.0, 0.0]), np.ones(3))
    with pytest.raises(ValueError, match="inverse"):
        join_hierarchies([tree], [Placement(0, 20, 0, 0), Placement(0, 20, 0, 0, flat)], *NO_SHAPES)
