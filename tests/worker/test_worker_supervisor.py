"""The supervisor: what it tells when ready, what its children are like, and how it refuses to start."""

import json
import os
import re
import signal
import time
from pathlib import Path

import pytest

from worker.errors import FarmError, QueueUnavailableError, WrongStoreError
from worker.settings import FarmSettings
from worker.supervisor import Supervisor

pytestmark = pytest.mark.farm


@pytest.fixture
def settings(tmp_path: Path) -> FarmSettings:
    return FarmSettings(
        store=tmp_path / "a store" / "s",
        cache=tmp_path / "cache",
        backend="fake",
        workers=1,
        api=False,
        log_file=tmp_path / "log",
        ready_file=tmp_path / "ready.json",
    )


def test_ready_farm(settings: FarmSettings):
    told = []
    with Supervisor(settings, ready=told.append) as farm:
        assert told == [farm]
        assert json.loads(settings.ready_file.read_bytes()) == {
            "url": None,
            "redis_url": farm.redis_url,
            "pid": os.getpid(),
        }
        (worker,) = farm.queue.workers()
        assert (worker.name, worker.state, worker.alive) == (farm.children["worker-0"].lease_name, "idle", True)
        assert os.getpriority(os.PRIO_PROCESS, worker.pid) == min(19, os.getpriority(os.PRIO_PROCESS, 0) + 10)
        assert os.getpriority(os.PRIO_PROCESS, farm.pid("steward")) == os.getpriority(os.PRIO_PROCESS, 0)
        environment = Path(f"/proc/{worker.pid}/environ").read_bytes().split(b"\0")
        assert b"OPENBLAS_NUM_THREADS=1" in environment
        # A dead child is back under another name, so that no lease of it can be mistaken for one of its successor.
        os.kill(worker.pid, signal.SIGKILL)
        deadline = time.monotonic() + 20
        while {one.name for one in farm.queue.workers()} != {farm.children["worker-0"].lease_name} or (
            farm.children["worker-0"].lease_name == worker.name
        ):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        # A child that dies young waits longer each time.
        assert farm.children["worker-0"].pause_s > 0.0
    assert not settings.ready_file.exists()


def test_second_farm_on_a_store_is_refused(settings: FarmSettings, monkeypatch: pytest.MonkeyPatch):
    from worker.embedded import EmbeddedServer

    monkeypatch.setattr(EmbeddedServer._take_lock, "__defaults__", (0.1,))
    with Supervisor(settings.model_copy(update={"workers": 0})):
        with pytest.raises(FarmError, match="another supervisor"), Supervisor(settings):
            pass
        assert settings.ready_file.exists()


def test_taken_port_is_told(settings: FarmSettings):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        changes = {"api": True, "port": taken.getsockname()[1]}
        with pytest.raises(FarmError, match=str(changes["port"])), Supervisor(settings.model_copy(update=changes)):
            pass


def test_unreachable_redis_is_told_with_its_address_and_without_its_password(
    settings: FarmSettings, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("worker.supervisor._REDIS_TIMEOUT_S", 0.2)
    monkeypatch.setattr("worker.supervisor._READY_TIMEOUT_S", 10.0)
    changes = {"redis_url": "redis://me:secret@127.0.0.1:1/0", "steward": False}
    with pytest.raises(QueueUnavailableError, match=re.escape("redis://127.0.0.1:1/0")) as caught:
        Supervisor(settings.model_copy(update=changes)).start()
    assert "secret" not in str(caught.value)


def test_redis_of_another_store_is_refused(settings: FarmSettings, tmp_path: Path):
    with Supervisor(settings.model_copy(update={"workers": 0})) as farm:
        changes = {"redis_url": farm.redis_url, "store": tmp_path / "wrong", "steward": False}
        with pytest.raises(WrongStoreError, match="wrong: give the --store"):
            Supervisor(settings.model_copy(update=changes)).start()
