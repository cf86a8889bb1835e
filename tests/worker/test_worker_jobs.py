"""Submit, view, cancel, delete; with the queue there and with the queue away."""

import json
import os

import pytest
from worker_farm import SmallFarm, make_scene

from worker import jobs, tasks
from worker.errors import (
    IdempotencyConflictError,
    IllegalTransitionError,
    JobActiveError,
    JobNotFoundError,
    StoreFullError,
)
from worker.queue import Queue, unix_url
from worker.records import new_job_id
from worker.states import JobState


@pytest.fixture
def away(tmp_path) -> Queue:
    return Queue(unix_url(tmp_path / "none"))


def test_submitted_job_is_on_disk_and_hinted(farm: SmallFarm):
    scene = make_scene("fake", 100, 50, image={"crop": {"x": 10, "y": 20, "width": 30, "height": 25}})
    submission = jobs.submit(farm.store, farm.queue, scene, owner="me", name="n", output={"tile_size": 32}, priority=80)
    record = farm.store.read_job(submission.job_id)
    assert (record.x, record.y, record.crop_width, record.crop_height, record.n_tiles) == (10, 20, 30, 25, 4)
    assert record.output == {"png_color_space": "srgb", "tile_size": 32}
    assert json.loads(farm.store.read_scene(record.id))["image"]["width"] == 100
    assert farm.queue.hints() == {("worker.tasks.prepare", record.id)}


def test_same_key_same_job(farm: SmallFarm):
    def submit(request: str) -> jobs.Submission:
        return jobs.submit(
            farm.store, farm.queue, make_scene(), owner="me", idempotency_key="k", request_sha256=request
        )

    first = submit("a")
    assert not first.replayed
    assert submit("a") == jobs.Submission(first.job_id, replayed=True)
    with pytest.raises(IdempotencyConflictError):
        submit("b")
    assert list(farm.store.job_ids()) == [first.job_id]


def ended_with_key(farm: SmallFarm) -> str:
    job_id = jobs.submit(
        farm.store, farm.queue, make_scene(), owner="me", idempotency_key="k", request_sha256="a"
    ).job_id
    jobs.cancel(farm.store, farm.queue, job_id)
    return job_id


def submit_again(farm: SmallFarm) -> jobs.Submission:
    return jobs.submit(farm.store, farm.queue, make_scene(), owner="me", idempotency_key="k", request_sha256="a")


def test_a_key_is_spent_for_a_day_from_its_first_request(farm: SmallFarm):
    job_id = ended_with_key(farm)
    (path,) = (farm.store.root / "idempotency" / "me").iterdir()
    os.utime(path, (1_000_000, 1_000_000))
    jobs.delete(farm.store, farm.queue, job_id)
    with pytest.raises(jobs.KeySpentError):
        submit_again(farm)
    assert path.stat().st_mtime == 1_000_000
    farm.store.sweep(60.0)
    assert not submit_again(farm).replayed


