"""Settings, camera, lights: the document's numbers at the kernel's places."""

import numpy as np
import pytest
from compile_scenes import compiled, document
from PIL import Image

from tracer import types
from tracer.render.materials import build_lights
from tracer.types import (
    FILTER_NEAREST,
    FLAG_FILTER,
    FLAG_TEXTURE,
    FLAG_TWO_SIDED,
    FLAG_WRAP,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KT,
    TEXTURE_HEIGHT,
    TEXTURE_OFFSET,
    TEXTURE_WIDTH,
    WRAP_CLAMP,
)


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


def test_textures(tmp_path):
    pixels = np.array([[[0, 128, 255], [255, 0, 0]]], np.uint8)
    Image.fromarray(pixels).save(tmp_path / "t.png")
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "u.png")
    materials = {
        "linear": {"diffuse_texture": {"asset": "t", "color_space": "linear"}},
        "srgb": {"diffuse_texture": {"asset": "t", "wrap": "clamp", "filter": "nearest"}, "two_sided": False},
        "again": {"diffuse_texture": {"asset": "t"}},
        "black": {"diffuse_texture": {"asset": "u"}},
    }
    things = [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": name} for name in materials]
    assets = {"t": {"file": "t.png"}, "u": {"file": "u.png"}}
    scene, stats = compiled(*things, materials=materials, assets=assets, folder=tmp_path)
    assert stats.n_textures == 3  # t twice, once in each colour space
    linear, srgb, again, _ = (scene.material_flags[material] for material in scene.shape_material)
    assert again[FLAG_TEXTURE] == srgb[FLAG_TEXTURE] != linear[FLAG_TEXTURE]
    assert (srgb[FLAG_WRAP], srgb[FLAG_FILTER], srgb[FLAG_TWO_SIDED]) == (WRAP_CLAMP, FILTER_NEAREST, 0)
    texture = scene.textures[srgb[FLAG_TEXTURE]]
    assert texture[[TEXTURE_WIDTH, TEXTURE_HEIGHT]].tolist() == [2, 1]
    texels = scene.texels[texture[TEXTURE_OFFSET] :][:2]
    assert np.allclose(texels, [[0, 0.2158605, 1], [1, 0, 0]])
    texels = scene.texels[scene.textures[linear[FLAG_TEXTURE], TEXTURE_OFFSET] :][:2]
    assert np.allclose(texels, pixels[0] / 255)


def test_materials_of_files(tmp_path):
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl glass\nf 1 2 3\n")
    (tmp_path / "m.mtl").write_text("newmtl glass\nKa 1 1 1\nKd 0.4 0.4 0.4\nNs 50\nd 0.25\nNi 1.5\n")
    scene, _ = compiled({"type": "mesh_asset", "asset": "m"}, assets={"m": {"file": "m.obj"}}, folder=tmp_path)
    row = scene.materials[scene.face_material[0]]
    assert np.allclose(row[MATERIAL_KD : MATERIAL_KD + 3], 0.1)
    assert np.allclose(row[MATERIAL_KA : MATERIAL_KA + 3], 0.1)
    assert np.allclose(row[MATERIAL_KT : MATERIAL_KT + 3], 0.75)
    assert row[MATERIAL_EXPONENT] == 50
