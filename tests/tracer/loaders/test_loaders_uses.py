"""Meshes that a glTF file draws several times: stored once, and flattened the same triangles bit for bit."""

import numpy as np
import pytest
from loader_files import Gltf, model_file

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import random_turn
from tests.tracer.render.compile_scenes import document
from tracer.loaders import limits
from tracer.loaders.gltf import load_gltf
from tracer.loaders.handover import open_mesh, save_mesh
from tracer.loaders.uses import flattened, may_place, separate
from tracer.render import parts, render_compiled
from tracer.render.compile import compile_scene
from tracer.render.sources import SceneFiles

ARRAYS = ("positions", "faces", "normals", "uvs", "face_flags", "face_group")


def crowd(rng, n=5, *, extra=True):
    """Balls of two primitives and materials, turned, squeezed and mirrored; and a ball of another mesh between them."""
    model = Gltf()
    vertices, faces = icosphere(2, np.random.default_rng(3), 0.05)
    normals = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    attributes = {
        "POSITION": model.add(vertices.astype(np.float32)),
        "NORMAL": model.add(normals.astype(np.float32)),
        "TEXCOORD_0": model.add((normals[:, :2] * 0.5 + 0.5).astype(np.float32)),
    }
    half = len(faces) // 2
    primitives = [
        {"attributes": attributes, "indices": model.add(some.astype(np.uint32).ravel()), "material": k}
        for k, some in enumerate((faces[:half], faces[half:]))
    ]
    model.tree["materials"] = [{"name": "upper"}, {"name": "lower"}]
    model.tree["meshes"] = [{"name": "ball", "primitives": primitives}, {"name": "alone", "primitives": primitives[:1]}]
    nodes = []
    for k in range(n):
        matrix = np.eye(4)
        matrix[:3, :3] = random_turn(rng) @ np.diag(rng.uniform(0.4, 1.0, 3) * [1, 1, 1 if k % 2 else -1])
        matrix[:3, 3] = [2.2 * k, 0.3 * k, 0.0]
        nodes.append({"name": f"use{k}", "mesh": 0, "matrix": matrix.T.ravel().tolist()})
    if extra:
        nodes.insert(1, {"name": "once", "mesh": 1, "translation": [0, 5, 0]})
    model.tree["nodes"], model.tree["scenes"] = nodes, [{"nodes": list(range(len(nodes)))}]
    return model


def load(folder, model):
    file = model_file(folder, "a.gltf", model.gltf())
    return load_gltf(file, file.read())


@pytest.fixture
def small(monkeypatch):
    """Share from 100 triangles on."""
    monkeypatch.setattr(limits, "SHARED_FACES", 100)
    monkeypatch.setattr(limits, "SAVED_FACES", 100)


def drawn(mesh):
    """What each face is: corners, normals, texture coordinates, flags and the names of its group."""
    return [
        (
            mesh.positions[face].tobytes(),
            mesh.normals[face].tobytes(),
            mesh.uvs[face].tobytes(),
            int(flags),
            mesh.groups[group].names,
        )
        for face, flags, group in zip(mesh.faces, mesh.face_flags, mesh.face_group, strict=True)
    ]


def test_as_much_is_shared_as_the_renderer_shares():
    assert (limits.SHARED_FACES, limits.SAVED_FACES) == (parts._SHARED_TRIANGLES, parts._SAVED_TRIANGLES)


def test_small_meshes_are_baked(tmp_path):
    assert load(tmp_path, crowd(np.random.default_rng(1))).uses == ()


def test_flattened_is_what_is_drawn_without_uses(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    model = crowd(rng)
    baked = load(tmp_path, model)
    monkeypatch.setattr(limits, "SHARED_FACES", 100)
    monkeypatch.setattr(limits, "SAVED_FACES", 4 * 320)
    shared = load(tmp_path, model)
    assert len(shared.uses) == 5
    assert len(shared.faces) == 320 + 160
    assert len({(use.vertices, use.faces) for use in shared.uses}) == 1
    assert shared.groups == baked.groups
    assert sorted(drawn(flattened(shared))) == sorted(drawn(baked))
    monkeypatch.setattr(limits, "SAVED_FACES", 4 * 320 + 1)
    assert load(tmp_path, model).uses == ()


def test_without_others_even_the_order_is_the_same(tmp_path, small, monkeypatch):
    model = crowd(np.random.default_rng(2), extra=False)
    shared = flattened(load(tmp_path, model))
    monkeypatch.setattr(limits, "SAVED_FACES", 10**9)
    baked = load(tmp_path, model)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(shared, name), getattr(baked, name))
        assert getattr(shared, name).dtype == getattr(baked, name).dtype