def test_a_key_is_spent_before_its_job_is_gone(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    """Whoever looks in between, or a crash there, must not bring about a second job."""
    job_id = ended_with_key(farm)
    put, has = farm.store.put_idempotency, farm.store.has_job

    def delete_meanwhile(*arguments: str) -> tuple[str, str]:
        found = put(*arguments)
        if has(job_id):
            jobs.delete(farm.store, farm.queue, job_id)
        return found

    monkeypatch.setattr(farm.store, "put_idempotency", delete_meanwhile)
    with pytest.raises(jobs.KeySpentError):
        submit_again(farm)
    assert list(farm.store.job_ids()) == []


def test_a_full_store_still_deletes(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    job_id = ended_with_key(farm)

    def full(*_: object, **__: object) -> None:
        raise StoreFullError

    monkeypatch.setattr("worker.files.replace", full)
    jobs.delete(farm.store, farm.queue, job_id)
    assert list(farm.store.job_ids()) == []


def test_death_between_key_and_job_is_mended_by_the_retry(farm: SmallFarm):
    lost = new_job_id()
    farm.store.put_idempotency("me", "k", "a", lost)
    retried = jobs.submit(farm.store, farm.queue, make_scene(), owner="me", idempotency_key="k", request_sha256="a")
    assert retried == jobs.Submission(lost, replayed=False)


def test_job_is_accepted_while_the_queue_is_away(farm: SmallFarm, away: Queue):
    job_id = jobs.submit(farm.store, away, make_scene(), owner="me").job_id
    view = jobs.view(farm.store, away, job_id)
    assert (view.state, view.progress.tiles_done, view.progress.tiles_total) == (JobState.QUEUED, 0, 2)


def test_progress_comes_from_the_index_or_from_the_tiles(farm: SmallFarm, away: Queue):
    job_id = farm.submit(width=32, height=32)
    context = farm.worker()
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    epoch = farm.queue.epoch()
    farm.store.write_tile(job_id, 0, b"x")
    farm.queue.lease_next(epoch, job_id, context.name, finished=0, rays=300)
    progress = jobs.view(farm.store, farm.queue, job_id).progress
    assert (progress.tiles_done, progress.tiles_total, progress.fraction, progress.rays) == (1, 4, 0.25, 300)
    assert progress.rays_per_s > 0
    assert progress.eta_s > 0
    blind = jobs.view(farm.store, away, job_id).progress
    assert (blind.tiles_done, blind.rays, blind.rays_per_s) == (1, 0, None)


def test_queued_job_is_canceled_at_once(farm: SmallFarm):
    job_id = farm.submit()
    assert jobs.cancel(farm.store, farm.queue, job_id).state is JobState.CANCELED
    assert [event.state for event in farm.store.events(job_id)][1:] == [JobState.CANCELING, JobState.CANCELED]
    with pytest.raises(IllegalTransitionError) as caught:
        jobs.cancel(farm.store, farm.queue, job_id)
    assert (caught.value.current, caught.value.allowed) == (JobState.CANCELED, ())
    tasks.prepare(farm.worker(), job_id)  # the hint comes late
    assert farm.state(job_id) == "canceled"


def test_cancel_while_the_queue_is_away_is_finished_later(farm: SmallFarm, away: Queue):
    job_id = farm.submit()
    assert jobs.cancel(farm.store, away, job_id).state is JobState.CANCELING
    assert jobs.cancel(farm.store, away, job_id).state is JobState.CANCELING  # again: the same
    farm.steward.reconcile(hinted=True)
    assert farm.state(job_id) == "canceled"


def test_leased_job_is_canceling_until_the_worker_lets_go(farm: SmallFarm):
    job_id = farm.submit(width=32, height=32)
    farm.drop_hints()
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    farm.queue.lease_next(farm.queue.epoch(), job_id, "w")
    assert jobs.cancel(farm.store, farm.queue, job_id).state is JobState.CANCELING
    farm.steward.reconcile()
    assert farm.state(job_id) == "canceling"
    farm.queue.release("w")
    farm.steward.reconcile()
    assert farm.state(job_id) == "canceled"


@pytest.mark.parametrize("end", ["canceled", "failed"])
def test_job_that_ended_early_still_tells_what_was_done(farm: SmallFarm, end: str):
    job_id = farm.submit(width=32, height=32)
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    farm.store.write_tile(job_id, 0, b"x")
    farm.queue.lease_next(farm.queue.epoch(), job_id, "w", finished=0, rays=300)
    farm.queue.release("w")
    if end == "canceled":
        jobs.cancel(farm.store, farm.queue, job_id)
    else:
        jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")
    view = jobs.view(farm.store, farm.queue, job_id)
    assert view.state == end
    assert farm.store.done_tiles(job_id) == []
    progress = view.progress
    assert (progress.tiles_done, progress.tiles_total, progress.fraction, progress.rays) == (1, 4, 0.25, 300)
    assert (progress.rays_per_s, progress.eta_s) == (None, None)


def test_full_store_leaves_a_failing_job_to_be_tried_again(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    """Stopped but not failed, it would stand still for ever."""

    def refuse(*_: object, **__: object) -> None:
        raise StoreFullError

    job_id = farm.submit(width=32, height=32)
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    with monkeypatch.context() as patch:
        patch.setattr(farm.store, "append_event", refuse)
        with pytest.raises(StoreFullError):
            jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")
    assert farm.queue.has_free_tiles(job_id)
    assert jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")
    assert farm.queue.active_jobs() == set()
    assert not jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")


def test_delete_only_what_has_ended(farm: SmallFarm):
    job_id = farm.submit()
    with pytest.raises(JobActiveError) as caught:
        jobs.delete(farm.store, farm.queue, job_id)
    assert caught.value.current is JobState.QUEUED
    jobs.cancel(farm.store, farm.queue, job_id)
    jobs.delete(farm.store, farm.queue, job_id)
    with pytest.raises(JobNotFoundError):
        jobs.view(farm.store, farm.queue, job_id)


@pytest.mark.parametrize(("output", "size"), [({}, 256), ({"tile_size": None}, 256), ({"tile_size": 48}, 48)])
def test_tile_size_is_chosen_where_none_is_named(farm: SmallFarm, output: dict[str, object], size: int):
    scene = make_scene(width=3840, height=2160, samples=16)
    record = farm.store.read_job(jobs.submit(farm.store, farm.queue, scene, owner="me", output=output).job_id)
    assert record.output["tile_size"] == size
    assert record.n_tiles == -(-3840 // size) * -(-2160 // size)
