"""The wire to Redis: our errors, and a subscription that tells when it stands."""

import asyncio
from pathlib import Path

import pytest
import redis

from worker.errors import QueueFullError, QueueUnavailableError
from worker.queue import Queue
from worker.wire import clear_errors, connect, unix_url, watch


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        (redis.exceptions.OutOfMemoryError(), QueueFullError),
        (redis.exceptions.BusyLoadingError(), QueueUnavailableError),
        (redis.ConnectionError(), QueueUnavailableError),
        (redis.TimeoutError(), QueueUnavailableError),
        (redis.ResponseError("a bug"), redis.ResponseError),
    ],
)
def test_errors_are_told_as_ours(theirs: Exception, ours: type[Exception]):
    with pytest.raises(ours), clear_errors():
        raise theirs


def test_path_with_odd_characters_reaches_the_server(tmp_path: Path):
    path = tmp_path / "a b?c#d"
    with pytest.raises(redis.ConnectionError, match=r"a b\?c#d"):
        connect(unix_url(path)).ping()


def test_watch_tells_when_it_stands_and_what_is_said(queue: Queue):
    async def listen() -> list[str]:
        heard = []
        async for message in watch(queue.url, "some-channel"):
            heard.append(message)
            if message == "":
                queue.redis.publish("some-channel", "news é")
            else:
                return heard
        return heard

    assert asyncio.run(asyncio.wait_for(listen(), 10)) == ["", "news é"]


def test_watch_of_an_absent_server_is_told(tmp_path: Path):
    async def listen() -> None:
        async for _ in watch(unix_url(tmp_path / "nobody")):
            pass

    with pytest.raises(QueueUnavailableError):
        asyncio.run(asyncio.wait_for(listen(), 10))
