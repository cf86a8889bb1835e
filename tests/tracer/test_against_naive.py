"""The kernels against the oracle, ray by ray: random small scenes at the same sample positions.

Both are float64, so pixels agree to the rounding errors of their different formulas. Where a ray passes within such an error of an
edge, of a silhouette or of a shadow's border the two may see different surfaces: a handful of pixels of all is allowed for.
"""

import functools
import json

import numpy as np
import pytest
from PIL import Image

from scenes import make_textures
from tests.kernel_pictures import SAMPLERS, render_kernel, render_oracle
from tests.random_scenes import random_document

RELATIVE = 1e-9
N_SCENES = 40


def differing(doc, relative=RELATIVE, resolve=None, textures=None):
    """Return how many pixels differ, and of how many that are not plain background."""
    ours, oracle = render_kernel(doc, resolve), render_oracle(doc, textures)
    assert np.isfinite(ours).all()
    wrong = (np.abs(ours - oracle) > relative * np.maximum(1.0, np.abs(oracle))).any(axis=2)
    seen = (oracle != oracle[0, 0]).any(axis=2)
    return int(wrong.sum()), int(seen.sum())


@functools.cache
def compare(kind, seed):
    options = {"plain": {}, "clear": {"clear": True}, "meshes": {"clear": True, "shapes": False}}[kind]
    return differing(random_document(seed, **options))


@pytest.mark.parametrize("seed", range(N_SCENES))
@pytest.mark.parametrize("kind", ["plain", "clear", "meshes"])
def test_random_scene(kind, seed):
    wrong, _ = compare(kind, seed)
    assert wrong <= 1


@pytest.mark.parametrize("kind", ["plain", "clear", "meshes"])
def test_nearly_nothing_differs(kind):
    """Over all scenes of a kind at most one pixel in 10,000 differs, and the pictures are not empty."""
    results = np.array([compare(kind, seed) for seed in range(N_SCENES)])
    wrong, seen = results.sum(axis=0)
    assert seen > 150 * N_SCENES
    assert wrong <= 32 * 24 * N_SCENES // 10_000


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_all_samples_of_a_pixel(sampler):
    doc = random_document(3)
    doc["sampling"] |= {"samples": 6, "sampler": sampler}
    assert differing(doc)[0] <= 1


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    levels = np.random.default_rng(4).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    path = tmp_path_factory.mktemp("texture") / "picture.png"
    Image.fromarray(levels).save(path)
    return path, levels


@pytest.mark.parametrize("seed", range(12))
def test_textured_scene(seed, picture):
    """Texels are float32 in the kernel: relative 1e-7."""
    path, levels = picture
    doc = random_document(seed, textured=True) | {"assets": {"picture": {"file": path.name}}}
    assert differing(doc, 1e-6, lambda _: path, {"picture": levels})[0] <= 1


def test_scene_of_textures():
    """``scenes/textures.json``, small."""
    doc = json.loads((make_textures.FOLDER / "textures.json").read_text())
    doc["image"] = {"width": 84, "height": 48}
    doc["sampling"] = {"samples": 2, "seed": 3, "sampler": "stratified"}
    wrong, seen = differing(doc, 1e-6, lambda _: make_textures.IMAGE, {"tiles": make_textures.tile()})
    assert wrong <= 2
    assert seen > 1000
