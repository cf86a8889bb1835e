"""Transforms: closed forms of each step, order of the product, and what counts as singular."""

import math
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_documents import MINIMAL

from tracer.scene import IDENTITY, Matrix, SceneError, parse_scene, transform_rows
from tracer.scene.transforms import determinant, is_singular


def rows_of(steps: list[dict[str, Any]]) -> Matrix:
    sphere = {"type": "sphere", "center": [0, 0, 0], "radius": 1, "transform": steps}
    return transform_rows(parse_scene({**MINIMAL, "objects": [sphere]}).objects[0].transform)


def applied(rows: Matrix, point: tuple[float, float, float]) -> tuple[float, ...]:
    return tuple(sum(a * b for a, b in zip(row, (*point, 1.0), strict=True)) for row in rows[:3])


def test_nothing_is_the_identity() -> None:
    assert transform_rows(None) == transform_rows([]) == rows_of([]) == IDENTITY


def test_steps_are_applied_first_to_last() -> None:
    rows = rows_of(
        [
            {"type": "scale", "by": 2},
            {"type": "rotate", "axis": [0, 0, 5], "angle_deg": 90},
            {"type": "translate", "by": [10, 0, 0]},
        ]
    )
    assert applied(rows, (1, 0, 0)) == (10, 2, 0)  # (1,0,0) -> (2,0,0) -> (0,2,0) -> (10,2,0), exactly


@pytest.mark.parametrize(
    ("axis", "point", "turned"),
    [([1, 0, 0], (0, 1, 0), (0, 0, 1)), ([0, 1, 0], (0, 0, 1), (1, 0, 0)), ([0, 0, 1], (1, 0, 0), (0, 1, 0))],
)
def test_rotation_is_right_handed_and_exact_by_quarters(
    axis: list[int], point: tuple[float, ...], turned: tuple[float, ...]
) -> None:
    for turns, expected in ((1, turned), (2, tuple(-x for x in point)), (4, point), (-3, turned), (5, turned)):
        rows = rows_of([{"type": "rotate", "axis": axis, "angle_deg": 90 * turns}])
        assert applied(rows, point) == expected  # type: ignore[arg-type]


def test_rotation_about_the_diagonal_swaps_axes() -> None:
    rows = rows_of([{"type": "rotate", "axis": [2, 2, 2], "angle_deg": 120}])
    assert applied(rows, (1, 2, 3)) == pytest.approx((3, 1, 2), abs=1e-14)


def test_rotation_by_an_angle() -> None:
    rows = rows_of([{"type": "rotate", "axis": [0, 0, 1], "angle_deg": 30}])
    assert applied(rows, (1, 0, 0)) == pytest.approx((math.sqrt(3) / 2, 0.5, 0), abs=1e-15)


def test_matrix_rows_are_taken_as_given() -> None:
    rows = [[1, 2, 3, 4], [0, 1, 5, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    assert rows_of([{"type": "matrix", "rows": rows}]) == tuple(map(tuple, rows))


@given(st.lists(st.lists(st.integers(-50, 50), min_size=3, max_size=3), min_size=3, max_size=3))
def test_exactly_singular_matrices_are_singular_and_others_of_small_integers_are_not(rows: list[list[int]]) -> None:
    (a, b, c), (d, e, f), (g, h, i) = [[Fraction(x) for x in row] for row in rows]
    exact = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    assert is_singular(rows) == (exact == 0)


def test_scale_alone_does_not_make_singular() -> None:
    assert not is_singular([[1e-30, 0, 0], [0, 1e30, 0], [0, 0, 1]])
    assert not is_singular([[1, 0, 0], [0, 1, 0], [1, 1, 1e-12]])
    assert is_singular([[1, 2, 3], [2, 4, 6], [0, 0, 1]])
    assert is_singular([[0.1, 0.2, 0.3], [0.3, 0.6, 0.9], [5, 1, 2]])  # rows parallel but for rounding
    assert determinant([[1, 0, 0], [0, 1, 0], [0, 0, 1]])[0] == 1


def test_a_product_out_of_range_is_a_fault() -> None:
    steps = [{"type": "scale", "by": 1e20}] * 2
    with pytest.raises(SceneError) as caught:
        rows_of(steps)
    assert [fault.pointer for fault in caught.value.faults] == ["/objects/0/transform"]
