"""The scalar part of a compiled scene."""

from compile_scenes import document

from tracer import types
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
        types.SETTING_MIN_SAMPLES: 0,
    }
    assert dict(enumerate(settings.tolist())) == expected
    assert build_limits(scene)[types.LIMIT_MIN_THROUGHPUT] == 0.25


def test_adaptive_sampling():
    sampling = {"samples": 9, "adaptive": {"min_samples": 6, "threshold": 0.25}}
    assert build_settings(document(sampling=sampling))[types.SETTING_MIN_SAMPLES] == 6
    assert build_limits(document(sampling=sampling))[types.LIMIT_ADAPTIVE_THRESHOLD] == 0.25


def test_no_contrast_is_below_a_threshold_of_0():
    """So nothing is asked, and the picture is the one of fixed sampling, bit for bit."""
    fixed, adaptive = document(), document(sampling={"samples": 16, "adaptive": {"threshold": 0}})
    assert build_settings(fixed).tolist() == build_settings(adaptive).tolist()


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
