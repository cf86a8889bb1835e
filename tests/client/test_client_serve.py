"""Starting the farm: what keeps it from starting is told as the client tells errors."""

from pathlib import Path
from typing import Any

import pytest

from client.errors import NotReachableError, SmaltiError, UsageError
from client.serve import default_store, run_farm
from worker import contract
from worker.embedded import EmbeddedServer
from worker.errors import QueueUnavailableError
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
        run_farm(store=tmp_path)
        return
    with pytest.raises(SmaltiError) as caught:
        run_farm(store=tmp_path)
    assert "a bug" not in str(caught.value), "that is for the log"
    assert isinstance(caught.value, NotReachableError) is isinstance(error, QueueUnavailableError)


def test_the_store_is_that_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SMALTI_STORE", raising=False)
    assert default_store() == Path(".smalti/store")
    monkeypatch.setenv("SMALTI_STORE", "/elsewhere")
    assert default_store() == Path("/elsewhere")
