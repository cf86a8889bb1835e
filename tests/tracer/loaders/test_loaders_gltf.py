"""glTF: instances, attributes, materials, and trees that lie."""

import json

import numpy as np
import pytest
from loader_files import NORMALS, TRIANGLE, UVS, Gltf, data_folder, model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.files import ModelFile
from tracer.loaders.gltf import load_gltf
from tracer.loaders.limits import DEFAULT_LIMITS


def _load(tmp_path, model, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.gltf", model.gltf() if isinstance(model, Gltf) else model, limits=limits)
    return load_gltf(file, file.read())


def test_both_forms_are_the_same(tmp_path):
    model = Gltf().with_triangle()
    one = _load(tmp_path, model)
    file = model_file(tmp_path, "a.glb", model.glb())
    other = load_gltf(file, file.read())
    assert np.array_equal(one.positions, TRIANGLE)
    assert np.array_equal(one.normals, NORMALS)
    assert np.array_equal(one.positions, other.positions)
    assert np.array_equal(one.faces, other.faces)
    assert one.groups[0].names == ("thing",)


def test_instances_are_baked(tmp_path):
    model = Gltf().with_triangle()
    model.tree["nodes"] = [
        {"name": "root", "children": [1, 2], "translation": [10, 0, 0]},
        {"name": "turned", "mesh": 0, "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 1, 1]},
        {"name": "mirrored", "mesh": 0, "scale": [-1, 1, 1]},
    ]
    mesh = _load(tmp_path, model)
    turned, mirrored = mesh.positions[:3], mesh.positions[3:]
    assert np.allclose(turned, [[10, 0, 0], [10, 2, 0], [9, 0, 0]])
    assert np.allclose(mirrored, [[10, 0, 0], [9, 0, 0], [10, 1, 0]])
    # Turned round, so that the mirrored triangle still looks where its normals do.
    for face in mesh.faces:
        a, b, c = mesh.positions[face]
        assert np.cross(b - a, c - a)[2] > 0
    assert (mesh.normals[:, 2] > 0).all()
    assert mesh.groups[0].names == ("turned", "thing")
    assert mesh.face_group.tolist() == [0, 1]


def test_normals_take_the_inverse_transpose(tmp_path):
    model = Gltf().with_triangle()
    model.primitive["attributes"]["NORMAL"] = model.add(np.array([[1, 1, 0]] * 3, np.float32))
    model.tree["nodes"] = [{"mesh": 0, "scale": [2, 1, 1]}]
    normal = _load(tmp_path, model).normals[0]
    assert np.allclose(normal / normal[1], [0.5, 1, 0])


def test_a_node_under_a_camera_is_drawn(tmp_path):
    model = Gltf().with_triangle()
    model.tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1, "aspectRatio": 1}}]
    model.tree["nodes"] = [{"camera": 0, "children": [1], "translation": [0, 5, 0]}, {"mesh": 0}]
    assert _load(tmp_path, model).positions[0].tolist() == [0, 5, 0]


@pytest.mark.parametrize(
    "kind", [np.float32, np.uint8, np.uint16], ids=["float", "normalised bytes", "normalised shorts"]
)
def test_texture_coordinates_grow_upwards(tmp_path, kind):
    model = Gltf().with_triangle()
    if kind is np.float32:
        model.primitive["attributes"]["TEXCOORD_0"] = model.add(UVS)
    else:
        stored = (UVS * np.iinfo(kind).max).astype(kind)
        model.primitive["attributes"]["TEXCOORD_0"] = model.add(stored, normalized=True)
    mesh = _load(tmp_path, model)
    assert np.allclose(mesh.uvs, [[0, 1], [1, 1], [0, 0]])  # though the primitive has no material


def test_vertex_colours_are_linear(tmp_path):
    model = Gltf().with_triangle()
    colors = np.array([[255, 0, 0, 255], [128, 0, 0, 255], [0, 0, 0, 0]], np.uint8)
    model.primitive["attributes"]["COLOR_0"] = model.add(colors, normalized=True)
    model.tree["materials"] = [{}]
    model.primitive["material"] = 0
    assert np.allclose(_load(tmp_path, model).colors[:, 0], [1, 128 / 255, 0])


