"""Following a job: server-sent events tell changes of state at once, and the progress in between.

A thread listens to the event stream and resumes it with `Last-Event-ID` after a break; where streams do not get through
(proxies that hold them back), polling alone is enough, only a little later.
Invariant: the last job yielded is the terminal one, unless an error is raised.
"""

import contextlib
import json
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from client.errors import NotReachableError, SmaltiError, TimedOutError
from client.http import httpx
from client.models import Job, Progress
from client.sse import ServerEvent, parse_events
from client.transport import Transport

POLL_S = 0.5  # without a stream
QUIET_S = 3.0  # with a stream: the service tells progress twice a second, so silence this long is worth a look
KEEP_ALIVE_S = 15.0  # the service sends a comment this often; three missed ones mean a dead connection
STREAM_FAILURES = 4  # streams in a row without one event, before polling has to do
POLL_FAILURES = 5  # in a row, each already tried several times by the transport


class EventListener:
    """Listens to a job's event stream in a thread of its own.

    Parameters
    ----------
    path : str
        Path of the stream.

    Attributes
    ----------
    arrived : queue.Queue of ServerEvent
        What came.
    """

    def __init__(self, transport: Transport, path: str) -> None:
        self.arrived: queue.Queue[ServerEvent] = queue.Queue()
        self._transport = transport
        self._path = path
        self._last_id: str | None = None
        self._response: httpx.Response | None = None
        self._stopped = threading.Event()
        self._is_over = False
        self._thread = threading.Thread(target=self._run, name="smalti-events", daemon=True)

    @property
    def is_alive(self) -> bool:
        """Whether it listens, or will again."""
        return not self._is_over

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def stop(self) -> None:
        """Stop listening: wakes the thread out of its read."""
        self._stopped.set()
        response = self._response
        stream = response.extensions.get("network_stream") if response is not None else None
        if stream is not None:
            connection: Any = stream.get_extra_info("socket")
            with contextlib.suppress(OSError, AttributeError):
                connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        failures = 0
        try:
            while failures < STREAM_FAILURES and not self._stopped.is_set():
                try:
                    failures = 0 if self._listen() else failures + 1
                except httpx.HTTPError:
                    failures += 1
                if not self._stopped.is_set():
                    self._transport.pause(failures)
        except (SmaltiError, OSError, RuntimeError):
            pass  # refused, or the client was closed: no stream here
        finally:
            self._is_over = True
            self.arrived.put(ServerEvent())  # so that whoever waits goes over to polling

    def _listen(self) -> bool:
        """Read one stream to its end; returns whether an event came."""
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-cache"}
        if self._last_id is not None:
            headers["Last-Event-ID"] = self._last_id
        came = False
        with self._transport.stream(self._path, headers=headers, read_timeout_s=3 * KEEP_ALIVE_S) as response:
            self._response = response
            if not response.headers.get("Content-Type", "").startswith("text/event-stream"):
                raise RuntimeError("not an event stream")
            for event in parse_events(response.iter_raw()):
                if self._stopped.is_set():
                    break
                self._last_id = event.id if event.id is not None else self._last_id
                came = True
                self.arrived.put(event)
        return came


def watch(
    transport: Transport,
    path: str,
    status: Callable[[str], Job],
    job_id: str,
    *,
    timeout_s: float | None = None,
    poll_s: float = POLL_S,
    quiet_s: float = QUIET_S,
) -> Iterator[Job]:
    """Yield a job now and whenever its state or progress changes, until it ends.

    Parameters
    ----------
    path : str
        Path of the job's URL.
    status : callable
        Fetches the job.
    timeout_s : float, optional
        Longest time to follow it.
    poll_s : float
        Seconds between two looks without a stream.
    quiet_s : float
        Seconds without an event, after which to look in spite of a stream.

    Raises
    ------
    TimedOutError
        When the job has not ended in time.
    NotReachableError
        When the service stays away.
    """
    deadline = time.monotonic() + timeout_s if timeout_s is not None else float("inf")
    job = status(job_id)
    yield job
    if job.is_terminal:
        return
    listener = EventListener(transport, f"{path}/events")
    listener.start()
    failures = 0
    try:
        while not job.is_terminal:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                raise TimedOutError(
                    f"job {job_id} has not ended in {timeout_s:g} s; it is {job.state} and goes on",
                    hint=f"wait longer with `smalti watch {job_id}`",
                )
            events = _wait_for_events(listener, min(quiet_s if listener.is_alive else poll_s, left_s))
            progress = _progress_in(events)
            if progress is not None:
                job = replace(job, state="rendering", progress=progress)
                yield job
                continue
            try:
                job = status(job_id)
                failures = 0
            except NotReachableError:
                failures += 1
                if failures >= POLL_FAILURES:
                    raise
                continue
            yield job
    finally:
        listener.stop()


def _wait_for_events(listener: EventListener, longest_s: float) -> list[ServerEvent]:
    """Wait for an event; returns all that are there, or none after a while."""
    events = []
    with contextlib.suppress(queue.Empty):
        events.append(listener.arrived.get(timeout=longest_s))
        while True:
            events.append(listener.arrived.get_nowait())
    return events


def _progress_in(events: list[ServerEvent]) -> Progress | None:
    """Return the progress if that is all the events tell; otherwise the job has to be asked for."""
    if not events or any(event.event != "progress" for event in events):
        return None
    try:
        data = json.loads(events[-1].data)
    except ValueError:
        return None
    if not isinstance(data, dict) or not isinstance(data.get("progress"), dict):
        return None
    return Progress.parse(data["progress"])
