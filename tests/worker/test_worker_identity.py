"""Whose Redis it is: the first store's, until its farm is gone."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from worker_farm import SmallFarm

from worker import contract
from worker.control import ControlThread
from worker.errors import QueueUnavailableError, WrongStoreError
from worker.identity import check_store, claim_store
from worker.queue import Queue, unix_url
from worker.steward import Steward
from worker.store import Store


@pytest.fixture
def other(tmp_path: Path) -> Store:
    return Store(tmp_path / "other")


def test_store_keeps_its_identity(store: Store, other: Store):
    assert Store(store.root).identity == store.identity != other.identity


def test_first_store_has_the_server_until_its_word_lapses(queue: Queue, store: Store, other: Store):
    check_store(other, queue)  # nobody's
    claim_store(store, queue)
    claim_store(store, queue)
    check_store(Store(store.root), queue)
    for call in (check_store, claim_store):
        with pytest.raises(WrongStoreError, match=r"another store than .*other: give the --store"):
            call(other, queue)
    assert 0 < queue.redis.ttl(contract.KEY_STORE) <= contract.STORE_TTL_S
    queue.redis.expire(contract.KEY_STORE, 0)
    claim_store(other, queue)
    with pytest.raises(WrongStoreError):
        check_store(store, queue)


def test_absent_server_is_told(tmp_path: Path, store: Store):
    with pytest.raises(QueueUnavailableError):
        check_store(store, Queue(unix_url(tmp_path / "none")))


def test_steward_of_another_store_leaves_the_index_alone(farm: SmallFarm, other: Store):
    job_id = farm.submit()
    farm.queue.init_job(job_id, 4, 2)
    stranger = Steward(other, farm.queue)
    with pytest.raises(WrongStoreError):
        stranger.tick()
    assert farm.queue.active_jobs() == {job_id}


def test_worker_with_another_store_does_not_start(farm: SmallFarm, other: Store):
    farm.queue.redis.persist(contract.KEY_STORE)  # a busy machine may take longer to start a process
    settings = farm.settings.model_copy(update={"store": other.root, "redis_url": farm.queue.url})
    command = [sys.executable, "-m", "worker.main", "worker"]
    ended = subprocess.run(command, env=settings.child_environment(), capture_output=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert b"another store" in ended.stderr
    assert farm.queue.workers() == []


def test_worker_that_was_there_first_ends_when_the_service_has_another_store(
    farm: SmallFarm, other: Store, monkeypatch: pytest.MonkeyPatch
):
    told: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda *call: told.append(call))
    context = farm.worker()
    context.store = other
    ControlThread(context)._renew()
    assert told == [(os.getpid(), signal.SIGTERM)]
    assert farm.queue.workers() == []
