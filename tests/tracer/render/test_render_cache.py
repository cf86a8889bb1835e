"""The cache of compiled scenes: one build for many processes, never stale, never damaged, and fast."""

import multiprocessing
import os
import time

import numpy as np
import pytest
from compile_scenes import TRIANGLE, document, fake_build, vertexdata

from tracer.render import cache
from tracer.render.cache import compile_cached, trim_cache


class _Backend:
    name = "cpu"
    arithmetic = "f64-v1"


@pytest.fixture(autouse=True)
def _no_hierarchy(monkeypatch):
    monkeypatch.setattr(cache, "build_tree", fake_build)


def _scene(tmp_path, **more):
    row = vertexdata(tmp_path)
    return document({"type": "mesh_asset", "asset": "m"}, assets={"m": row}, **more)


def _refuse(ref):
    raise AssertionError(f"{ref.name} was opened")


def test_the_second_time_nothing_is_opened_and_all_is_equal(tmp_path):
    scene = _scene(tmp_path)
    first, built = compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    second, found = compile_cached(scene, _refuse, tmp_path / "cache", _Backend())
    assert not built.from_cache
    assert found == built._replace(from_cache=True)
    for name, one, other in zip(first._fields, first, second, strict=True):
        assert np.array_equal(one, other), name
        for array in (one, other):
            assert type(array) is np.ndarray
            assert array.flags.c_contiguous
            assert array.flags.writeable
            assert array.flags.aligned


def test_another_camera_opens_no_file(tmp_path):
    compile_cached(_scene(tmp_path), lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    _, stats = compile_cached(_scene(tmp_path, background=1.0), _refuse, tmp_path / "cache", _Backend())
    assert not stats.from_cache
    assert stats.n_triangles == 2


def test_large_trees_are_kept_by_their_geometry(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_MIN_CACHED_BVH_TRIANGLES", 1)
    builds = []

    def count(*geometry):
        builds.append(1)
        return fake_build(*geometry)

    monkeypatch.setattr(cache, "build_tree", count)

    def run(**more):
        return compile_cached(_scene(tmp_path, **more), lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())

    run()
    run(background=1.0)
    assert len(builds) == 1
    (tmp_path / "bvh-damaged").touch()
    for path in (tmp_path / "cache" / "bvh").iterdir():
        path.write_bytes(b"damaged")
    run(background=2.0)
    assert len(builds) == 2
    scene = document(
        {"type": "mesh_asset", "asset": "m", "transform": [{"type": "scale", "by": 2}]},
        assets={"m": vertexdata(tmp_path)},
    )
    compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    assert len(builds) == 3


def test_what_decides_the_bytes_is_in_the_key(tmp_path, monkeypatch):
    def entries():
        return len(list((tmp_path / "cache" / "scenes").iterdir()))

    def run(scene, backend):
        compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", backend)

    run(_scene(tmp_path), _Backend())
    run(_scene(tmp_path), _Backend())
    assert entries() == 1
    run(_scene(tmp_path, background=0.5), _Backend())
    assert entries() == 2
    other = _Backend()
    other.arithmetic = "f32-v1"
    run(_scene(tmp_path), other)
    assert entries() == 3
    monkeypatch.setattr(cache, "builder_version", lambda: "another")
    run(_scene(tmp_path), _Backend())
    assert entries() == 4


def test_without_hashes_nothing_is_cached(tmp_path):
    vertexdata(tmp_path)
    scene = document({"type": "mesh_asset", "asset": "m"}, assets={"m": {"file": "m.json"}})
    for _ in range(2):
        _, stats = compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
        assert not stats.from_cache
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "other layout"])
def test_damaged_entries_are_built_again(tmp_path, damage):
    scene = _scene(tmp_path)
    mapped, _ = compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    first = [array.copy() for array in mapped]  # what is mapped would change, or go away, with the file
    del mapped
    (path,) = (tmp_path / "cache" / "scenes").iterdir()
    data = path.read_bytes()
    if damage == "cut":
        path.write_bytes(data[:-64])
    elif damage == "changed":
        place = data.index(np.array([1.0, 1.0, 0.0]).tobytes())
        path.write_bytes(data[:place] + b"\xff" + data[place + 1 :])
    elif damage == "empty":
        path.write_bytes(b"")
    else:
        from tracer.arrayfile import load_arrays, save_arrays

        arrays, meta = load_arrays(path)
        arrays["camera"] = arrays["camera"][:-1]
        save_arrays(path, arrays, meta, durable=False)
    second, stats = compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    assert not stats.from_cache
    assert all(np.array_equal(one, other) for one, other in zip(first, second, strict=True))
    assert compile_cached(scene, _refuse, tmp_path / "cache", _Backend())[1].from_cache


