"""Starting the farm: what keeps it from starting is told as the client tells errors."""

import socket
import time
from pathlib import Path
from typing import Any

import pytest

from client.errors import ConflictError, NotReachableError, SmaltiError, UsageError
from client.serve import default_store, run_farm
from worker import contract
from worker.embedded import EmbeddedServer
from worker.errors import QueueUnavailableError, ServerStartError, StoreInUseError
from worker.identity import claim_store
from worker.queue import Queue
from worker.store import Store


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.logs.configure_logs", lambda *_, **__: None)
    monkeypatch.setattr("worker.supervisor._REDIS_TIMEOUT_S", 0.1)
    monkeypatch.setattr("signal.signal", lambda *_: None)


def test_a_setting_out_of_range_is_named() -> None:
    with pytest.raises(UsageError, match="port: Input should be less than or equal to 65535"):
        run_farm(port=70_000)


def test_an_absent_redis_is_told_with_its_address(tmp_path: Path) -> None:
    with pytest.raises(NotReachableError, match=r"redis://127\.0\.0\.1:1/0") as caught:
        run_farm(store=tmp_path, redis_url="redis://127.0.0.1:1/0", workers=0)
    assert "--redis-url" in caught.value.hint


def test_the_store_of_another_service_is_wrong_usage(tmp_path: Path) -> None:
    server = EmbeddedServer(tmp_path / "valkey")
    server.start()
    try:
        queue = Queue(server.url)
        claim_store(Store(tmp_path / "right"), queue)
        queue.redis.persist(contract.KEY_STORE)  # on a busy machine it would lapse too soon
        with pytest.raises(UsageError, match="give the --store that it has"):
            run_farm(store=tmp_path / "wrong", redis_url=server.url, workers=0, api=False, steward=False)
    finally:
        server.close()


def test_a_port_in_use_is_told_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConflictError, match=f"port {port} of 127.0.0.1 is in use") as caught:
            run_farm(store=tmp_path / "store", port=port, workers=0)
    assert "--port" in caught.value.hint
    assert caught.value.exit_code == 8
    assert not (tmp_path / "store").exists()


def test_a_store_in_use_is_told_soon(tmp_path: Path) -> None:
    server = EmbeddedServer(tmp_path / "valkey")
    server.start()
    started = time.monotonic()
    try:
        with pytest.raises(ConflictError, match="is in use by another `smalti serve`") as caught:
            run_farm(store=tmp_path, port=0, workers=0)
    finally:
        server.close()
    assert str(tmp_path) in caught.value.message
    assert "--store" in caught.value.hint
    assert caught.value.exit_code == 8
    assert time.monotonic() - started < 4.0, "the supervisor waits for five seconds"


def test_a_store_whose_server_is_about_to_end_is_left_to_the_supervisor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class InUse:
        error = StoreInUseError("held")

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def run(self) -> int:
            return 1

    monkeypatch.setattr("worker.supervisor.Supervisor", InUse)
    server = EmbeddedServer(tmp_path / "valkey")  # holds the lock, and does not answer
    try:
        with pytest.raises(ConflictError, match="is in use"):
            run_farm(store=tmp_path, port=0, workers=0)
    finally:
        server.close()


def test_the_log_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ended:
        error = ServerStartError("it did not come up")

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def run(self) -> int:
            return 1

    monkeypatch.setattr("worker.supervisor.Supervisor", Ended)
    with pytest.raises(SmaltiError, match="it did not come up") as caught:
        run_farm(store=tmp_path, port=0, log_file=tmp_path / "farm.log")
    assert str(tmp_path / "farm.log") in caught.value.hint


@pytest.mark.parametrize("error", [None, ValueError("a bug"), QueueUnavailableError("gone")])
def test_a_farm_that_ended_by_itself_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception | None
) -> None:
    class Ended:
        def __init__(self, *_: Any, **__: Any) -> None:
            self.error = error

        def run(self) -> int:
            return 0 if error is None else 1

    monkeypatch.setattr("worker.supervisor.Supervisor", Ended)
    if error is None:
        run_farm(store=tmp_path, port=0)
        return
    with pytest.raises(SmaltiError) as caught:
        run_farm(store=tmp_path, port=0)
    assert "a bug" not in str(caught.value), "that is for the log"
    assert isinstance(caught.value, NotReachableError) is isinstance(error, QueueUnavailableError)


def test_the_store_is_that_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SMALTI_STORE", raising=False)
    assert default_store() == Path(".smalti/store")
    monkeypatch.setenv("SMALTI_STORE", "/elsewhere")
    assert default_store() == Path("/elsewhere")
