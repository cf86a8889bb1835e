"""The wire to Redis: clients with the right timeouts, errors of ours, one async subscription.

Job: what everybody needs who speaks to the queue's server.
Invariant: no command waits longer than its timeout, no blocking read shares a connection with commands.
Timeouts are given throughout, because redis-py 8 has ``socket_timeout=5`` by default.
"""

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import redis
import redis.asyncio
from redis.backoff import NoBackoff
from redis.exceptions import OutOfMemoryError
from redis.retry import Retry

from worker import contract
from worker.errors import QueueFullError, QueueUnavailableError

# A command that takes longer than this on a healthy farm does not exist (the slowest, FLUSHALL apart, takes 10 ms).
COMMAND_TIMEOUT_S = 5.0


def unix_url(path: Path) -> str:
    """Return the URL of a server's unix socket."""
    return f"unix://{quote(str(path))}"


@contextmanager
def clear_errors() -> Iterator[None]:
    """Turn redis-py's errors into ours."""
    try:
        yield
    except OutOfMemoryError as error:
        raise QueueFullError from error
    except (redis.ConnectionError, redis.TimeoutError) as error:  # BusyLoadingError is a ConnectionError
        raise QueueUnavailableError(f"the queue's server does not answer: {error}") from error


def connect(url: str, *, timeout_s: float | None = COMMAND_TIMEOUT_S) -> "redis.Redis":
    """Return a client whose commands answer within `timeout_s`; None for blocking reads, which need their own.

    One silent retry, no more: NEXT is safe to repeat, and an outage is to be seen, not slept through.
    """
    return redis.Redis.from_url(
        url,
        socket_timeout=timeout_s,
        socket_connect_timeout=2.0,
        retry=Retry(NoBackoff(), 1),
        health_check_interval=0,
    )


async def watch(url: str, channel: str = contract.CHANNEL_EVENTS) -> AsyncIterator[str]:
    """Yield the messages of a channel for ever; an empty string once subscribed and after each reconnection.

    Messages are lost while the server is away: on "" look at the store. Uses a connection of its own, without read
    timeout. Raises `QueueUnavailableError` when the connection breaks; call again after a pause.
    """
    client = redis.asyncio.Redis.from_url(url, socket_timeout=None, socket_connect_timeout=2.0)
    try:
        async with client.pubsub() as pubsub:
            with clear_errors():
                await pubsub.subscribe(channel)
                async for message in pubsub.listen():
                    yield "" if message["type"] == "subscribe" else message["data"].decode()
    finally:
        await client.aclose()
