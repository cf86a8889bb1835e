"""The cancel flag belongs to the current job, and an outage of the queue is waited for."""

import threading
import time

import pytest
from worker_farm import SmallFarm

from worker.backends import CanceledError
from worker.context import CANCELED, DRAINING, Prepared
from worker.errors import QueueUnavailableError
from worker.grid import TileGrid
from worker.queue import Queue, unix_url


def test_only_the_current_job_is_canceled(farm: SmallFarm):
    context = farm.worker()
    assert not context.cancel_job("a")
    with context.working_on("a"):
        assert (context.job, context.state) == ("a", "busy")
        assert not context.cancel_job("b")
        context.check()
        assert context.cancel_job("a")
        assert context.cancel[0] == CANCELED
        with pytest.raises(CanceledError):
            context.check()
    assert (context.job, context.state) == (None, "idle")
    with context.working_on("b"):
        context.check()  # the flag was for the job before


def test_a_drain_outlasts_jobs_and_cancels(farm: SmallFarm):
    context = farm.worker()
    with context.working_on("a"):
        context.drain()
        context.cancel_job("a")
        assert context.cancel[0] == DRAINING
    assert context.state == "draining"
    with context.working_on("b"), pytest.raises(CanceledError):
        context.check()


def test_a_few_compiled_scenes_are_kept(farm: SmallFarm):
    context = farm.worker()
    prepared = Prepared(None, TileGrid(0, 0, 16, 16, 16), 1, 50)
    for job_id in "abcd":
        context.remember(job_id, prepared)
    context.remember("a", prepared)  # used again
    context.remember("e", prepared)
    assert list(context.prepared) == ["c", "d", "a", "e"]


def test_a_rebuild_of_the_index_is_waited_for(farm: SmallFarm):
    job_id = farm.submit(width=32, height=16)
    farm.queue.init_job(job_id, 2, 2)
    context = farm.worker()
    assert context.lease_next(job_id, finished=None, rays=0, kernel_s=0.0, commit_only=False).tile == 0
    farm.queue.redis.flushall()

    def rebuild() -> None:
        time.sleep(0.1)
        farm.queue.init_job(job_id, 2, 2, [0])
        farm.steward.tick()

    thread = threading.Thread(target=rebuild)
    thread.start()
    assert context.lease_next(job_id, finished=0, rays=5, kernel_s=0.1, commit_only=False).tile == 1
    thread.join()


def test_a_queue_that_stays_away_is_given_up(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("worker.context._OUTAGE_S", 0.1)
    context = farm.worker()
    context.queue = Queue(unix_url(farm.store.root / "nobody"))
    with pytest.raises(QueueUnavailableError):
        context.lease_preparation("a")
    context.release()  # says so in the log, and raises nothing


def test_a_worker_told_to_stop_does_not_wait_for_the_queue(farm: SmallFarm):
    context = farm.worker()
    context.queue = Queue(unix_url(farm.store.root / "nobody"))
    context.drain()
    with pytest.raises(CanceledError):
        context.lease_preparation("a")
