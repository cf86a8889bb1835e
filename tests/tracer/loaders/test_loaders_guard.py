"""The guarded process: whatever happens in it, the caller gets arrays or a `LoadError`, in bounded time."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from loader_files import Gltf, data_folder, model_file, png_bytes

from tracer.loaders import guard
from tracer.loaders.errors import LoadError
from tracer.loaders.guard import LoadRequest, load_guarded, load_image_guarded, load_mesh_guarded
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.mesh import MeshData
from tracer.loaders.obj import load_obj

_OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\ng Door\nusemtl m\nf 1/1/1 2/1/1 3/1/1\n"


def test_the_result_is_that_of_the_loader(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\nmap_Kd t.png\nmap_Kd gone.png\n")
    (tmp_path / "t.png").write_bytes(png_bytes())
    file = model_file(tmp_path, "a.obj", _OBJ)
    here = load_obj(file, file.read())
    there = load_mesh_guarded(tmp_path / "a.obj")
    for name, one, other in zip(MeshData._fields, here, there, strict=True):
        if name == "images":
            assert [image.tolist() for image in one] == [image.tolist() for image in other]
        elif isinstance(one, np.ndarray):
            assert np.array_equal(one, other), name
            assert one.dtype == other.dtype
            assert other.flags.c_contiguous
            assert other.flags.writeable
        else:
            assert one == other, name


def test_a_batch_keeps_its_order_and_one_bad_file_spoils_no_other(tmp_path):
    (tmp_path / "a.obj").write_text(_OBJ)
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    (tmp_path / "t.png").write_bytes(png_bytes())
    requests = [
        LoadRequest("mesh", tmp_path / "a.obj", "first.obj"),
        LoadRequest("mesh", tmp_path / "bad.obj", "second.obj"),
        LoadRequest("image", tmp_path / "t.png", "third.png"),
        LoadRequest("image", tmp_path / "bad.obj", "fourth.png"),
        LoadRequest("mesh", tmp_path / "gone.stl", "fifth.stl"),
    ]
    first, second, third, fourth, fifth = load_guarded(requests)
    assert isinstance(first, MeshData)
    assert str(second).startswith("second.obj: line 2: a face uses vertex 2")
    assert third.tolist() == [[[255, 0, 0], [255, 0, 0]]]
    assert str(fourth).startswith("fourth.png: is not an image")
    assert str(fifth) == "fifth.stl: cannot be read (No such file or directory); put it there, or name another file"
    assert str(tmp_path) not in f"{second}{fourth}{fifth}"  # no path of this machine


def _stand_in(monkeypatch, tmp_path, body):
    """Put other code in the place of the OBJ loader, inside the guarded process alone."""
    package = tmp_path / "stand_in"
    package.mkdir()
    (package / "sitecustomize.py").write_text(
        "import sys, types\n"
        "module = types.ModuleType('tracer.loaders.obj')\n"
        f"exec({body!r}, module.__dict__)\n"
        "sys.modules['tracer.loaders.obj'] = module\n"
    )
    monkeypatch.setattr(guard, "_PACKAGE_ROOT", f"{package}{os.pathsep}{guard._PACKAGE_ROOT}")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("def load_obj(f, d): import os; os._exit(3)", "ended the loader (exit code 3)"),
        ("def load_obj(f, d): import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended the loader (SIGSEGV)"),
        ("def load_obj(f, d): return bytearray(7 << 30)", "takes more than 6144 MiB of memory"),
        ("def load_obj(f, d): raise RecursionError('deep')", "cannot be read as .obj (RecursionError: deep)"),
        ("def load_obj(f, d): import socket; socket.create_connection(('127.0.0.1', 9))", "PermissionError"),
        ("def load_obj(f, d): import subprocess; subprocess.run(['true'])", "PermissionError"),
        ("def load_obj(f, d): import os; os.system('true')", "PermissionError"),
        ("def load_obj(f, d): open('/etc/hostname')", "opens no file outside the model's folder"),
        ("def load_obj(f, d): open('/etc/../etc/passwd')", "opens no file outside the model's folder"),
        ("def load_obj(f, d): open('/proc/self/root/etc/hostname')", "opens no file outside the model's folder"),
        ("def load_obj(f, d): open('/proc/self/environ')", "opens no file outside the model's folder"),
        ("def load_obj(f, d): print('{\"index\": 0}', flush=True); import os; os._exit(0)", "was lost on its way"),
    ],
)
def test_whatever_a_loader_does(monkeypatch, tmp_path, body, reason):
    _stand_in(monkeypatch, tmp_path, body)
    (tmp_path / "a.obj").write_text(_OBJ)
    with pytest.raises(LoadError) as caught:
        load_mesh_guarded(tmp_path / "a.obj", "their.obj")
    assert caught.value.file == "their.obj"
    assert reason in caught.value.reason


def test_a_loader_that_spins_is_stopped_by_cpu_time(monkeypatch, tmp_path):
    _stand_in(monkeypatch, tmp_path, "def load_obj(f, d):\n    while True: pass")
    (tmp_path / "a.obj").write_text(_OBJ)
    (tmp_path / "b.obj").write_text(_OBJ)
    begin = time.monotonic()
    requests = [LoadRequest("mesh", tmp_path / name, name) for name in ("a.obj", "b.obj")]
    first, second = load_guarded(requests, DEFAULT_LIMITS._replace(cpu_s=1))
    assert time.monotonic() - begin < 15
    assert first.reason == "took longer than 1 s of CPU time to load"
    assert "a file before it" in second.reason


def test_a_loader_that_sleeps_is_stopped_by_wall_time(monkeypatch, tmp_path):
    _stand_in(monkeypatch, tmp_path, "def load_obj(f, d):\n    import time\n    time.sleep(60)")
    (tmp_path / "a.obj").write_text(_OBJ)
    begin = time.monotonic()
    with pytest.raises(LoadError, match=r"took longer than 1\.5 s to load"):
        load_mesh_guarded(tmp_path / "a.obj", limits=DEFAULT_LIMITS._replace(wall_s=1.5))
    assert time.monotonic() - begin < 10


def test_links_in_the_folder_are_its_owners(tmp_path):
    """A worker gathers a model's files as links into its store."""
    store = tmp_path / "store"
    store.mkdir()
    (store / "1").write_text(_OBJ)
    (store / "2").write_text("newmtl m\nKd 0 1 0\nmap_Kd sub/t.png\n")
    (store / "3").write_bytes(png_bytes())
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    for number, name in (("1", "a.obj"), ("2", "a.mtl"), ("3", "sub/t.png")):
        (folder / name).symlink_to(store / number)
    mesh = load_mesh_guarded(folder / "a.obj", companions=["a.mtl", "sub/t.png"])
    assert mesh.materials[0].kd == (0, 1, 0)
    assert len(mesh.images) == 1


