"""Camera frames and view planes against closed forms."""

import math
from typing import Any

import pytest
from scene_documents import MINIMAL

from tracer.scene import View, parse_scene


def view(camera: dict[str, Any], width: int = 640, height: int = 360) -> View:
    return parse_scene({**MINIMAL, "camera": camera}).camera.view(width, height)


def test_without_a_pose_the_camera_looks_along_minus_z() -> None:
    seen = view({"type": "view_plane", "left": -1, "right": 2, "bottom": -3, "top": 4, "distance": 0.1})
    axes = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    assert seen == View(*axes, left=-1, right=2, bottom=-3, top=4, distance=0.1, orthographic=False)


def test_look_at_along_an_axis_gives_exact_vectors() -> None:
    pose = {"eye": [7, 0, 0], "target": [2, 0, 0], "up": [0, 0, 3]}
    seen = view({"type": "perspective", "fov_deg": 90, "look_at": pose})
    assert seen.eye == (7, 0, 0)
    assert seen.w == (1, 0, 0)  # backwards
    assert seen.u == (0, 1, 0)  # to the right when looking along -x with z up
    assert seen.v == (0, 0, 1)


def test_look_at_is_orthonormal_right_handed_and_up_is_up() -> None:
    pose = {"eye": [1, 2, 3], "target": [-4, 0.5, 10], "up": [0.3, 5, 0.2]}
    seen = view({"type": "perspective", "fov_deg": 40, "look_at": pose})
    u, v, w = seen.u, seen.v, seen.w

    def dot(a: tuple[float, ...], b: tuple[float, ...]) -> float:
        return sum(x * y for x, y in zip(a, b, strict=True))

    for a in (u, v, w):
        assert dot(a, a) == pytest.approx(1, abs=1e-15)
    assert dot(u, v) == pytest.approx(0, abs=1e-15)
    assert dot(u, w) == pytest.approx(0, abs=1e-15)
    assert dot(v, w) == pytest.approx(0, abs=1e-15)
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    assert cross == pytest.approx(w, abs=1e-15)
    assert dot(v, (0.3, 5, 0.2)) > 0
    length = math.dist((1, 2, 3), (-4, 0.5, 10))
    assert w == pytest.approx((5 / length, 1.5 / length, -7 / length), abs=1e-15)


def test_tiny_and_huge_look_at_neither_underflow_nor_overflow() -> None:
    for scale in (1e-29, 1e29):
        pose = {"eye": [0, 0, scale], "target": [0, 0, 0], "up": [0, scale, 0]}
        seen = view({"type": "orthographic", "height": 2, "look_at": pose})
        assert (seen.u, seen.v, seen.w) == ((1, 0, 0), (0, 1, 0), (0, 0, 1))


@pytest.mark.parametrize(("fov", "half"), [(90, 1.0), (60, 1 / math.sqrt(3)), (2 * math.degrees(math.atan(10)), 10.0)])
def test_field_of_view_along_either_side(fov: float, half: float) -> None:
    tall = view({"type": "perspective", "fov_deg": fov})
    assert tall.distance == 1
    assert (tall.bottom, tall.top) == pytest.approx((-half, half))
    assert (tall.left, tall.right) == pytest.approx((-half * 16 / 9, half * 16 / 9))
    wide = view({"type": "perspective", "fov_deg": fov, "fov_axis": "horizontal"})
    assert (wide.left, wide.right) == pytest.approx((-half, half))
    assert (wide.bottom, wide.top) == pytest.approx((-half * 9 / 16, half * 9 / 16))


def test_orthographic_bounds_are_in_world_units() -> None:
    seen = view({"type": "orthographic", "height": 4}, width=200, height=100)
    assert seen[4:] == (-4, 4, -2, 2, 1, True)


def test_matrix_columns_are_the_frame() -> None:
    rows = [[0, -2, 0, 5], [1, 0, 0, 6], [0, 0, 3, 7], [0, 0, 0, 1]]
    seen = view({"type": "perspective", "fov_deg": 90, "matrix": rows})
    assert seen[:4] == ((5, 6, 7), (0, 1, 0), (-2, 0, 0), (0, 0, 3))


def test_matrix_and_look_at_of_the_same_pose_agree() -> None:
    look = {"eye": [1, 2, 3], "target": [1, 2, -4], "up": [0, 1, 0]}
    rows = [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    base = {"type": "perspective", "fov_deg": 50}
    assert view({**base, "look_at": look}) == view({**base, "matrix": rows})