def test_strips_and_other_modes(tmp_path):
    model = Gltf()
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    attributes = {"POSITION": model.add(square)}
    model.tree["meshes"][0]["primitives"] = [
        {"attributes": attributes, "mode": 1},
        {"attributes": attributes, "mode": 5, "indices": model.add(np.arange(4, dtype=np.uint16))},
        {"attributes": attributes, "indices": model.add(np.array([0, 1, 2], np.uint8))},
    ]
    mesh = _load(tmp_path, model)
    assert len(mesh.faces) == 3
    corners = mesh.positions[mesh.faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    assert mesh.warnings == ("points, lines or triangle fans are left out",)


def _broken(**changes):
    model = Gltf().with_triangle()
    for path, value in changes.items():
        target = model.tree
        *keys, last = path.split("__")
        for key in keys:
            target = target[int(key)] if key.isdigit() else target[key]
        target[int(last) if last.isdigit() else last] = value
    return model


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"scene": 4}, "shows scene 4"),
        ({"nodes": [{"children": [0]}]}, "its own ancestor"),
        ({"scenes": [{"nodes": [0, 1]}], "nodes": [{"children": [1], "mesh": 0}, {"mesh": 0}]}, "two parents"),
        ({"accessors__0__count": 4_000_000_000}, "reaches beyond its buffer view"),
        ({"bufferViews__0__byteLength": 10**9}, "reaches beyond its buffer"),
        ({"accessors__0__count": -1}, "not valid glTF"),
        ({"accessors__0": {"count": 10**12, "componentType": 5126, "type": "VEC3"}}, "accessor 0 without data"),
        ({"nodes__0__mesh": 7}, "not valid glTF"),
        ({"nodes__0__mesh": -1}, "not valid glTF"),
        ({"nodes__0__matrix": [0.0] * 15 + [float("nan")]}, "not finite and affine"),
        ({"nodes__0__scale": [1, 1]}, "not valid glTF"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "needs the extension KHR_draco"),
        ({"asset": {"version": "1.0"}}, "not of glTF version 2"),
        ({"nodes": "x"}, "not valid glTF"),
    ],
)
def test_trees_that_lie(tmp_path, changes, reason):
    with pytest.raises(LoadError, match=reason):
        _load(tmp_path, _broken(**changes))


def test_deep_trees_do_not_exhaust_the_stack(tmp_path):
    model = Gltf().with_triangle()
    model.tree["nodes"] = [{"children": [index + 1]} for index in range(5000)] + [{"mesh": 0}]
    assert len(_load(tmp_path, model).faces) == 1
    with pytest.raises(LoadError, match="not JSON"):
        _load(tmp_path, "[" * 200_000)


def test_instancing_bombs_are_refused(tmp_path):
    model = Gltf().with_triangle()
    model.tree["nodes"] = [{"mesh": 0} for _ in range(100)]
    model.tree["scenes"] = [{"nodes": list(range(100))}]
    with pytest.raises(LoadError, match="draws 100 triangles"):
        _load(tmp_path, model, DEFAULT_LIMITS._replace(faces=99))


def test_cut_glb(tmp_path):
    data = Gltf().with_triangle().glb()
    for length in (0, 4, 12, 20, 60, len(data) - 40, len(data) - 8):
        file = model_file(tmp_path, "a.glb", data[:length] or b"x")
        with pytest.raises(LoadError):
            load_gltf(file, file.read())


def test_herd_has_all_its_instances():
    folder = data_folder("models/herd")
    file = ModelFile(folder / "herd.glb", "herd.glb", None, DEFAULT_LIMITS)
    mesh = load_gltf(file, file.read())
    assert len(mesh.faces) == 29_282
    used = mesh.positions[mesh.faces].reshape(-1, 3)
    assert np.allclose(used.min(axis=0), [-6, -0.757819, -6], atol=1e-5)
    assert np.allclose(used.max(axis=0), [6, 1.43974, 6], atol=1e-5)
    names = json.dumps([group.names for group in mesh.groups])
    assert "cow_trs" in names
    # Every triangle looks where its normals look, the mirrored cow's, too.
    corners = mesh.positions[mesh.faces]
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shading = mesh.normals[mesh.faces].sum(axis=1)
    agree = (geometric * shading).sum(axis=1) > 0
    for group in range(len(mesh.groups)):
        assert agree[mesh.face_group == group].mean() > 0.99
