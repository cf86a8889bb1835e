"""Janitor and reconciler: whatever Redis loses comes back from the store, and nothing more."""

import time

import pytest
from worker_farm import SmallFarm

from worker import contract, jobs, tasks
from worker.embedded import EmbeddedServer
from worker.errors import QueueUnavailableError
from worker.queue import Queue
from worker.records import JobEvent, JobRecord
from worker.states import JobState
from worker.steward import Steward
from worker.store import Store


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract, "STALLED_AFTER_S", -1.0)


def rendering(farm: SmallFarm, n_done: int = 0) -> str:
    job_id = farm.submit(width=64, height=32)
    farm.drop_hints()
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 8, 4)
    for tile in range(n_done):
        farm.store.write_tile(job_id, tile, b"x")
    return job_id


def test_wiped_index_comes_back(farm: SmallFarm):
    queued, running, canceling = farm.submit(), rendering(farm, 3), farm.submit()
    farm.store.transition(canceling, JobState.CANCELING, by="api")
    ended = farm.submit()
    jobs.cancel(farm.store, farm.queue, ended)
    farm.queue.redis.flushall()
    assert farm.steward.tick()
    assert farm.queue.progress(running)[:2] == (3, 8)
    hints = farm.queue.hints()
    assert (contract.TASK_PREPARE, queued) in hints
    assert (contract.TASK_RENDER_RUN, running) in hints
    assert farm.state(canceling) == "canceled"
    assert farm.queue.active_jobs() == {running}
    assert not {job_id for _, job_id in hints} & {canceling, ended}
    assert not farm.steward.tick()


def test_restarted_server_is_noticed_by_its_run(farm: SmallFarm):
    job_id = rendering(farm, 2)
    farm.queue.redis.set(contract.KEY_EPOCH, "0123456789ab-from-another-run")
    assert farm.steward.tick()
    assert farm.queue.progress(job_id).done == 2


def test_real_restart_brings_back_the_file_and_a_new_epoch(tmp_path, farm: SmallFarm):
    server = EmbeddedServer(tmp_path / "v")
    server.start()
    try:
        queue = Queue(server.url)
        steward = Steward(farm.store, queue)
        assert steward.tick()
        job_id = rendering(farm, 1)
        queue.init_job(job_id, 8, 4, [0])
        before = queue.epoch()
        time.sleep(1.2)  # the file is written each second
        server.kill()
        server.start()
        assert queue.epoch() == before
        assert steward.tick()
        assert queue.epoch() != before
    finally:
        server.close()


def test_overdue_lease_is_noted_hinted_and_counted(farm: SmallFarm):
    job_id = rendering(farm)
    farm.drop_hints()
    epoch = farm.queue.epoch()
    for losses in range(1, contract.MAX_TILE_LOSSES + 1):
        assert farm.queue.lease_next(epoch, job_id, "w").tile == 0
        farm.queue.redis.zadd(contract.KEY_DEADLINES, {"w": 0})
        farm.steward.tick()
        event: JobEvent = farm.store.events(job_id)[2 + losses]
        assert (event.type, event.detail) == ("tile_lost", {"worker": "w", "tile": 0, "losses": losses})
        if losses < contract.MAX_TILE_LOSSES:
            assert (contract.TASK_RENDER_RUN, job_id) in farm.queue.hints()
    problem = jobs.view(farm.store, farm.queue, job_id).problem
    assert (problem["type"], problem["tile"]) == ("urn:smalti:problem:worker-lost", 0)
    assert problem["reproduce"].endswith(f"tile {job_id} 0")


def test_lost_preparation_is_hinted_again(farm: SmallFarm):
    job_id = farm.submit()
    farm.store.transition(job_id, JobState.PREPARING, by="w")
    farm.drop_hints()
    farm.queue.lease_preparation(farm.queue.epoch(), job_id, "w")
    farm.steward.reconcile()
    assert farm.queue.hints() == set()  # somebody is at it
    farm.queue.redis.zadd(contract.KEY_DEADLINES, {"w": 0})
    farm.steward.tick()
    assert farm.queue.hints() == {(contract.TASK_PREPARE, job_id)}


def test_lost_hint_comes_again_and_only_once(farm: SmallFarm):
    job_id = farm.submit()
    farm.drop_hints()
    for _ in range(3):
        farm.steward.reconcile()
    assert farm.queue.queue_lengths()[contract.QUEUE_NORMAL] == 1
    assert farm.queue.hints() == {(contract.TASK_PREPARE, job_id)}