def test_trimesh_works_behind_the_closed_doors(tmp_path):
    (tmp_path / "a.glb").write_bytes(Gltf().with_triangle().glb())
    assert len(load_mesh_guarded(tmp_path / "a.glb").faces) == 1


def test_small_vertexdata_needs_no_process(monkeypatch, tmp_path):
    def refuse(*_):
        raise AssertionError("a process was started")

    monkeypatch.setattr(guard, "_run", refuse)
    vertices = [0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0]
    (tmp_path / "a.json").write_text(json.dumps({"vertexdata": vertices, "indexdata": [0, 1, 2]}))
    assert len(load_mesh_guarded(tmp_path / "a.json").faces) == 1
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(LoadError, match="not JSON"):
        load_mesh_guarded(tmp_path / "a.json")
    monkeypatch.setattr(guard, "IN_PROCESS_JSON_BYTES", 0)
    with pytest.raises(AssertionError, match="a process was started"):
        load_mesh_guarded(tmp_path / "a.json")


def test_images(tmp_path):
    (tmp_path / "t.png").write_bytes(png_bytes(5, 4, (1, 2, 3)))
    image = load_image_guarded(tmp_path / "t.png")
    assert image.shape == (4, 5, 3)
    assert image[3, 4].tolist() == [1, 2, 3]
    with pytest.raises(LoadError, match=r"t2\.png: cannot be read"):
        load_image_guarded(tmp_path / "t2.png")


def test_nothing_heavy_is_imported_by_the_caller():
    code = "import sys, tracer.loaders.guard; print(sorted({'trimesh', 'PIL', 'numba', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_the_service_s_big_models():
    folder = data_folder("models/dragon")
    begin = time.monotonic()
    mesh = load_mesh_guarded(folder / "dragon_vrip.ply")
    assert len(mesh.faces) == 871_414 - 108  # so many are collapsed to an edge
    assert time.monotonic() - begin < 60
