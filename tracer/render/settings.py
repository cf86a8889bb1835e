"""The scalar part of a compiled scene: settings, limits, camera.

Invariant: the camera's numbers are those of the document's `View` [farmer2019 eq. 1], not recomputed here.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tracer.scene import SceneDoc
from tracer.types import (
    CAMERA_BOTTOM,
    CAMERA_DISTANCE,
    CAMERA_EYE,
    CAMERA_LEFT,
    CAMERA_ORTHOGRAPHIC,
    CAMERA_RIGHT,
    CAMERA_TOP,
    CAMERA_U,
    CAMERA_V,
    CAMERA_VIEW_PLANE,
    CAMERA_W,
    LIMIT_ADAPTIVE_THRESHOLD,
    LIMIT_MIN_THROUGHPUT,
    N_CAMERA,
    N_LIMITS,
    N_SETTINGS,
    SAMPLER_INDEPENDENT,
    SAMPLER_SOBOL,
    SAMPLER_STRATIFIED,
    SETTING_CAMERA,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_HEIGHT,
    SETTING_MAX_DEPTH,
    SETTING_MIN_SAMPLES,
    SETTING_SAMPLER,
    SETTING_SAMPLES,
    SETTING_SEED,
    SETTING_SHADOWS,
    SETTING_SKIP,
    SETTING_WIDTH,
)

_SAMPLERS: Final = {
    "independent": SAMPLER_INDEPENDENT,
    "stratified": SAMPLER_STRATIFIED,
    "sobol": SAMPLER_SOBOL,
}


def build_settings(scene: SceneDoc) -> NDArray[np.int64]:
    """Return `settings`."""
    settings = np.zeros(N_SETTINGS, np.int64)
    x, y, width, height = scene.image.rect
    settings[SETTING_WIDTH] = scene.image.width
    settings[SETTING_HEIGHT] = scene.image.height
    settings[SETTING_CROP_X] = x
    settings[SETTING_CROP_Y] = y
    settings[SETTING_CROP_WIDTH] = width
    settings[SETTING_CROP_HEIGHT] = height
    settings[SETTING_SAMPLES] = scene.sampling.samples
    settings[SETTING_SAMPLER] = _SAMPLERS[scene.sampling.sampler]
    settings[SETTING_SEED] = scene.sampling.seed
    settings[SETTING_MAX_DEPTH] = scene.integrator.max_depth
    settings[SETTING_SHADOWS] = scene.integrator.shadows
    orthographic = scene.camera.view(scene.image.width, scene.image.height).orthographic
    settings[SETTING_CAMERA] = CAMERA_ORTHOGRAPHIC if orthographic else CAMERA_VIEW_PLANE
    settings[SETTING_SKIP] = 1
    adaptive = scene.sampling.adaptive
    if adaptive is not None and adaptive.threshold > 0.0:  # no contrast is below 0: nothing to ask
        settings[SETTING_MIN_SAMPLES] = adaptive.min_samples
    return settings


def build_limits(scene: SceneDoc) -> NDArray[np.float64]:
    """Return `limits`."""
    limits = np.zeros(N_LIMITS)
    limits[LIMIT_MIN_THROUGHPUT] = scene.integrator.min_throughput
    if scene.sampling.adaptive is not None:
        limits[LIMIT_ADAPTIVE_THRESHOLD] = scene.sampling.adaptive.threshold
    return limits


def build_camera(scene: SceneDoc) -> NDArray[np.float64]:
    """Return `camera`."""
    view = scene.camera.view(scene.image.width, scene.image.height)
    camera = np.zeros(N_CAMERA)
    for column, vector in ((CAMERA_EYE, view.eye), (CAMERA_U, view.u), (CAMERA_V, view.v), (CAMERA_W, view.w)):
        camera[column : column + 3] = vector
    for column, number in (
        (CAMERA_LEFT, view.left),
        (CAMERA_RIGHT, view.right),
        (CAMERA_BOTTOM, view.bottom),
        (CAMERA_TOP, view.top),
        (CAMERA_DISTANCE, view.distance),
    ):
        camera[column] = number
    return camera
