"""Compiled scenes by hand, for tests below the scene document."""

import numpy as np

from tracer.render.tiny import make_scene
from tracer.types import (
    LIGHT_AMBIENT,
    LIGHT_DIFFUSE,
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_SPECULAR,
    MATERIAL_A,
    MATERIAL_ETA,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KR,
    MATERIAL_KS,
    MATERIAL_KT,
    N_LIGHT,
    N_MATERIAL,
    N_SETTINGS,
    SAMPLER_SOBOL,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_HEIGHT,
    SETTING_MAX_DEPTH,
    SETTING_SAMPLER,
    SETTING_SAMPLES,
    SETTING_SEED,
    SETTING_SHADOWS,
    SETTING_SKIP,
    SETTING_WIDTH,
    SHAPE_SPHERE,
)

COLUMNS = {
    "ka": MATERIAL_KA,
    "kd": MATERIAL_KD,
    "ks": MATERIAL_KS,
    "ke": MATERIAL_KE,
    "kr": MATERIAL_KR,
    "kt": MATERIAL_KT,
    "exponent": MATERIAL_EXPONENT,
    "eta": MATERIAL_ETA,
    "a": MATERIAL_A,
    "b": MATERIAL_A + 1,
    "c": MATERIAL_A + 2,
}


def settings(width=40, height=24, samples=4, depth=3, seed=0, sampler=SAMPLER_SOBOL, shadows=1, skip=1, crop=None):
    values = np.zeros(N_SETTINGS, np.int64)
    x, y, w, h = crop or (0, 0, width, height)
    for name, value in {
        SETTING_WIDTH: width,
        SETTING_HEIGHT: height,
        SETTING_CROP_X: x,
        SETTING_CROP_Y: y,
        SETTING_CROP_WIDTH: w,
        SETTING_CROP_HEIGHT: h,
        SETTING_SAMPLES: samples,
        SETTING_SAMPLER: sampler,
        SETTING_SEED: seed,
        SETTING_MAX_DEPTH: depth,
        SETTING_SHADOWS: shadows,
        SETTING_SKIP: skip,
    }.items():
        values[name] = value
    return values


def material(**given):
    row = np.zeros(N_MATERIAL)
    row[[MATERIAL_A, MATERIAL_ETA, MATERIAL_EXPONENT]] = 1.0, 1.0, 20.0
    for name, value in given.items():
        wide = 3 if name.startswith("k") else 1
        row[COLUMNS[name] : COLUMNS[name] + wide] = value
    return row


def directional(direction, diffuse=1.0, specular=1.0, ambient=0.0):
    row = np.zeros(N_LIGHT)
    row[LIGHT_DIRECTION : LIGHT_DIRECTION + 3] = np.array(direction, float) / np.linalg.norm(direction)
    row[LIGHT_DIFFUSE : LIGHT_DIFFUSE + 3] = diffuse
    row[LIGHT_SPECULAR : LIGHT_SPECULAR + 3] = specular
    row[LIGHT_AMBIENT : LIGHT_AMBIENT + 3] = ambient
    return row


def build(quads=(), spheres=(), lights=(), **fields):
    """Quads: (four corners, material row); spheres: (centre, radius, material row). The eye at 0 looks along -z, 90 degrees wide."""
    rows, positions, faces, face_material, shape_material = [], [], [], [], []
    for corners, row in quads:
        n = len(positions)
        positions += list(corners)
        faces += [(n, n + 1, n + 2), (n, n + 2, n + 3)]
        face_material += [len(rows)] * 2
        rows.append(row)
    for _, _, row in spheres:
        shape_material.append(len(rows))
        rows.append(row)
    radii = np.array([radius for _, radius, _ in spheres], float).reshape(-1, 1, 1)
    given = {
        "settings": settings(),
        "camera": [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -1, 1, -0.6, 0.6, 1],
        "vertex_positions": np.reshape(positions, (-1, 3)),
        "vertex_normals": np.zeros((len(positions), 3)),
        "vertex_uvs": np.zeros((len(positions), 2)),
        "vertex_colors": np.ones((len(positions), 3)),
        "face_vertices": np.reshape(faces, (-1, 3)),
        "face_material": face_material,
        "face_flags": np.zeros(len(faces)),
        "shape_kind": [SHAPE_SPHERE] * len(spheres),
        "shape_material": shape_material,
        "shape_origin": np.reshape([center for center, _, _ in spheres], (-1, 3)),
        "shape_to_world": np.eye(3) * radii,
        "shape_to_local": np.eye(3) / radii,
        "materials": np.reshape(rows, (-1, N_MATERIAL)),
        "material_flags": np.tile([-1, 0, 0, 1], (len(rows), 1)),
        "lights": np.reshape(lights, (-1, N_LIGHT)),
        "light_kind": [LIGHT_KIND_DIRECTIONAL] * len(lights),
    }
    return make_scene(**(given | fields))


def mixed(**fields):
    """A floor, a mirror sphere, a glass sphere and a plain one under two lights, before a background."""
    floor = [[-9, -1, -20], [-9, -1, -1], [9, -1, -1], [9, -1, -20]]
    return build(
        quads=[(floor, material(ka=0.5, kd=0.7, kr=0.2))],
        spheres=[
            ((-1.2, -0.2, -4), 0.8, material(kd=0.1, ks=0.9, kr=[0.9, 0.8, 0.7])),
            ((1.2, -0.2, -4), 0.8, material(ks=0.5, kr=0.1, kt=0.85, eta=1.5)),
            ((0, 0.5, -6), 1.0, material(ka=0.3, kd=[0.9, 0.4, 0.2], ks=0.5)),
        ],
        lights=[directional((-1, -2, -1)), directional((1, -1, 0), diffuse=0.4)],
        background=[0.1, 0.2, 0.4],
        ambient=[0.1, 0.1, 0.1],
        **fields,
    )
