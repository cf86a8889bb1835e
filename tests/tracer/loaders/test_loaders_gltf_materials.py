"""Materials of glTF in the terms of equation 9."""

import numpy as np
import pytest
from loader_files import UVS, Gltf, model_file, png_bytes

from tracer.loaders.gltf import load_gltf
from tracer.loaders.limits import DEFAULT_LIMITS


def _load(tmp_path, model, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.gltf", model.gltf() if isinstance(model, Gltf) else model, limits=limits)
    return load_gltf(file, file.read())


def test_materials_and_images(tmp_path):
    (tmp_path / "red.png").write_bytes(png_bytes(4, 2))
    model = Gltf().with_triangle()
    model.primitive["attributes"]["TEXCOORD_0"] = model.add(UVS)
    model.primitive["material"] = 1
    model.tree |= {
        "images": [{"uri": "unused.png"}, {"uri": "red.png"}],
        "samplers": [{"magFilter": 9728, "wrapS": 33071}],
        "textures": [{"source": 1, "sampler": 0}],
        "materials": [
            {},
            {
                "name": "paint",
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.5, 0.25, 1, 0.5],
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.5,
                },
                "alphaMode": "BLEND",
                "emissiveFactor": [0, 1, 0],
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 3}},
            },
        ],
    }
    mesh = _load(tmp_path, model)
    (material,) = mesh.materials
    assert material.name == "paint"
    assert material.kd == (0.5, 0.25, 1)
    assert np.allclose(material.ks, 0.04)
    assert material.exponent == pytest.approx(30)
    assert material.ke == (0, 3, 0)
    assert material.opacity == 0.5
    assert (material.wrap, material.filter, material.image) == ("clamp", "nearest", 0)
    assert mesh.images[0].shape == (2, 4, 3)
    assert mesh.groups[0].names == ("thing", "paint")
    assert mesh.warnings == ()


def test_metal(tmp_path):
    model = Gltf().with_triangle()
    model.primitive["material"] = 0
    factors = {"baseColorFactor": [1, 0.5, 0, 1], "metallicFactor": 1, "roughnessFactor": 0.25}
    model.tree["materials"] = [{"pbrMetallicRoughness": factors}]
    (material,) = _load(tmp_path, model).materials
    assert material.kr == (0.75, 0.375, 0)
    assert material.kd == (0.25, 0.125, 0)
    assert material.ks == (1, 0.5, 0)


def test_glass(tmp_path):
    model = Gltf().with_triangle()
    model.primitive["material"] = 0
    model.tree["materials"] = [
        {
            "extensions": {
                "KHR_materials_transmission": {"transmissionFactor": 0.9},
                "KHR_materials_ior": {"ior": 1.33},
            }
        }
    ]
    (material,) = _load(tmp_path, model).materials
    assert material.opacity == pytest.approx(0.1)
    assert material.eta == 1.33


def test_a_missing_image_is_a_warning(tmp_path):
    model = Gltf().with_triangle()
    model.primitive["material"] = 0
    model.tree |= {
        "images": [{"uri": "http://127.0.0.1:9/x.png"}],
        "textures": [{"source": 0}],
        "materials": [{"name": "m", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }
    mesh = _load(tmp_path, model)
    assert mesh.images == ()
    assert "never opened" in mesh.warnings[0]
