"""The files of a scene: only those that it needs, each once, and their faults with a place."""

import pytest
from compile_scenes import TRIANGLE, compiled, document, fake_build, sha256, vertexdata

from tracer.loaders.errors import LoadError
from tracer.render.compile import compile_scene
from tracer.types import MATERIAL_KD


def _kd(scene, material):
    return scene.materials[material, MATERIAL_KD : MATERIAL_KD + 3].tolist()


def test_bad_files_are_errors_with_a_pointer(tmp_path):
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    with pytest.raises(LoadError) as caught:
        compiled(TRIANGLE, {"type": "mesh_asset", "asset": "m"}, assets={"m": {"file": "bad.obj"}}, folder=tmp_path)
    assert caught.value.pointer == "/objects/1/asset"
    assert str(caught.value).startswith("bad.obj: line 2: a face uses vertex 2")
    materials = {"a/b": {"diffuse_texture": {"asset": "m"}}}
    with pytest.raises(LoadError) as caught:
        compiled(
            {**TRIANGLE, "uvs": [[0, 0]] * 3, "material": "a/b"},
            materials=materials,
            assets={"m": {"file": "bad.obj"}},
            folder=tmp_path,
        )
    assert caught.value.pointer == "/materials/a~1b/diffuse_texture/asset"


def test_what_nothing_refers_to_is_never_opened():
    def refuse(ref):
        raise AssertionError(f"{ref.name} was opened")

    scene = document(
        TRIANGLE,
        materials={"unused": {"diffuse_texture": {"asset": "t"}}},
        assets={"t": {"file": "t.png"}, "m": {"file": "m.obj"}},
    )
    compiled_scene, stats = compile_scene(scene, refuse, build=fake_build)
    assert stats.unused_assets == ("m", "t")
    assert len(compiled_scene.materials) == 1  # the default grey alone


def test_a_file_is_loaded_once(tmp_path):
    row = vertexdata(tmp_path)
    opened = []

    def resolve(ref):
        opened.append(ref)
        return tmp_path / ref.file

    scene = document(*[{"type": "mesh_asset", "asset": "m"}] * 3, assets={"m": row})
    compiled_scene, _ = compile_scene(scene, resolve, build=fake_build)
    assert [ref.name for ref in opened] == ["m"]
    assert opened[0].sha256 == row["sha256"]
    assert len(compiled_scene.face_vertices) == 6


def test_companions_without_a_hash_are_not_opened_beside_a_file_with_one(tmp_path):
    data = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
    (tmp_path / "m.obj").write_bytes(data)
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\n")
    rows = {
        "a": ({"file": "m.obj"}, [1, 0, 0]),
        "b": ({"file": "m.obj", "sha256": sha256(data)}, [0.8, 0.8, 0.8]),
        "c": ({"file": "m.obj", "sha256": sha256(data), "companions": {"m.mtl": None}}, [0.8, 0.8, 0.8]),
        "d": ({"file": "m.obj", "sha256": sha256(data), "companions": {"m.mtl": "0" * 64}}, [1, 0, 0]),
    }
    things = [{"type": "mesh_asset", "asset": name} for name in rows]
    scene, _ = compiled(*things, assets={name: row for name, (row, _) in rows.items()}, folder=tmp_path)
    assert [_kd(scene, material) for material in scene.face_material] == [expected for _, expected in rows.values()]
