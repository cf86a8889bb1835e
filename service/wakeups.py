"""Waking whoever waits for a job: one subscription per process, handed out to any number of waiters.

Job: hear the farm's events (pub/sub) and set a flag for each waiter of that job.
Invariant: a wake-up is only a hint to look at the store. After each (re)connection everybody is woken, since messages
were lost meanwhile; and nobody waits longer than `POLL_S` without looking, so a lost message costs a moment, no more.
"""

import asyncio
from collections import defaultdict
from collections.abc import Iterator
from contextlib import aclosing, contextmanager, suppress
from typing import Final

import structlog

from worker.errors import QueueUnavailableError
from worker.queue import watch
from worker.states import TERMINAL

# How long a waiter trusts the subscription: a lost message (Redis restarted, say) is found out after this time.
POLL_S: Final = 1.0
# The same while there is no subscription: looking costs one directory listing, about 0.05 ms.
POLL_BLIND_S: Final = 0.2
_RECONNECT_S: Final = 0.25

log = structlog.get_logger()


class Waiter:
    """One who waits for news of a job; with `end_only`, for the news that it has ended."""

    def __init__(self, hub: "Wakeups", *, end_only: bool = False) -> None:
        self.end_only = end_only
        self._hub = hub
        self._flag = asyncio.Event()

    def wake(self) -> None:
        """There may be news."""
        self._flag.set()

    async def wait(self, timeout_s: float) -> bool:
        """Wait for news, at most `timeout_s` and at most the poll interval; True if woken by a message."""
        limit_s = min(timeout_s, POLL_S if self._hub.connected else POLL_BLIND_S)
        with suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                await self._flag.wait()
        woken = self._flag.is_set()
        self._flag.clear()
        return woken


class Wakeups:
    """The subscription and those who wait; used on the event loop only.

    Parameters
    ----------
    redis_url
        Server to listen to; None: nobody is woken, all poll.
    """

    def __init__(self, redis_url: str | None) -> None:
        self.connected = False
        self.closing = False
        self._url = redis_url
        self._waiters: defaultdict[str, set[Waiter]] = defaultdict(set)
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to listen."""
        if self._url is not None:
            self._task = asyncio.create_task(self._listen(self._url), name="wakeups")

    def close(self) -> None:
        """Wake everybody for the last time: streams end when they see `closing`."""
        self.closing = True
        self._wake_all()

    async def stop(self) -> None:
        """Stop listening."""
        self.close()
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
            self._task = None

    @contextmanager
    def waiting(self, job_id: str, *, end_only: bool = False) -> Iterator[Waiter]:
        """Listen for news of a job from now on; look at the store after entering, then wait."""
        waiter = Waiter(self, end_only=end_only)
        self._waiters[job_id].add(waiter)
        try:
            yield waiter
        finally:
            waiters = self._waiters[job_id]
            waiters.discard(waiter)
            if not waiters:
                del self._waiters[job_id]

    def hear(self, message: str) -> None:
        """Wake those whom a message ("<job> <number> <state>") concerns."""
        job_id, _, rest = message.partition(" ")
        has_ended = rest.rpartition(" ")[2] in TERMINAL
        for waiter in self._waiters.get(job_id, ()):
            if has_ended or not waiter.end_only:
                waiter.wake()

    def _wake_all(self) -> None:
        for waiters in self._waiters.values():
            for waiter in waiters:
                waiter.wake()

    async def _listen(self, url: str) -> None:
        while True:
            try:
                async with aclosing(watch(url)) as messages:  # type: ignore[type-var]
                    async for message in messages:
                        if not message:
                            self.connected = True
                            self._wake_all()
                        else:
                            self.hear(message)
            except QueueUnavailableError:
                if self.connected:
                    log.warning("subscription lost")
            except Exception:  # a bug here must not end the listening for ever
                log.exception("subscription failed")
            self.connected = False
            await asyncio.sleep(_RECONNECT_S)
