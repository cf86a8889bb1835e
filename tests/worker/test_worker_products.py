"""Plan, tiles and results: created once, moved in whole."""

from pathlib import Path

import pytest
from worker_farm import make_scene

from tracer.scene import canonical_json
from worker import jobs
from worker.errors import (
    BadNameError,
    JobNotFoundError,
)
from worker.records import new_job_id
from worker.store import Store


@pytest.fixture
def job_id(store: Store) -> str:
    scene = make_scene()
    record = jobs.make_record(scene, canonical_json(scene), owner="me", job_id=new_job_id())
    assert store.create_job(record, b"{}")
    return record.id


@pytest.mark.parametrize("name", ["job.json", "../result.png", "result.jpg", ""])
def test_results_have_four_names(store: Store, job_id: str, name: str):
    with pytest.raises(BadNameError):
        store.result_path(job_id, name)


def test_tiles_are_written_once(store: Store, job_id: str):
    assert store.write_tile(job_id, 3, b"three")
    assert not store.write_tile(job_id, 3, b"other")
    assert store.write_tile(job_id, 11, b"eleven")
    assert store.read_tile(job_id, 3) == b"three"
    assert store.done_tiles(job_id) == [3, 11]
    store.delete_tiles(job_id)
    assert store.done_tiles(job_id) == []
    with pytest.raises(JobNotFoundError):
        store.write_tile(job_id, 4, b"too late")
    assert not list(store.temporary.iterdir())


def test_plan_is_written_once_and_a_damaged_one_is_none(store: Store, job_id: str):
    assert store.read_plan(job_id) is None
    assert store.write_plan(job_id, {"seed": 1})
    assert not store.write_plan(job_id, {"seed": 2})
    assert store.read_plan(job_id) == {"seed": 1}
    (store.job_dir(job_id) / "plan.json").write_bytes(b"")
    assert store.read_plan(job_id) is None


def test_results_are_moved_in(store: Store, job_id: str, tmp_path: Path):
    (tmp_path / "x").write_bytes(b"png")
    store.commit_result(job_id, {"result.png": tmp_path / "x"})
    assert store.has_result(job_id, "result.png")
    assert not store.has_result(job_id, "result.exr")
    assert store.result_path(job_id, "result.png").read_bytes() == b"png"
