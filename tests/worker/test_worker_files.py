"""Write-once files: one winner, whole or absent, with and without renameat2."""

import errno
import multiprocessing
import os
from pathlib import Path

import pytest

from worker import files
from worker.errors import StoreFullError


@pytest.fixture(params=["renameat2", "link"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "link":
        monkeypatch.setattr(files, "_renameat2", None)
    return str(request.param)


def test_first_writer_wins_and_nothing_is_left(tmp_path: Path, way: str):
    (tmp_path / "tmp").mkdir()
    assert files.create(tmp_path / "a", b"one", tmp_path / "tmp")
    assert not files.create(tmp_path / "a", b"two", tmp_path / "tmp")
    assert (tmp_path / "a").read_bytes() == b"one"
    assert not list((tmp_path / "tmp").iterdir())


def test_missing_folder_leaves_no_temporary_file(tmp_path: Path, way: str):
    with pytest.raises(FileNotFoundError):
        files.create(tmp_path / "none" / "a", b"one", tmp_path)
    assert not list(tmp_path.iterdir())


def test_filesystem_without_noreplace_falls_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import ctypes

    def refuse(*_: object) -> int:
        ctypes.set_errno(errno.EINVAL)
        return -1

    monkeypatch.setattr(files, "_renameat2", refuse)
    assert files.create(tmp_path / "a", b"one", tmp_path)
    assert not files.create(tmp_path / "a", b"two", tmp_path)


def _race(
    folder: str, who: int, barrier: "multiprocessing.synchronize.Barrier", results: "multiprocessing.Queue[int]"
) -> None:
    won = 0
    for index in range(150):
        barrier.wait()
        won += files.create(f"{folder}/{index}", b"%d" % who * 2000, folder, durable=False)
    results.put(won)


def test_two_processes_race(tmp_path: Path):
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(2), context.Queue()
    processes = [context.Process(target=_race, args=(str(tmp_path), who, barrier, results)) for who in (1, 2)]
    for process in processes:
        process.start()
    assert results.get(timeout=60) + results.get(timeout=60) == 150
    for process in processes:
        process.join()
    assert {len(set(path.read_bytes())) for path in tmp_path.iterdir()} == {1}
    assert len(list(tmp_path.iterdir())) == 150


def test_full_disk_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StoreFullError, match="no space"):
        files.create(tmp_path / "a", b"one", tmp_path)
    assert not list(tmp_path.iterdir())


def test_folder_is_published_once(tmp_path: Path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "content").write_text(name)
    assert files.publish_folder(tmp_path / "a", tmp_path / "final")
    assert not files.publish_folder(tmp_path / "b", tmp_path / "final")
    assert (tmp_path / "final" / "content").read_text() == "a"
