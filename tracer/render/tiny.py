"""A scene small enough to render in no time, through the same kernels as any other: what `warm` compiles with."""

from typing import Any

import numpy as np

from tracer.accel import build_bvh
from tracer.render.blocks import render_blocks
from tracer.types import (
    COUNTERS,
    FIELDS,
    MATERIAL_A,
    MATERIAL_ETA,
    N_MATERIAL,
    N_SETTINGS,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_HEIGHT,
    SETTING_SAMPLES,
    SETTING_WIDTH,
    CompiledScene,
)


def make_scene(**fields: Any) -> CompiledScene:
    """Complete a compiled scene: empty arrays for what is not given, the hierarchy built from what is.

    Parameters
    ----------
    **fields
        Arrays of :class:`tracer.types.CompiledScene`, converted to the dtypes of :data:`tracer.types.FIELDS`.

    Returns
    -------
    CompiledScene
    """
    arrays: dict[str, Any] = {}
    for name, (dtype, shape) in FIELDS.items():
        if name in fields:
            arrays[name] = np.ascontiguousarray(fields[name], dtype)
        else:
            arrays[name] = np.zeros([length or 0 for length in shape], dtype)
    bvh = build_bvh(
        arrays["vertex_positions"],
        arrays["face_vertices"],
        arrays["shape_kind"],
        arrays["shape_origin"],
        arrays["shape_to_world"],
    )
    return CompiledScene(**{**arrays, **bvh._asdict()})


def make_tiny() -> CompiledScene:
    """One triangle in front of a 1 x 1 picture, lit by nothing."""
    settings = np.zeros(N_SETTINGS, np.int64)
    settings[[SETTING_WIDTH, SETTING_HEIGHT, SETTING_CROP_WIDTH, SETTING_CROP_HEIGHT, SETTING_SAMPLES]] = 1
    material = np.zeros((1, N_MATERIAL))
    material[0, [MATERIAL_A, MATERIAL_ETA]] = 1.0
    return make_scene(
        settings=settings,
        camera=[0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -1, 1, -1, 1, 1],
        vertex_positions=[[-1, -1, -1], [1, -1, -1], [0, 1, -1]],
        vertex_normals=np.zeros((3, 3)),
        vertex_uvs=np.zeros((3, 2)),
        vertex_colors=np.ones((3, 3)),
        face_vertices=[[0, 1, 2]],
        face_material=[0],
        face_flags=[0],
        materials=material,
        material_flags=[[-1, 0, 0, 1]],
        ambient=[1, 1, 1],
    )


def render_tiny() -> None:
    """Render the tiny scene: compiles, or loads from disk, every kernel that rendering uses."""
    blocks = np.zeros((1, 2), np.int32)
    counters = np.zeros(len(COUNTERS), np.int64)
    render_blocks(make_tiny(), blocks, 0, 1, np.zeros(1, np.int64), np.zeros((1, 2, 16, 16, 3)), counters)
