"""The threads beside the kernel: one keeps the lease and listens, one hears signals.

Job: renew the lease of the current job each second, tell that the worker lives, raise the cancel flag on command or on
SIGTERM.
Invariant: nothing that Redis does or fails to do ends these threads; signals reach them while a kernel holds the main
thread, because the C-level handler writes to a file descriptor (`signal.set_wakeup_fd`).
"""

import os
import signal
import socket
import threading
import time
from typing import Any

import redis
import structlog

from worker import contract
from worker.context import WorkerContext
from worker.errors import QueueError, WrongStoreError
from worker.identity import check_store
from worker.wire import connect

log = structlog.get_logger()


class ControlThread(threading.Thread):
    """Renews and listens until `stop` is called.

    Parameters
    ----------
    context
        Of this worker; its queue's connection pool is shared, the listening connection is this thread's own.
    """

    def __init__(self, context: WorkerContext) -> None:
        super().__init__(name="control", daemon=True)
        self._context = context
        self._stopped = threading.Event()
        self._host = socket.gethostname()
        self._client = connect(context.queue.url, timeout_s=None)

    def stop(self) -> None:
        """End the thread within a second."""
        self._stopped.set()

    def run(self) -> None:
        """Listen; between messages, renew each second."""
        pubsub: Any = None
        next_renewal = 0.0
        while not self._stopped.is_set():
            wait_s = next_renewal - time.monotonic()
            if wait_s <= 0.0:
                next_renewal = time.monotonic() + contract.RENEW_EVERY_S
                self._renew()
                continue
            try:
                if pubsub is None:
                    pubsub = self._client.pubsub(ignore_subscribe_messages=True)  # type: ignore[no-untyped-call]
                    pubsub.subscribe(contract.CHANNEL_CONTROL)
                message = pubsub.get_message(timeout=wait_s)
                if message is not None:
                    self._obey(message["data"].decode())
            except (redis.RedisError, OSError) as error:
                log.warning("control connection lost", error=str(error))
                if pubsub is not None:
                    pubsub.close()
                pubsub = None
                self._stopped.wait(min(wait_s, 0.25))

    def _renew(self) -> None:
        context = self._context
        try:
            check_store(context.store, context.queue)
            job = context.job
            # A lease of no current job was left by a task that ended badly: it must run out.
            if job is not None and context.name in context.queue.renew([context.name]):
                log.debug("no lease to renew", job=job)
            context.queue.report_worker(
                context.name,
                {"host": self._host, "pid": os.getpid(), "state": context.state, "started_at": context.started_at},
            )
            # A command may have been published while this connection was down: the index says it again.
            if job is not None:
                progress = context.queue.progress(job)
                if progress is not None and progress.stopped:
                    context.cancel_job(job)
        except WrongStoreError as error:
            log.error("wrong store", error=str(error))  # noqa: TRY400 - the message says it all
            os.kill(os.getpid(), signal.SIGTERM)  # the service came up after this worker: end as if told to
        except QueueError as error:
            log.warning("lease not renewed", error=str(error))

    def _obey(self, message: str) -> None:
        command, _, target = message.partition(" ")
        if command == "cancel" and self._context.cancel_job(target):
            log.info("cancel", job=target)


class SignalThread(threading.Thread):
    """Drains the worker on SIGTERM or SIGINT, even while a kernel keeps Python's own handlers from running."""

    def __init__(self, context: WorkerContext) -> None:
        super().__init__(name="signals", daemon=True)
        self._context = context
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)

    def run(self) -> None:
        """Wait for the bytes that signals leave."""
        while True:
            received = self._reader.recv(64)
            if not received:
                return
            if {signal.SIGTERM, signal.SIGINT} & set(received):
                self._context.drain()
