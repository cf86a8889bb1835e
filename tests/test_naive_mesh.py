"""The oracle's mesh against its triangles one by one, and the renderer against that oracle in a crop of the MINI."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from scenes import make_mini_cornell
from tests import agreement, naive
from tests.kernel_pictures import positions_at
from tests.naive_mesh import Mesh, meets
from tests.naive_scenes import read_assets, read_document
from tracer.render import render_scene
from tracer.scene import parse_scene

DATA = Path(os.environ.get("SMALTI_DATA") or Path(__file__).parent.parent.parent / "shared")


def triangles_of(mesh):
    """Return a mesh's triangles as primitives of their own."""
    return [
        naive.Triangle(
            *corners.tolist(),
            mesh.material,
            *(None if v is None else v[k] for v in (mesh.normals, mesh.uvs, mesh.colors)),
        )
        for k, corners in enumerate(mesh.corners)
    ]


def scene_of(primitives):
    return naive.Scene(None, 1, 1, primitives, [])


def random_mesh(generator, n):
    """Return small triangles near each other, some of them flat in a coordinate plane, some twice."""
    corners = generator.normal(size=(n, 1, 3)) + 0.5 * generator.normal(size=(n, 3, 3))
    corners[::5, :, 1] = np.round(corners[::5, :1, 1])
    corners[n // 2 :: 7] = corners[: len(corners[n // 2 :: 7])]
    attributes = [generator.normal(size=(n, 3, width)) for width in (3, 2, 3)]
    return Mesh(corners, naive.Material(kt=[0.5, 0.25, 1.0]), *attributes)


def random_rays(generator, n, mesh):
    """Return rays, some of them at triangles, some along axes and some in the planes of boxes."""
    o = 2.0 * generator.normal(size=(3, n))
    corners = mesh.corners[generator.integers(0, len(mesh.corners), n)]
    d = (generator.dirichlet([1, 1, 1], n)[:, :, None] * corners).sum(axis=1).T - o
    d[:, 1::4] = generator.normal(size=d[:, 1::4].shape)
    d[:, ::4] = np.eye(3)[generator.integers(0, 3, len(d[0, ::4]))].T * generator.choice([-1.0, 1.0], len(d[0, ::4]))
    o[1, ::8] = np.round(o[1, ::8])
    return o, d


@pytest.mark.parametrize("n", [1, 15, 16, 17, 100])
def test_the_same_bits_as_triangles_one_by_one(n):
    generator = np.random.default_rng(n)
    mesh = random_mesh(generator, n)
    single = triangles_of(mesh)
    o, d = random_rays(generator, 2000, mesh)
    index, t, part, u, v = naive.closest_hit(scene_of([mesh]), o, d)
    face, *expected = naive.closest_hit(scene_of(single), o, d)
    met = face >= 0
    assert met.sum() >= 1000
    assert np.array_equal(index == 0, met)
    assert np.array_equal(part[met], face[met])
    for ours, theirs in zip((t, u, v), (expected[0], *expected[2:]), strict=True):
        assert np.array_equal(ours, theirs)
    for ours, theirs in zip(
        naive.transmittance(scene_of([mesh]), o, d, 1.5), naive.transmittance(scene_of(single), o, d, 1.5), strict=True
    ):
        assert ours == pytest.approx(theirs, rel=1e-12)
    for k in np.unique(part[met])[:20]:
        (rays,) = np.nonzero(met & (part == k))
        at = [x[rays] for x in (t, part, u, v)]
        ours, theirs = mesh.surface(o, d, *at), single[k].surface(o, d, *at)
        for name in ("point", "normal", "geometric", "uv", "color"):
            assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name


def test_boxes():
    """Rays through the box, past it, behind, out of reach; and along faces, where 0/0 tells nothing."""
    o = np.array(
        [
            [0.5, 1.5, 0.5, 0.5, 0.0, 1.0, 0.0],
            [0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 2.0],
            [-1.0, -1.0, 2.0, -3.0, -1.0, -1.0, -1.0],
        ]
    )
    d = np.repeat([[0.0], [0.0], [1.0]], 7, axis=1)
    assert meets([0, 0, 0], [1, 1, 1], o, d, 0.0, 2.0).tolist() == [True, False, False, False, True, True, False]


def test_what_a_mesh_lacks():
    """Flat normals, and no colour, as a triangle has them."""
    mesh = Mesh(np.random.default_rng(1).normal(size=(1, 3, 3)), naive.Material())
    at = (np.ones(1), np.zeros(1, dtype=int), np.array([0.25]), np.array([0.5]))
    ours, theirs = mesh.surface(None, None, *at), triangles_of(mesh)[0].surface(None, None, *at)
    assert np.array_equal(ours.normal, theirs.geometric)
    assert np.array_equal(ours.color, theirs.color)
    assert np.array_equal(ours.uv, theirs.uv)


@pytest.mark.parametrize("scale", [1.0, -0.5])
def test_a_model_is_the_mesh_of_its_numbers(scale):
    """Groups with materials, one of them a mirror and one of glass, under a transform that may mirror."""
    generator = np.random.default_rng(7)
    n = 60
    places = generator.normal(size=(n, 1, 3)) * 0.6 + 0.3 * generator.normal(size=(n, 3, 3))
    vertices = np.concatenate(
        [places.reshape(-1, 3), generator.normal(size=(3 * n, 3)), generator.random((3 * n, 2))], axis=1
    )
    faces = np.arange(3 * n).reshape(-1, 3)
    groups = {"b": [0, 20], "a": [20, 45], "c": [45, 60]}
    thing = {
        "material": "matt",
        "materials": {"a": "mirror", "c": "glass"},
        "transform": [
            {"type": "scale", "by": [1.0, scale, 1.0]},
            {"type": "rotate", "axis": [1, 2, 0], "angle_deg": 30},
            {"type": "translate", "by": [0, 0, -4]},
        ],
    }
    mesh = {
        "type": "mesh",
        "positions": vertices[:, :3].tolist(),
        "normals": vertices[:, 3:6].tolist(),
        "uvs": vertices[:, 6:].tolist(),
        "faces": faces.tolist(),
        "groups": groups,
    }
    document = {
        "camera": {"type": "perspective", "fov_deg": 25},
        "image": {"width": 24, "height": 18},
        "integrator": {"max_depth": 2},
        "materials": {
            "matt": {"diffuse_texture": {"asset": "levels"}},
            "mirror": {"kd": 0.2, "kr": 0.6, "two_sided": False},
            "glass": {"kd": 0.1, "kt": [0.7, 0.8, 0.9], "eta": 1.1},
        },
        "lights": [{"type": "point", "position": [2, 3, 1]}, {"type": "ambient", "intensity": 0.2}],
    }
    textures = {"levels": generator.integers(0, 256, (4, 4, 3), dtype=np.uint8)}
    model = {"vertexdata": vertices.ravel().tolist(), "indexdata": faces.ravel().tolist(), "groups": groups}
    ours = read_document(
        document | {"objects": [{"type": "mesh_asset", "asset": "it"} | thing]}, textures, {"it": model}
    )
    theirs = read_document(document | {"objects": [mesh | thing]}, textures)
    assert len(ours.primitives) == 3
    assert len(theirs.primitives) == n
    y, x = np.mgrid[0:18, 0:24] + 0.5
    picture, expected = naive.trace(ours, x, y), naive.trace(theirs, x, y)
    assert (expected > 0).any(axis=1).mean() > 0.2
    assert np.abs(picture - expected).max() < 1e-12


@pytest.mark.skipif(
    not (DATA / make_mini_cornell.GEOMETRY).is_file(),
    reason="no seed data: set SMALTI_DATA (files of github.com/WhoFama24/cse6413-raytracer, commit 167f0b0)",
)
@pytest.mark.parametrize(("left", "top"), [(2311, 1638), (2932, 1500)], ids=["wheel", "grille"])
def test_a_crop_of_the_mini(left, top):
    """12 x 8 pixels of the large picture, all their samples; ``make mini-check`` looks at more."""
    width, height = 12, 8
    document = json.loads(make_mini_cornell.OUTPUT.read_text())
    cropped = document | {
        "image": document["image"] | {"crop": {"x": left, "y": top, "width": width, "height": height}}
    }
    film = render_scene(parse_scene(cropped), lambda asset: DATA / asset.file)
    pixels = [(x, y) for y in range(top, top + height) for x in range(left, left + width)]
    scene = read_document(document, *read_assets(document, DATA))
    x, y = positions_at(document["sampling"], pixels)
    oracle = naive.trace(scene, x, scene.height - y).reshape(*x.shape, 3).mean(axis=1)
    assert np.ptp(oracle) > 0.15
    assert not agreement.beyond(film.pixels.reshape(-1, 3).astype(float), oracle, 2.0**-22).any()