def test_fresh_job_is_left_alone(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(contract, "STALLED_AFTER_S", 60.0)
    farm.submit()
    farm.drop_hints()
    farm.steward.reconcile()
    assert farm.queue.hints() == set()


def test_job_that_is_worked_on_is_left_alone_until_a_worker_idles(farm: SmallFarm):
    job_id = rendering(farm)
    farm.drop_hints()
    farm.queue.lease_next(farm.queue.epoch(), job_id, "w")
    farm.steward.reconcile()
    assert farm.queue.hints() == set()
    farm.queue.report_worker("idle", {"state": "idle"})
    farm.steward.reconcile()
    assert farm.queue.hints() == {(contract.TASK_RENDER_RUN, job_id)}


def test_tile_on_disk_that_the_index_missed_is_counted(farm: SmallFarm):
    job_id = rendering(farm)
    for tile in range(8):
        farm.store.write_tile(job_id, tile, b"x")
    farm.drop_hints()
    farm.queue.report_worker("idle", {"state": "idle"})
    farm.steward.reconcile()
    assert farm.queue.progress(job_id).done == 8
    assert farm.queue.hints() == set()


def test_job_that_ended_in_a_crash_is_cleaned_up(farm: SmallFarm):
    job_id = rendering(farm, 2)
    farm.store.transition(job_id, JobState.FAILED, by="w")  # and then the process died
    farm.steward.reconcile()
    assert farm.queue.active_jobs() == set()
    assert farm.store.done_tiles(job_id) == []


def test_deleted_job_leaves_the_index(farm: SmallFarm):
    job_id = rendering(farm)
    farm.store.delete_job(job_id)
    farm.steward.reconcile()
    assert farm.queue.active_jobs() == set()


def test_ended_jobs_are_opened_once_even_across_restarts(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    for _ in range(20):
        jobs.cancel(farm.store, farm.queue, farm.submit())
    farm.drop_hints()
    farm.steward.reconcile()
    farm.steward.sweep()
    opened = []
    real = type(farm.store)._read
    monkeypatch.setattr(type(farm.store), "_read", lambda *a: opened.append(a[1:]) or real(*a))
    Steward(Store(farm.store.root), farm.queue).reconcile(everything=True)  # as after a restart
    assert opened == []


def test_waiting_jobs_are_not_opened_again(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    for _ in range(20):
        farm.submit()
    monkeypatch.setattr(farm.store, "last_event", pytest.fail)
    assert farm.steward.reconcile() == 20


def test_damaged_job_does_not_stop_the_others(farm: SmallFarm):
    broken, sound = farm.submit(), farm.submit()
    (farm.store.job_dir(broken) / "events" / "000002.json").write_bytes(b"")
    farm.queue.redis.flushall()
    farm.steward.tick()
    assert (contract.TASK_PREPARE, sound) in farm.queue.hints()


def test_done_tile_without_a_file_is_rendered_again(farm: SmallFarm):
    job_id = farm.submit(width=64, height=32)
    tasks.prepare(farm.worker(), job_id)
    farm.store.tile_path(job_id, 5).unlink()  # as after a power failure that Redis outlived
    farm.drop_hints()
    farm.assembler.advance(job_id)
    farm.steward.reconcile()
    assert farm.queue.progress(job_id).done == 7
    assert farm.queue.hints() == {(contract.TASK_RENDER_RUN, job_id)}
    tasks.render_run(farm.worker(), job_id)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"


def test_unreadable_job_does_not_stop_the_others(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    incomplete, unreadable, odd, sound = (farm.submit() for _ in range(4))
    (farm.store.job_dir(incomplete) / "job.json").unlink()
    real_event, real_job = farm.store.last_event, farm.store.read_job

    def last_event(job_id: str) -> JobEvent:
        if job_id == unreadable:
            raise PermissionError(job_id)
        return real_event(job_id)

    def read_job(job_id: str) -> JobRecord:
        if job_id == odd:
            raise KeyError("tile_size")
        return real_job(job_id)

    monkeypatch.setattr(farm.store, "last_event", last_event)
    monkeypatch.setattr(farm.store, "read_job", read_job)
    farm.queue.redis.flushall()
    assert farm.steward.tick()
    assert not farm.steward.tick()  # the index is complete
    assert (contract.TASK_PREPARE, sound) in farm.queue.hints()


def test_unreadable_job_does_not_keep_the_leases_of_others(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    unreadable, sound = rendering(farm), rendering(farm)
    farm.drop_hints()
    for worker, job_id in (("a", unreadable), ("b", sound)):
        farm.queue.lease_next(farm.queue.epoch(), job_id, worker)
        farm.queue.redis.zadd(contract.KEY_DEADLINES, {worker: 0})
    real = farm.store.last_event

    def last_event(job_id: str) -> JobEvent:
        if job_id == unreadable:
            raise PermissionError(job_id)
        return real(job_id)

    monkeypatch.setattr(farm.store, "last_event", last_event)
    farm.steward.tick()
    assert farm.queue.hints() == {(contract.TASK_RENDER_RUN, sound)}


def test_queue_that_goes_away_in_a_rebuild_leaves_it_undone(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    farm.submit()
    farm.queue.redis.flushall()

    def refuse(*_: object) -> None:
        raise QueueUnavailableError

    monkeypatch.setattr(farm.queue, "enqueue_prepare", refuse)
    with pytest.raises(QueueUnavailableError):
        farm.steward.tick()
    assert farm.queue.epoch() is None


def test_old_workers_are_forgotten(farm: SmallFarm):
    farm.queue.report_worker("w", {"state": "idle"})
    farm.steward.sweep()
    assert farm.queue.count_workers() == 1
    farm.queue.redis.hset(contract.KEY_WORKERS, "w", '{"at": 0}')
    farm.steward.sweep()
    assert farm.queue.count_workers() == 0


def test_whole_job_by_hand(farm: SmallFarm):
    job_id = farm.submit(width=64, height=32)
    farm.queue.redis.flushall()
    farm.steward.tick()
    tasks.prepare(farm.worker(), job_id)
    farm.queue.redis.flushall()
    farm.steward.tick()
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"
