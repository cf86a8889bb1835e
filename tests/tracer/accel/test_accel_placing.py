"""Maps of placements: inverses to the last bit, boxes that hold everything, errors that cover the way there and back."""

from fractions import Fraction

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import random_turn
from tracer.accel import build_tree
from tracer.accel.placing import AffineMap, box_of, inverse_of, kind_of, map_row, outline, skewness
from tracer.types import (
    MAP_ERROR,
    MAP_PAD,
    MAP_TO_OBJECT,
    MAP_TO_WORLD,
    PLACED_AS_IS,
    PLACED_MIRRORED,
    PLACED_MOVED,
)


def matrices(rng, n):
    for k in range(n):
        m = random_turn(rng) @ np.diag(10.0 ** rng.uniform(-6, 6, 3)) @ random_turn(rng)
        m[k % 3, (k + 1) % 3] += 10.0 ** rng.uniform(-6, 6)
        yield m if k % 2 else m * 10.0 ** rng.uniform(-30, 30)


def test_inverses_are_rounded_once():
    """M X = 1 in rationals, where X is within half a unit in the last place of the result, number by number."""
    rng = np.random.default_rng(1)
    for m in matrices(rng, 60):
        inverse = inverse_of(m)
        # Cramer's rule by numpy's determinants in exact integers: an own elimination in rationals
        rows = [
            [Fraction(x) for x in row] + [Fraction(int(i == k)) for k in range(3)] for i, row in enumerate(m.tolist())
        ]
        for column in range(3):
            pivot = max(range(column, 3), key=lambda i: abs(rows[i][column]))
            rows[column], rows[pivot] = rows[pivot], rows[column]
            rows[column] = [x / rows[column][column] for x in rows[column]]
            for i in range(3):
                if i != column:
                    rows[i] = [x - rows[i][column] * y for x, y in zip(rows[i], rows[column], strict=True)]
        for i in range(3):
            for k in range(3):
                assert inverse[i, k] == float(rows[i][3 + k])


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), [[1, 2, 3], [2, 4, 6], [0, 0, 1]], np.diag([1e-320, 1, 1])])
def test_no_inverse(matrix):
    assert inverse_of(np.array(matrix, float)) is None
    assert skewness(AffineMap(np.array(matrix, float), np.zeros(3))) == np.inf


def test_skewness_is_one_for_axes_and_grows_with_the_condition():
    assert skewness(AffineMap(np.diag([1e-6, 1.0, -1e6]), np.ones(3))) == 1.0
    assert skewness(AffineMap(np.eye(3)[[2, 0, 1]], np.ones(3))) == 1.0
    rng = np.random.default_rng(2)
    turn = random_turn(rng)
    assert 1.0 < skewness(AffineMap(turn * 1e9, np.ones(3))) <= 3.0 + 1e-12
    assert skewness(AffineMap(turn @ np.diag([1, 1, 1e6]) @ turn, np.ones(3))) > 1e5


def test_kinds():
    assert kind_of(None) == PLACED_AS_IS
    assert kind_of(AffineMap(np.eye(3), np.zeros(3))) == PLACED_MOVED
    assert kind_of(AffineMap(np.diag([1.0, -1e-200, 1e-200]), np.zeros(3))) == PLACED_MIRRORED
    assert kind_of(AffineMap(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))) == PLACED_MOVED


@pytest.mark.parametrize("subdivisions", [0, 3])
def test_boxes_hold_every_vertex_and_are_tight(subdivisions):
    rng = np.random.default_rng(3)
    vertices, faces = icosphere(subdivisions, rng, 0.3)
    vertices = vertices * [1.0, 20.0, 3.0] + [5.0, -7.0, 1e4]
    boxes = outline(build_tree(vertices, faces))
    assert 1 <= len(boxes) <= 64
    inside = np.abs(vertices[:, np.newaxis] - boxes[:, 0]) <= boxes[:, 1]
    assert inside.all(2).any(1).all()
    for m in [None, *matrices(rng, 20)]:
        there = None if m is None else AffineMap(m, rng.standard_normal(3) * np.abs(m).max())
        world = [[Fraction(x) for x in v] for v in vertices[rng.integers(0, len(vertices), 12)].tolist()]
        if there is not None:
            rows, origin = [[Fraction(x) for x in r] for r in m.tolist()], [Fraction(x) for x in there.origin.tolist()]
            world = [
                [sum(a * b for a, b in zip(r, v, strict=True)) + o for r, o in zip(rows, origin, strict=True)]
                for v in world
            ]
        box = box_of(boxes, there)
        for v in world:
            assert all(Fraction(low) <= x <= Fraction(high) for low, x, high in zip(box[:3], v, box[3:], strict=True))
    turned = AffineMap(random_turn(rng), np.zeros(3))
    box, exact = box_of(boxes, turned), vertices @ turned.linear.T
    assert ((box[3:] - box[:3]) < 1.7 * (exact.max(0) - exact.min(0))).all()
    assert box_of(np.empty((0, 2, 3)), turned).tolist() == [np.inf] * 3 + [-np.inf] * 3
    assert len(outline(build_tree(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))) == 0


def test_the_error_covers_the_way_there_and_back():
    """A vertex placed in floats, then taken back in floats: how far the exact map of that lies from where it was."""
    rng = np.random.default_rng(4)
    vertices, faces = icosphere(1)
    tree = build_tree(vertices, faces)
    for m in matrices(rng, 30):
        there = AffineMap(m, rng.standard_normal(3) * np.abs(m).max())
        row = map_row(tree, there, np.zeros(6))
        to_world = row[MAP_TO_WORLD : MAP_TO_WORLD + 9].reshape(3, 3)
        to_object = row[MAP_TO_OBJECT : MAP_TO_OBJECT + 9].reshape(3, 3)
        back = [to_object @ ((to_world @ v + there.origin) - there.origin) for v in vertices]
        linear = [[Fraction(x) for x in r] for r in m.tolist()]
        for v, w in zip(vertices, back, strict=True):
            moved = [Fraction(float(x)) - Fraction(float(y)) for x, y in zip(w, v, strict=True)]
            for k in range(3):
                off = abs(sum(a * b for a, b in zip(linear[k], moved, strict=True)))
                # of the place's own rounding, the hit's other bound takes care
                rounding = 2.0**-52 * float(np.abs(to_world @ v + there.origin)[k])
                assert float(off) <= row[MAP_ERROR + k] + 4 * rounding * skewness(there)
        assert row[MAP_PAD] >= 2.0**-44


def test_as_it_is():
    tree = build_tree(*icosphere(0))
    row = map_row(tree, None, np.arange(6.0))
    assert row[MAP_ERROR : MAP_ERROR + 3].tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="inverse"):
        map_row(tree, AffineMap(np.zeros((3, 3)), np.zeros(3)), np.zeros(6))
