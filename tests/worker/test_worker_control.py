"""The control thread: keeps the lease, obeys, and outlives the server."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from worker_farm import SmallFarm

from worker import contract, jobs, tasks
from worker.context import WorkerContext
from worker.control import ControlThread
from worker.embedded import EmbeddedServer
from worker.queue import Queue
from worker.records import new_job_id


@contextmanager
def controlled(context: WorkerContext) -> Iterator[None]:
    thread = ControlThread(context)
    thread.start()
    until(context.queue.count_workers)
    yield
    thread.stop()
    thread.join(5)
    assert not thread.is_alive()


def until(look: Callable[[], object], timeout_s: float = 10.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not look():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_lease_outlives_its_time_to_live(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(contract, "RENEW_EVERY_S", 0.05)
    job_id = new_job_id()
    context = farm.worker()
    farm.queue.init_job(job_id, 1, 1)
    with controlled(context), context.working_on(job_id):
        assert farm.queue.lease_next(farm.queue.epoch(), job_id, context.name, ttl_ms=300).tile == 0
        time.sleep(0.6)
        assert farm.queue.expire().expired == []
        (worker,) = farm.queue.workers()
        assert (worker.state, worker.job, worker.tile, worker.alive) == ("busy", job_id, 0, True)


def test_lease_of_no_current_job_runs_out(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    """What an idle worker holds was left by a task that ended badly: the janitor must get it."""
    monkeypatch.setattr(contract, "RENEW_EVERY_S", 0.05)
    job_id = new_job_id()
    context = farm.worker()
    farm.queue.init_job(job_id, 1, 1)
    with controlled(context):
        farm.queue.lease_next(farm.queue.epoch(), job_id, context.name, ttl_ms=300)
        time.sleep(0.6)
        assert farm.queue.expire().expired == [(context.name, job_id, 0)]


def test_cancel_reaches_a_kernel(farm: SmallFarm):
    job_id = farm.submit("fake tile_s=30", width=16, height=16)
    context = farm.worker()
    with controlled(context):
        thread = threading.Thread(target=tasks.prepare, args=(context, job_id))
        thread.start()
        until(lambda: farm.queue.leases().get("w0") == (job_id, 0))
        began = time.monotonic()
        jobs.cancel(farm.store, farm.queue, job_id)
        thread.join(5)
        assert time.monotonic() - began < 1.0
    assert farm.state(job_id) == "canceled"


def test_cancel_that_was_missed_is_read_from_the_index(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(contract, "RENEW_EVERY_S", 0.1)
    monkeypatch.setattr(ControlThread, "_obey", lambda *_: None)  # as if nothing was heard
    job_id = new_job_id()
    context = farm.worker()
    farm.queue.init_job(job_id, 1, 1)
    with controlled(context), context.working_on(job_id):
        farm.queue.stop_job(job_id)
        until(lambda: context.cancel[0] == 1)


def test_another_job_is_not_hit(farm: SmallFarm):
    context = farm.worker()
    job_id = new_job_id()
    with controlled(context), context.working_on(job_id):
        farm.queue.redis.publish(contract.CHANNEL_CONTROL, f"cancel {new_job_id()}")
        farm.queue.redis.publish(contract.CHANNEL_CONTROL, "cancel")
        farm.queue.redis.publish(contract.CHANNEL_CONTROL, "nonsense")
        farm.queue.redis.publish(contract.CHANNEL_CONTROL, f"nonsense {job_id}")
        time.sleep(0.2)
        assert context.cancel[0] == 0
        farm.queue.redis.publish(contract.CHANNEL_CONTROL, f"cancel {job_id}")
        until(lambda: context.cancel[0] == 1)


def test_restarted_server_is_found_again(farm: SmallFarm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(contract, "RENEW_EVERY_S", 0.1)
    server = EmbeddedServer(tmp_path / "v")
    server.start()
    try:
        farm.queue = Queue(server.url)
        context = farm.worker()
        job_id = new_job_id()
        with controlled(context), context.working_on(job_id):
            server.kill()
            time.sleep(0.5)
            server.start()
            farm.queue.redis.flushall()
            until(lambda: farm.queue.count_workers() == 1)

            def is_obeyed() -> bool:
                farm.queue.redis.publish(contract.CHANNEL_CONTROL, f"cancel {job_id}")
                return bool(context.cancel[0] == 1)

            until(is_obeyed)
    finally:
        server.close()
