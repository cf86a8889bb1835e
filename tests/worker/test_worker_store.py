"""The store's contract."""

import concurrent.futures
import dataclasses
import hashlib
import json
import multiprocessing
import os
import time
from pathlib import Path

import pytest
from worker_farm import make_scene

from tracer.scene import canonical_json
from worker import jobs
from worker.errors import (
    BadNameError,
    ConflictError,
    DamagedRecordError,
    IllegalTransitionError,
    JobNotFoundError,
)
from worker.records import JobRecord, new_job_id
from worker.states import JobState
from worker.store import Store


def make_record(**changes: object) -> JobRecord:
    scene = make_scene()
    record = jobs.make_record(scene, canonical_json(scene), owner="me", job_id=new_job_id())
    return dataclasses.replace(record, **changes)


@pytest.fixture
def job_id(store: Store) -> str:
    record = make_record()
    assert store.create_job(record, b"{}")
    return record.id


def test_job_is_created_once_and_whole(store: Store):
    record = make_record()
    assert store.create_job(record, b'{"a":1}')
    assert not store.create_job(dataclasses.replace(record, name="other"), b"{}")
    assert store.read_job(record.id) == record
    assert store.read_scene(record.id) == b'{"a":1}'
    event = store.last_event(record.id)
    assert (event.seq, event.type, event.state, event.previous) == (1, "created", JobState.QUEUED, None)
    assert not list(store.temporary.iterdir())


def test_two_creators_race(tmp_path: Path):
    store = Store(tmp_path)
    for _ in range(20):
        record = make_record()
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            assert sum(pool.map(lambda _, one=record: store.create_job(one, b"{}"), range(4))) == 1
    assert not list(store.temporary.iterdir())


def test_first_event_is_made_again_from_the_record(store: Store, job_id: str):
    path = store.job_dir(job_id) / "events" / "000001.json"
    for damage in (lambda: path.write_bytes(b""), path.unlink):
        damage()
        assert store.last_event(job_id).state is JobState.QUEUED
        assert [event.seq for event in store.events(job_id)] == [1]


def test_event_that_a_power_failure_emptied_is_dropped(store: Store, job_id: str):
    store.transition(job_id, JobState.PREPARING, by="w")
    path = store.job_dir(job_id) / "events" / "000002.json"
    path.write_bytes(b"")
    with pytest.raises(DamagedRecordError):  # just written: that would be something else
        store.last_event(job_id)
    os.utime(path, (time.time() - 60, time.time() - 60))
    assert store.last_event(job_id).state is JobState.QUEUED
    assert store.transition(job_id, JobState.PREPARING, by="w").seq == 2


@pytest.mark.parametrize("name", ["", "..", "../x", "a/../../b", "X" * 26])
def test_no_path_comes_from_a_bad_name(store: Store, name: str):
    for call in (
        store.read_job,
        store.last_event,
        store.done_tiles,
        store.delete_job,
        store.has_asset,
        store.asset_path,
    ):
        with pytest.raises(BadNameError):
            call(name)
    with pytest.raises(BadNameError):
        store.put_idempotency(name, "key", "hash", new_job_id())


def test_unknown_job(store: Store):
    for call in (store.read_job, store.read_scene, store.last_event, store.events, store.read_plan, store.delete_job):
        with pytest.raises(JobNotFoundError):
            call(new_job_id())
    with pytest.raises(JobNotFoundError):
        store.transition(new_job_id(), JobState.PREPARING, by="w")


def test_transition_follows_the_table(store: Store, job_id: str):
    for state in (JobState.PREPARING, JobState.RENDERING, JobState.ASSEMBLING, JobState.SUCCEEDED):
        event = store.transition(job_id, state, by="w")
        assert store.last_event(job_id) == event
    with pytest.raises(IllegalTransitionError) as caught:
        store.transition(job_id, JobState.CANCELING, by="api")
    assert (caught.value.current, caught.value.allowed) == (JobState.SUCCEEDED, ())
    assert [event.seq for event in store.events(job_id)] == [1, 2, 3, 4, 5]
    assert [event.seq for event in store.events(job_id, after=3)] == [4, 5]
    assert store.note(job_id, "note", by="w", detail={}) is None


def test_event_number_is_taken_once(store: Store, job_id: str):
    first = store.last_event(job_id)
    store.append_event(job_id, "note", JobState.QUEUED, first, by="a")
    with pytest.raises(ConflictError):
        store.append_event(job_id, "note", JobState.QUEUED, first, by="b")