def test_a_cache_that_cannot_be_written_is_no_failure(tmp_path):
    scene = _scene(tmp_path)
    for name in ("scenes", "files", "bvh", "locks"):
        (tmp_path / "cache" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "cache" / name).write_text("a file where a folder should be")
    compiled, stats = compile_cached(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache", _Backend())
    assert len(compiled.face_vertices) == 2
    assert not stats.from_cache


def _race(folder, start, results):
    cache.build_tree = _slow_build
    start.wait()
    _, stats = compile_cached(_scene_of(folder), lambda ref: folder / ref.file, folder / "cache", _Backend())
    results.put((os.getpid(), stats.from_cache))


def _slow_build(*geometry):
    time.sleep(0.3)
    return fake_build(*geometry)


def _scene_of(folder):
    from compile_scenes import sha256

    row = {"file": "m.json", "sha256": sha256((folder / "m.json").read_bytes())}
    return document({"type": "mesh_asset", "asset": "m"}, assets={"m": row})


def test_several_processes_build_once(tmp_path):
    vertexdata(tmp_path)
    context = multiprocessing.get_context("fork")
    start, results = context.Event(), context.Queue()
    processes = [context.Process(target=_race, args=(tmp_path, start, results)) for _ in range(4)]
    for process in processes:
        process.start()
    start.set()
    outcomes = [results.get(timeout=60) for _ in processes]
    for process in processes:
        process.join()
    assert sorted(from_cache for _, from_cache in outcomes) == [False, True, True, True]
    assert len(list((tmp_path / "cache" / "scenes").iterdir())) == 1  # and no temporary file is left


def test_trimming_lets_the_oldest_go(tmp_path):
    paths = []
    for index in range(3):
        folder = tmp_path / "cache" / "scenes"
        folder.mkdir(parents=True, exist_ok=True)
        paths.append(folder / f"{index}.arrays")
        paths[-1].write_bytes(bytes(100))
        os.utime(paths[-1], ns=(index, index))
    assert trim_cache(tmp_path / "cache", 1000) == 0
    assert trim_cache(tmp_path / "cache", 250) == 100
    assert [path.exists() for path in paths] == [False, True, True]
    assert trim_cache(tmp_path / "cache", 0) == 200


def test_trimming_removes_what_dead_processes_began(tmp_path):
    folder = tmp_path / "cache" / "bvh"
    folder.mkdir(parents=True)
    old, new = folder / ".a.arrays.x.part", folder / ".b.arrays.y.part"
    for path in (old, new):
        path.write_bytes(bytes(100))
    hours_ago = time.time() - 2 * 3600
    os.utime(old, (hours_ago, hours_ago))
    (folder / "kept.arrays").write_bytes(bytes(100))
    assert trim_cache(tmp_path / "cache", 100) == 100
    assert [path.name for path in sorted(folder.iterdir())] == [new.name, "kept.arrays"]


def test_a_warm_small_scene_takes_a_millisecond_or_two(tmp_path):
    scene = document(TRIANGLE)
    times = []
    for _ in range(30):
        begin = time.perf_counter()
        compile_cached(scene, _refuse, tmp_path / "cache", _Backend())
        times.append(time.perf_counter() - begin)
    assert sorted(times)[5] < 0.005  # 0.6 ms on an idle machine