def test_uses_share_their_arrays(tmp_path, small):
    own, *uses = separate(load(tmp_path, crowd(np.random.default_rng(3))))
    assert own[1] is None
    assert len(own[0].faces) == 160
    assert len(uses) == 5
    assert {id(part.positions) for part, _ in uses} == {id(uses[0][0].positions)}
    assert [part.groups[0].names for part, _ in uses] == [(f"use{k}", "ball", "upper") for k in range(5)]
    assert all(part.face_group.max() == 1 and part.faces.max() == len(part.positions) - 1 for part, _ in uses)


def test_a_model_of_uses_alone_has_no_part_of_its_own(tmp_path, small):
    assert [rows is None for _, rows in separate(load(tmp_path, crowd(np.random.default_rng(3), extra=False)))] == [
        False
    ] * 5


def test_uses_come_out_of_the_guarded_process(tmp_path, small):
    mesh = load(tmp_path, crowd(np.random.default_rng(4)))
    save_mesh(tmp_path / "mesh.arrays", mesh)
    assert open_mesh(tmp_path / "mesh.arrays").uses == mesh.uses


def test_faces_that_are_left_out_move_the_ranges(tmp_path, small):
    """The first mesh loses faces with two corners at one place, and so does the one that is stored."""
    model = crowd(np.random.default_rng(5))
    faces = np.array([[0, 1, 2], [0, 0, 1], [1, 2, 3], [3, 3, 3]], np.uint32)
    corners = model.add(faces.ravel())
    more = {**model.tree["meshes"][1]["primitives"][0], "indices": corners}
    model.tree["meshes"][1] = {"name": "alone", "primitives": [more]}
    model.tree["meshes"][0]["primitives"].append(more)
    mesh = load(tmp_path, model)
    assert mesh.uses[0].faces == (2, 2 + 320 + 2)
    assert len(flattened(mesh).faces) == 2 + 5 * 322


def test_flat_mirrored_and_distant_uses_are_baked_where_they_must_be(tmp_path, small):
    """A use that is squeezed flat has no way back, and one at 1e30 leaves the range: both as without sharing."""
    model = crowd(np.random.default_rng(6), extra=False)
    model.tree["nodes"][2] = {"name": "flat", "mesh": 0, "scale": [1, 0, 1]}
    model.tree["nodes"][4] = {"name": "needle", "mesh": 0, "scale": [1, 1e-9, 1]}
    mesh = load(tmp_path, model)
    assert len(mesh.uses) == 3
    assert mesh.uses[0].faces[0] > 160
    assert may_place(np.diag([1e20, -1e20, 1e20, 1.0]), 3.0)
    assert not may_place(np.diag([9e29, 9e29, 9e29, 1.0]), 3.0)
    assert not may_place(np.diag([1.0, 0.0, 1.0, 1.0]), 3.0)
    assert not may_place(np.eye(4), np.nan)


def test_uses_of_a_file_are_placed(tmp_path, small, monkeypatch):
    """One tree and one picture, shared and baked, whatever normals are asked for; smooth ones bake."""
    model = crowd(np.random.default_rng(7))
    loaded = {"shared": load(tmp_path, model)}
    monkeypatch.setattr(limits, "SAVED_FACES", 10**9)
    loaded["baked"] = load(tmp_path, model)
    monkeypatch.setattr(parts, "_SHARED_TRIANGLES", 100)
    monkeypatch.setattr(parts, "_SAVED_TRIANGLES", 100)
    for normals, n_placements in (("file", 6), ("flat", 6), ("smooth", 1)):
        scene = document(
            {
                "type": "mesh_asset",
                "asset": "balls",
                "normals": normals,
                "materials": {"use1": "red", "lower": "mirror"},
                "transform": [{"type": "rotate", "axis": [1, 0, 0], "angle_deg": 20}],
            },
            camera={"type": "perspective", "fov_deg": 40, "look_at": {"eye": [4, 3, 14], "target": [4, 2, 0]}},
            image={"width": 96, "height": 64},
            sampling={"samples": 4, "seed": 1},
            lights=[{"type": "point", "position": [4, 9, 9], "diffuse": [0.8, 0.8, 0.8]}],
            materials={"red": {"kd": [0.8, 0.2, 0.2]}, "mirror": {"kd": [0.1, 0.2, 0.3], "kr": [0.5, 0.5, 0.5]}},
            assets={"balls": {"file": "balls.gltf", "sha256": "ab" * 32}},
        )
        films = []
        for name, data in loaded.items():
            files = SceneFiles()
            monkeypatch.setattr(files, "load", lambda *_: None)
            files._meshes["balls"] = data
            compiled, stats = compile_scene(scene, lambda ref: tmp_path / ref.file, files)
            assert stats.n_placements == (n_placements if name == "shared" else 1)
            assert stats.n_triangles == 5 * 320 + 160
            films.append(render_compiled(compiled))
        one, other = films
        assert one.counters["reflection_rays"] > 400
        assert one.counters["reflection_rays"] == other.counters["reflection_rays"]
        assert np.abs(one.pixels - other.pixels).max() < 1e-6  # float32
