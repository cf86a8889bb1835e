"""What the routes share: settings, store, queue, wake-ups, counters.

Job: one object per app, built in `create_app` and handed to routes as a dependency.
Invariant: no module of `service` holds state of its own, so two apps in one process do not disturb each other.
"""

import asyncio
from dataclasses import dataclass, field
from typing import Annotated, Final, cast

from anyio import CapacityLimiter
from fastapi import Depends, Request

from service.metrics import Metrics
from service.parsing import MAX_CHILDREN
from service.results import Digests
from service.settings import ServiceSettings
from service.wakeups import Wakeups
from worker.queue import Queue, unix_url
from worker.store import Store

OWNER: Final = "local"
"""Whose jobs these are, while there are no keys: one owner for all who can reach the service."""

MIN_FREE_BYTES: Final = 64 << 20
"""Room that the store keeps: a job of usual size fits into it many times; to accept more below asks for trouble."""

_UPLOADS: Final = 8
"""Uploads that are written at once: enough for any disk, and a fraction of the threads that all other answers need."""


@dataclass
class Context:
    """The parts of one app."""

    settings: ServiceSettings
    store: Store
    queue: Queue
    wakeups: Wakeups
    metrics: Metrics
    digests: Digests = field(default_factory=Digests)
    in_flight: set[str] = field(default_factory=set)
    """Idempotency keys of requests that are being answered; touched on the event loop only."""
    parsers: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(MAX_CHILDREN))
    uploads: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_UPLOADS))
    """Threads of uploads: each waits for its client's network, so they are not those that answer everybody else."""

    def reading_queue(self) -> Queue:
        """Return the queue to ask for progress: the real one, or while it is away one that says so at once.

        A view needs Redis only for its rates. With Redis gone, a page of fifty jobs must not wait fifty times for a
        connection to fail.
        """
        return self.queue if self.wakeups.connected else self._no_queue

    def __post_init__(self) -> None:
        # Nobody ever listens at this name: a connection is refused in microseconds.
        self._no_queue = Queue(unix_url(self.store.temporary / "no-queue.sock"))


def build_context(settings: ServiceSettings, store: Store | None = None, queue: Queue | None = None) -> Context:
    """Return the parts of an app; `store` and `queue` replace the real ones in tests."""
    store = store or Store(settings.store)
    url = settings.redis_url
    if queue is None:
        queue = Queue(url or unix_url(store.temporary / "no-queue.sock"))
    return Context(settings=settings, store=store, queue=queue, wakeups=Wakeups(url), metrics=Metrics())


def get_context(request: Request) -> Context:
    """Return the app's context."""
    return cast("Context", request.app.state.context)


InContext = Annotated[Context, Depends(get_context)]
