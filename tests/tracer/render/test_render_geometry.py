"""From objects of the document to triangles, shapes and planes in world space."""

import numpy as np
import pytest
from compile_scenes import TRIANGLE, compiled

from tracer.scene import SceneError
from tracer.types import (
    SHAPE_BOX,
    SHAPE_CYLINDER_OPEN,
    SHAPE_DISK,
    SHAPE_SPHERE,
)

_TURN = [
    {"type": "scale", "by": [2, 1, 1]},
    {"type": "rotate", "axis": [0, 0, 1], "angle_deg": 90},
    {"type": "translate", "by": [10, 0, 0]},
]


def test_a_mesh_without_a_transform_keeps_its_bits():
    positions = np.random.default_rng(1).standard_normal((3, 3)).tolist()
    normals = [[0, 0, 3], [0.1, 0, 1], [0, 0, 1e-3]]
    scene, _ = compiled({**TRIANGLE, "positions": positions, "normals": normals})
    assert scene.vertex_positions.tolist() == positions
    assert scene.vertex_normals.tolist() == normals


def test_transforms_are_baked():
    mesh = {**TRIANGLE, "normals": [[1, 1, 0]] * 3, "transform": _TURN}
    scene, _ = compiled(mesh)
    assert np.allclose(scene.vertex_positions, [[10, 0, 0], [10, 2, 0], [9, 0, 0]])
    normal = scene.vertex_normals[0]
    assert np.allclose(normal / np.abs(normal).max(), [-1, 0.5, 0])  # inverse transpose: (1/2, 1, 0), turned
    assert scene.face_vertices.tolist() == [[0, 1, 2]]


def test_mirrored_meshes_keep_their_winding_outward():
    mesh = {**TRIANGLE, "normals": [[0, 0, 1]] * 3, "transform": [{"type": "scale", "by": [-1, 1, 1]}]}
    scene, _ = compiled(mesh)
    a, b, c = scene.vertex_positions[scene.face_vertices[0]]
    assert np.cross(b - a, c - a)[2] > 0
    assert scene.vertex_normals[0, 2] > 0
    mesh["transform"] = [{"type": "scale", "by": [1, 1, -1]}]
    scene, _ = compiled(mesh)
    a, b, c = scene.vertex_positions[scene.face_vertices[0]]
    assert np.cross(b - a, c - a)[2] < 0
    assert scene.vertex_normals[0, 2] < 0


@pytest.mark.parametrize(
    ("shape", "kind", "places"),
    [
        # places: local point -> world point
        ({"type": "sphere", "center": [1, 2, 3], "radius": 2}, SHAPE_SPHERE, {(0, 0, 1): (1, 2, 5)}),
        (
            {"type": "box", "min": [0, 0, 0], "max": [2, 4, 6]},
            SHAPE_BOX,
            {(-1, -1, -1): (0, 0, 0), (1, 1, 1): (2, 4, 6)},
        ),
        (
            {"type": "disk", "center": [1, 0, 0], "normal": [0, 5, 0], "radius": 3},
            SHAPE_DISK,
            {(0, 0, 0): (1, 0, 0), (1, 0, 0): (4, 0, 0), (0, 1, 0): (1, 0, -3), (0, 0, 1): (1, 3, 0)},
        ),
        (
            {"type": "cylinder", "start": [0, 0, 1], "end": [0, 0, -3], "radius": 2, "capped": False},
            SHAPE_CYLINDER_OPEN,
            {(0, 0, 0): (0, 0, 1), (0, 0, 1): (0, 0, -3)},
        ),
    ],
)
@pytest.mark.parametrize(
    "transform", [None, _TURN, [{"type": "scale", "by": [-1, 1, 1]}]], ids=["none", "turn", "mirror"]
)
def test_shapes(shape, kind, places, transform):
    scene, _ = compiled({**shape, **({"transform": transform} if transform else {})})
    assert scene.shape_kind.tolist() == [kind]
    for local, world in places.items():
        placed = np.array(world, float)
        if transform == _TURN:
            placed = np.array([10 - placed[1], 2 * placed[0], placed[2]])
        elif transform:
            placed[0] *= -1
        assert np.allclose(scene.shape_origin[0] + scene.shape_to_world[0] @ local, placed)
        assert np.allclose(scene.shape_to_local[0] @ (placed - scene.shape_origin[0]), local)


def test_cylinders_are_round():
    scene, _ = compiled({"type": "cylinder", "start": [0, 1, 0], "end": [1, 2, 3], "radius": 0.5})
    x, y, z = scene.shape_to_world[0].T
    assert np.allclose([x @ y, x @ z, y @ z, x @ x, y @ y, z @ z], [0, 0, 0, 0.25, 0.25, 11])


def test_planes():
    plane = {"type": "plane", "point": [0, 2, 0], "normal": [0, 3, 0]}
    scene, _ = compiled(plane, {**plane, "transform": _TURN})
    assert scene.plane_point.tolist() == [[0, 2, 0], [8, 0, 0]]
    assert np.allclose(scene.plane_normal, [[0, 1, 0], [-1, 0, 0]])
    # A point of the plane keeps its u and v under the transform.
    u_v = scene.plane_uv[0] @ (np.array([3, 2, 5]) - scene.plane_point[0])
    assert np.allclose(u_v, [3, -5])
    assert np.allclose(scene.plane_uv[1] @ (np.array([8, 6, 5]) - scene.plane_point[1]), u_v)


@pytest.mark.parametrize(
    "thing",
    [
        {**TRIANGLE, "positions": [[0, 0, 0], [1e20, 0, 0], [0, 1, 0]]},
        {"type": "sphere", "center": [0, 0, 0], "radius": 1e20},
        {"type": "sphere", "center": [1e20, 0, 0], "radius": 1},
        {"type": "plane", "point": [1e20, 0, 0], "normal": [0, 1, 0]},
    ],
)
def test_leaving_the_range_of_coordinates_is_a_fault(thing):
    with pytest.raises(SceneError) as caught:
        compiled(TRIANGLE, {**thing, "transform": [{"type": "scale", "by": 1e20}]})
    assert caught.value.faults[0].pointer == "/objects/1/transform"


@pytest.mark.parametrize("scales", [[1e-25], [1e25], [1e-25] * 5])
def test_extreme_scales_stay_finite(scales):
    thing = {"type": "cylinder", "start": [0, 1, 0], "end": [1, 2, 3], "radius": 0.5}
    mesh = {**TRIANGLE, "normals": [[0, 0, 1]] * 3}
    transform = [{"type": "scale", "by": scale} for scale in scales]
    scene, _ = compiled({**thing, "transform": transform}, {**mesh, "transform": transform})
    assert np.allclose(scene.shape_to_local[0] @ scene.shape_to_world[0], np.eye(3))
    for name, array in scene._asdict().items():
        absent = name in {"top_bounds", "bvh_bounds"} and np.isinf(array)  # children that are not there
        assert array.dtype.kind != "f" or (np.isfinite(array) | absent).all()
    assert (scene.vertex_normals[:, 2] > 0).all()