def _append(root: str, job_id: str, count: int) -> None:
    store = Store(Path(root))
    for index in range(count):
        assert store.note(job_id, "note", by=str(os.getpid()), detail={"index": index})


def test_two_processes_append_without_loss(store: Store, job_id: str):
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_append, args=(str(store.root), job_id, 60)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    events = store.events(job_id)
    assert [event.seq for event in events] == list(range(1, 122))
    for by in {event.by for event in events[1:]}:
        assert [event.detail["index"] for event in events[1:] if event.by == by] == list(range(60))


def test_transition_looks_again_when_somebody_was_faster(store: Store, job_id: str, monkeypatch: pytest.MonkeyPatch):
    stale = store.last_event(job_id)
    store.note(job_id, "note", by="faster", detail={})
    real = store.last_event
    answers = iter([stale])
    monkeypatch.setattr(store, "last_event", lambda one: next(answers, None) or real(one))
    assert store.transition(job_id, JobState.PREPARING, by="slower").seq == 3


def test_only_one_of_many_transitions_wins(store: Store, job_id: str):
    def attempt(_: int) -> bool:
        try:
            store.transition(job_id, JobState.PREPARING, by="w")
        except IllegalTransitionError:
            return False
        return True

    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(attempt, range(8))) == 1


def test_listing_is_newest_first_and_paged(store: Store):
    ids = []
    for _ in range(5):
        record = make_record()
        store.create_job(record, b"{}")
        ids.append(record.id)
    (store.root / "jobs" / "stray").mkdir()
    assert list(store.job_ids()) == ids[::-1]
    assert list(store.job_ids(before=ids[2])) == ids[1::-1]


def test_deleted_job_is_gone_with_its_key(store: Store):
    record = make_record(idempotency_key_sha256=hashlib.sha256(b"key").hexdigest())
    assert store.put_idempotency("me", "key", "hash", record.id) == ("hash", record.id)
    store.create_job(record, b"{}")
    store.transition(record.id, JobState.FAILED, by="w")
    store.last_event(record.id)  # remembered
    store.delete_job(record.id)
    with pytest.raises(JobNotFoundError):
        store.last_event(record.id)
    other = new_job_id()
    assert store.put_idempotency("me", "key", "other", other) == ("other", other)
    assert not list(store.temporary.iterdir())


@pytest.mark.parametrize("record", [None, "["])
def test_deleting_a_job_leaves_the_key_of_a_newer_one(store: Store, record: str | None):
    """A key is swept after a day and may belong to another job by the time that the first one is deleted."""
    old = make_record(idempotency_key_sha256=hashlib.sha256(b"key").hexdigest())
    store.put_idempotency("me", "key", "hash", old.id)
    store.create_job(old, b"{}")
    store.transition(old.id, JobState.FAILED, by="w")
    store.sweep(60.0, idempotency_s=-1.0)
    newer = new_job_id()
    store.put_idempotency("me", "key", "hash", newer)
    path = store.root / "idempotency" / "me" / hashlib.sha256(b"key").hexdigest()
    if record is not None:
        path.write_text(record)
    store.delete_job(old.id)
    assert path.exists() is (record is None)  # a damaged record is of no use to anybody
    if record is None:
        assert store.put_idempotency("me", "key", "hash", new_job_id()) == ("hash", newer)


def test_sweep_takes_the_old_only(store: Store):
    old, new, abandoned = store.temporary / "old", store.temporary / "new", store.assembly_folder(new_job_id())
    for folder in (old, new):
        folder.mkdir()
    store.put_idempotency("me", "key", "hash", new_job_id())
    for path in (old, abandoned):
        os.utime(path, (0, 0))
    assert store.sweep(60.0) == 2
    assert list(store.temporary.iterdir()) == [new]
    assert store.sweep(60.0, idempotency_s=-1.0) == 1


def test_checkpoint(store: Store):
    assert store.read_checkpoint() == set()
    store.write_checkpoint({"b", "a"})
    assert Store(store.root).read_checkpoint() == {"a", "b"}
    (store.root / "steward" / "terminal.json").write_text("[")
    assert store.read_checkpoint() == set()


def test_record_is_small_and_readable(store: Store, job_id: str):
    fields = json.loads((store.job_dir(job_id) / "job.json").read_bytes())
    assert "scene" not in fields
    assert fields["output"] == {"png_color_space": "srgb", "tile_size": 64}
