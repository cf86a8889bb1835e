"""What names compiled code, and how long it is kept."""

import os
import shutil
import time
from pathlib import Path

import pytest

from tracer.native import key
from tracer.paths import cache_root

ROOT = Path(__file__).parents[3]


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A copy of the tracer, which the key is taken of."""
    copy = tmp_path / "tracer"
    shutil.copytree(ROOT / "tracer", copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(key, "__file__", str(copy / "native" / "key.py"))
    return copy


def change(path):
    with path.open("a") as source:
        source.write("\n# changed\n")


def test_key_follows_the_sources_of_kernels(sources):
    before = key.kernel_key()
    assert before == key.kernel_key()
    for name in ("film/writer.py", "native/build.py", "native/key.py", "render/frame.py"):
        change(sources / name)
    assert key.kernel_key() == before
    for name in ("geometry/shapes.py", "render/blocks.py", "types.py", "jit.py"):
        change(sources / name)
        after = key.kernel_key()
        assert after != before
        before = after


def test_key_does_not_follow_the_place(sources, monkeypatch):
    here = key.kernel_key()
    monkeypatch.undo()
    assert key.kernel_key() == here


@pytest.mark.parametrize(("name", "value"), [("NUMBA_CPU_NAME", "x86-64-v3"), ("NUMBA_CPU_FEATURES", "-avx2")])
def test_key_follows_the_processor(monkeypatch, name, value):
    before = key.kernel_key()
    monkeypatch.setenv(name, value)
    assert key.kernel_key() != before


def test_image_follows_what_makes_it(sources, monkeypatch):
    monkeypatch.setattr(key, "kernel_folder", lambda: sources)
    path = key.image_path.__wrapped__
    before = path()
    assert before == path()
    change(sources / "native" / "link.py")
    assert path() != before


def test_caches_are_where_the_environment_says(tmp_path, monkeypatch):
    monkeypatch.setenv("SMALTI_CACHE", str(tmp_path / "own"))
    assert key.kernel_folder.__wrapped__() == tmp_path / "own" / "kernels" / key.kernel_key()
    monkeypatch.delenv("SMALTI_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_root() == tmp_path / "smalti"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_root() == tmp_path / "home" / ".cache" / "smalti"


def test_old_kernels_are_let_go(tmp_path):
    now = time.time()
    for name, age in {
        "in-use": 2 * key.KEPT_S,
        "fresh": key.KEPT_S - 3600,
        "old": key.KEPT_S + 3600,
        "older": 9 * key.KEPT_S,
    }.items():
        folder = tmp_path / name
        (folder / "numba").mkdir(parents=True)
        (folder / "numba" / "code.nbc").write_bytes(b"code")
        os.utime(folder, (now - age, now - age))
    assert key.prune_kernels(tmp_path / "in-use") == 2
    assert sorted(folder.name for folder in tmp_path.iterdir()) == ["fresh", "in-use"]
    key.mark_use(tmp_path / "in-use")
    assert key.prune_kernels(tmp_path / "fresh") == 0
    assert key.prune_kernels(tmp_path / "none" / "of it") == 0
