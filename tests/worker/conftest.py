"""One Valkey for the tests of a process, empty for each test."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from worker_farm import SmallFarm

from worker.embedded import EmbeddedServer
from worker.queue import Queue
from worker.store import Store


@pytest.fixture(scope="session")
def redis_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    server = EmbeddedServer(tmp_path_factory.mktemp("valkey"))
    server.start()
    yield server.url
    server.close()


@pytest.fixture
def queue(redis_url: str) -> Iterator[Queue]:
    queue = Queue(redis_url)
    queue.redis.flushall()
    yield queue
    queue.close()


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


@pytest.fixture
def farm(tmp_path: Path, queue: Queue) -> SmallFarm:
    return SmallFarm(tmp_path, queue)
