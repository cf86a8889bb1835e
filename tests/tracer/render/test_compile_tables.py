"""Settings, camera, lights: the document's numbers at the kernel's places."""

import numpy as np
import pytest
from compile_scenes import compiled, document

from tracer import types
from tracer.render.materials import build_lights
from tracer.render.settings import build_camera, build_limits, build_settings


def test_settings():
    scene = document(
        image={"width": 40, "height": 30, "crop": {"x": 3, "y": 4, "width": 5, "height": 6}},
        sampling={"samples": 9, "sampler": "stratified", "seed": 4_000_000_000},
        integrator={"max_depth": 7, "shadows": False, "min_throughput": 0.25},
    )
    settings = build_settings(scene)
    expected = {
        types.SETTING_WIDTH: 40,
        types.SETTING_HEIGHT: 30,
        types.SETTING_CROP_X: 3,
        types.SETTING_CROP_Y: 4,
        types.SETTING_CROP_WIDTH: 5,
        types.SETTING_CROP_HEIGHT: 6,
        types.SETTING_SAMPLES: 9,
        types.SETTING_SAMPLER: types.SAMPLER_STRATIFIED,
        types.SETTING_SEED: 4_000_000_000,
        types.SETTING_MAX_DEPTH: 7,
        types.SETTING_SHADOWS: 0,
        types.SETTING_CAMERA: types.CAMERA_VIEW_PLANE,
        types.SETTING_SKIP: 1,
    }
    assert dict(enumerate(settings.tolist())) == expected
    assert build_limits(scene)[types.LIMIT_MIN_THROUGHPUT] == 0.25


def test_without_a_crop_the_window_is_the_picture():
    settings = build_settings(document(image={"width": 40, "height": 30}))
    assert settings[types.SETTING_CROP_X : types.SETTING_CROP_HEIGHT + 1].tolist() == [0, 0, 40, 30]


def test_camera():
    look = {"eye": [1, 2, 3], "target": [1, 2, 0]}
    camera = {"type": "view_plane", "left": -1, "right": 2, "bottom": -3, "top": 4, "distance": 0.5, "look_at": look}
    row = build_camera(document(camera=camera))
    assert row[types.CAMERA_EYE : types.CAMERA_EYE + 3].tolist() == [1, 2, 3]
    assert row[types.CAMERA_U : types.CAMERA_U + 3].tolist() == [1, 0, 0]
    assert row[types.CAMERA_V : types.CAMERA_V + 3].tolist() == [0, 1, 0]
    assert row[types.CAMERA_W : types.CAMERA_W + 3].tolist() == [0, 0, 1]
    assert row[types.CAMERA_LEFT :].tolist() == [-1, 2, -3, 4, 0.5]
    orthographic = document(camera={"type": "orthographic", "height": 3})
    assert build_settings(orthographic)[types.SETTING_CAMERA] == types.CAMERA_ORTHOGRAPHIC
    assert build_camera(orthographic)[types.CAMERA_TOP] == 1.5


def test_lights():
    scene = document(
        lights=[
            {"type": "ambient", "intensity": 0.1},
            {"type": "directional", "direction": [0, -3, 4], "ambient": 0.5, "diffuse": [1, 2, 3]},
            {"type": "ambient", "intensity": [0, 0.2, 0]},
            {"type": "point", "position": [1, 2, 3], "specular": 7},
            {
                "type": "spot",
                "position": [4, 5, 6],
                "direction": [0, 0, -2],
                "inner_angle_deg": 30,
                "outer_angle_deg": 60,
            },
        ]
    )
    ambient, lights, kinds = build_lights(scene.lights)
    assert np.allclose(ambient, [0.1, 0.3, 0.1])
    assert kinds.tolist() == [types.LIGHT_KIND_DIRECTIONAL, types.LIGHT_KIND_POINT, types.LIGHT_KIND_SPOT]
    directional, point, spot = lights
    assert np.allclose(directional[types.LIGHT_DIRECTION :][:3], [0, -0.6, 0.8])
    assert directional[types.LIGHT_AMBIENT :][:3].tolist() == [0.5] * 3
    assert directional[types.LIGHT_DIFFUSE :][:3].tolist() == [1, 2, 3]
    assert point[types.LIGHT_POSITION :][:3].tolist() == [1, 2, 3]
    assert point[types.LIGHT_SPECULAR :][:3].tolist() == [7] * 3
    assert spot[types.LIGHT_DIRECTION :][:3].tolist() == [0, 0, -1]
    # KHR_lights_punctual: full light at the inner angle, none at the outer one.
    for angle, falloff in ((0, 1), (30, 1), (60, 0), (90, 0)):
        cosine = np.cos(np.radians(angle))
        value = np.clip(cosine * spot[types.LIGHT_SPOT_SCALE] + spot[types.LIGHT_SPOT_OFFSET], 0, 1) ** 2
        assert value == pytest.approx(falloff, abs=1e-12)


def test_the_default_grey_is_row_0():
    scene, _ = compiled({"type": "sphere", "center": [0, 0, 0], "radius": 1})
    assert scene.shape_material.tolist() == [0]
    assert scene.materials[0, types.MATERIAL_KD : types.MATERIAL_KD + 3].tolist() == [0.8] * 3
    assert scene.materials[0, types.MATERIAL_KA : types.MATERIAL_KA + 3].tolist() == [0.8] * 3
    assert scene.materials[0, types.MATERIAL_A] == 1
    assert scene.material_flags[0].tolist() == [-1, types.WRAP_REPEAT, types.FILTER_BILINEAR, 1]
