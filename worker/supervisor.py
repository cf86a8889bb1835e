"""The supervisor: the whole farm of one host from one process.

Job: start Valkey (unless one is given), API, workers, steward and assembler; start again what dies; end all of it.
Invariant: all children are started by one thread that lives as long as they (they die with it), and a dead worker's
tile is back in the index as soon as `waitpid` tells.
RQ's own supervisors are not used: they fork a worker a job, or pool workers without leases.
"""

import http.client
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import IO, Self
from urllib.parse import urlsplit

import redis
import structlog

from worker import contract
from worker.embedded import EmbeddedServer
from worker.errors import FarmError, QueueUnavailableError
from worker.files import replace
from worker.identity import check_store
from worker.leases import lease_lost
from worker.processes import born
from worker.queue import Queue
from worker.settings import FarmSettings
from worker.store import Store

log = structlog.get_logger()

# A child that lived this long starts again at once; one that did not waits twice as long each time.
_HEALTHY_S = 5.0
_FIRST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 10.0
# Kernels are compiled on the first start of a version: about a minute on a slow core.
_READY_TIMEOUT_S = 300.0
# A server that starts beside us is up by then; nobody should wait longer for a mistyped address.
_REDIS_TIMEOUT_S = 5.0
_REDIS_PAUSE_S = 0.5


@dataclass(slots=True)
class Child:
    """One process that the supervisor keeps alive."""

    role: str
    name: str
    process: subprocess.Popen[bytes] | None = None
    lease_name: str = ""
    generation: int = 0
    started: float = 0.0
    pause_s: float = 0.0
    restart_at: float | None = None


class Supervisor:
    """The farm of this host; use it as a context manager, or `run` it until a signal.

    Parameters
    ----------
    settings
        Of the farm.
    ready
        Called with the supervisor once everything answers.

    Attributes
    ----------
    url
        Of the API; None without one.
    redis_url
        Of the queue's server.
    """

    def __init__(self, settings: FarmSettings, *, ready: "Callable[[Supervisor], None] | None" = None) -> None:
        self.settings = settings.model_copy(
            update={"store": settings.store.absolute(), "cache": settings.cache.absolute()}
        )
        self.url: str | None = None
        self.redis_url = settings.redis_url or ""
        self.store = Store(self.settings.store)
        self.children: dict[str, Child] = {}
        self._ready = ready
        self._server: EmbeddedServer | None = None
        self._socket: socket.socket | None = None
        self._queue: Queue | None = None
        self._news: queue.SimpleQueue[tuple[str, int] | None] = queue.SimpleQueue()
        self._started = threading.Event()
        self._stopping = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._main, name="supervisor")
        self._log_file: IO[bytes] | None = None
        self._is_announced = False

    # ---- life -------------------------------------------------------------------------------------------------------

    def run(self) -> int:
        """Run the farm until SIGTERM or SIGINT; return the exit status, `error` tells more."""
        stop = threading.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: stop.set())
        try:
            self.start(stop)
        except FarmError as error:
            log.error("not started", error=str(error))  # noqa: TRY400 - the message says it all
            self.close()
            return 1
        while not stop.wait(0.5) and self._thread.is_alive():
            pass
        self.close()
        return 0 if self._error is None else 1

    def start(self, interrupt: threading.Event | None = None) -> Self:
        """Start everything and return when it answers, or when `interrupt` is set.

        Raises
        ------
        FarmError
            It did not come up.
        """
        self._thread.start()
        deadline = time.monotonic() + _READY_TIMEOUT_S
        while not self._started.wait(0.02):
            if interrupt is not None and interrupt.is_set():
                return self
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise self._error if isinstance(self._error, FarmError) else FarmError(f"no start: {self._error}")
        while not self._is_ready():
            if interrupt is not None and interrupt.is_set():
                return self
            if time.monotonic() > deadline or not self._thread.is_alive():
                raise FarmError(f"the farm did not come up in {_READY_TIMEOUT_S:.0f} s")
            time.sleep(0.02)
        if self.settings.ready_file is not None:
            facts = {"url": self.url, "redis_url": self.redis_url, "pid": os.getpid()}
            path = self.settings.ready_file
            replace(path, json.dumps(facts).encode(), path.parent, durable=False)
            self._is_announced = True
        log.info("ready", url=self.url, workers=self.settings.workers)
        if self._ready is not None:
            self._ready(self)
        return self

    def close(self) -> None:
        """End everything: workers give their tiles back; at most about five seconds."""
        self._stopping.set()
        self._news.put(None)
        if self._thread.ident is not None:
            self._thread.join()
        if self._is_announced and self.settings.ready_file is not None:
            self.settings.ready_file.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        try:
            return self.start()
        except BaseException:
            self.close()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @property
    def error(self) -> BaseException | None:
        """What ended the farm, if it did not end as told."""
        return self._error

    @property
    def queue(self) -> Queue:
        """The farm's queue."""
        if self._queue is None:
            raise FarmError("the farm is not started")
        return self._queue

    def pid(self, name: str) -> int:
        """Return the process id of a child: "valkey", "api", "steward", "assembler", "worker-0"..."""
        if name == "valkey" and self._server is not None and self._server.process is not None:
            return self._server.process.pid
        process = self.children[name].process
        if process is None:
            raise FarmError(f"{name} is not running")
        return process.pid

    # ---- the thread that owns the children -------------------------------------------------------------------------

    def _main(self) -> None:
        try:
            self._open()
            self._started.set()
            while not self._stopping.is_set():
                self._turn()
        except BaseException as error:
            self._error = error
            if not isinstance(error, FarmError):
                log.exception("supervisor failed")
        finally:
            self._shut()

    def _open(self) -> None:
        """Start all children for the first time."""
        if self.settings.log_file is not None:
            self._log_file = self.settings.log_file.open("ab")
        if self.settings.redis_url is None:
            self._server = EmbeddedServer(self.settings.store / "valkey")
            self._start_server()
            self.redis_url = self._server.url
        self._queue = Queue(self.redis_url)
        if self._server is None:
            self._await_server(self._queue)
        if self.settings.api:
            address = (self.settings.host, self.settings.port)
            try:
                self._socket = socket.create_server(address, backlog=1024)
            except OSError as error:
                raise FarmError(f"cannot listen at {address[0]}:{address[1]}: {error.strerror}") from error
            # uvicorn takes a descriptor for a unix socket, so nobody turns Nagle's algorithm off for it, and each
            # answer waits 40 ms for the client's delayed acknowledgement. Accepted connections inherit this.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            host, port = self._socket.getsockname()[:2]
            self.url = f"http://{host}:{port}"
        # Workers take longest to come up.
        names = [("worker", f"worker-{index}") for index in range(self.settings.workers)]
        if self.settings.steward:
            names += [("steward", "steward"), ("assembler", "assembler")]
        if self.settings.api:
            names += [("api", "api")]
        for role, name in names:
            child = self.children[name] = Child(role, name)
            self._spawn(child)

    def _await_server(self, to: Queue) -> None:
        """Wait for a server that is not ours; the error names its address, without password. Check whose it is."""
        deadline = time.monotonic() + _REDIS_TIMEOUT_S
        while not self._stopping.is_set():
            try:
                check_store(self.store, to)
            except QueueUnavailableError as error:
                if isinstance(error.__cause__, redis.BusyLoadingError):
                    return  # it is there, and reads its data: each child looks whose it is
                if time.monotonic() > deadline:
                    parts = urlsplit(self.redis_url)
                    address = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
                    raise QueueUnavailableError(f"no Redis can be used at {address}: {error.__cause__}") from error
            else:
                return
            self._stopping.wait(_REDIS_PAUSE_S)

    def _turn(self) -> None:
        """Wait for the next death or restart, and see to it."""
        due = [child.restart_at for child in self.children.values() if child.restart_at is not None]
        timeout = max(0.0, min(due) - time.monotonic()) if due else None
        try:
            news = self._news.get(timeout=timeout)
        except queue.Empty:
            news = None
        if self._stopping.is_set():
            return
        if news is not None:
            name, generation = news
            if name == "valkey":
                log.warning("valkey died")
                self._start_server()
            elif self.children[name].generation == generation:
                self._bury(self.children[name])
        for child in self.children.values():
            if child.restart_at is not None and child.restart_at <= time.monotonic():
                self._spawn(child)

    def _start_server(self) -> None:
        if self._server is not None:
            self._server.start()
            self._watch("valkey", 0, self._server.process)

    def _spawn(self, child: Child) -> None:
        child.generation += 1
        child.restart_at = None
        child.started = time.monotonic()
        # A fresh name each time: a lease must never seem to be renewed by a successor.
        child.lease_name = f"{socket.gethostname()}-{os.getpid()}-{child.name}.{child.generation}"
        descriptors: tuple[int, ...] = ()
        if child.role == "api" and self._socket is not None:
            descriptor = self._socket.fileno()
            descriptors = (descriptor,)
            command = ["uvicorn", "service.app:create_app", "--factory", "--fd", str(descriptor)]
            command += ["--log-level", "warning", "--no-access-log", "--timeout-graceful-shutdown", "3"]
        else:
            command = ["worker.main", child.role]
            command += ["--name", child.lease_name] if child.role == "worker" else []
        child.process = subprocess.Popen(  # noqa: S603 - our own modules
            [sys.executable, "-m", *command],
            stdin=subprocess.DEVNULL,
            stdout=self._log_file,
            stderr=self._log_file,
            env=self._environment(),
            pass_fds=descriptors,
            preexec_fn=born(os.getpid(), nice=self.settings.nice if child.role == "worker" else 0),  # noqa: PLW1509
        )
        self._watch(child.name, child.generation, child.process)

    def _environment(self) -> dict[str, str]:
        """Return what children see: our settings, one thread each."""
        environment = self.settings.child_environment(redis_url=self.redis_url, ready_file=None)
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
            environment[name] = "1"
        return environment

    def _watch(self, name: str, generation: int, process: subprocess.Popen[bytes] | None) -> None:
        """Have a thread wait for the end of a process: the news is here within a millisecond."""

        def wait() -> None:
            if process is not None:
                process.wait()
                self._news.put((name, generation))

        threading.Thread(target=wait, name=f"wait-{name}", daemon=True).start()

    def _bury(self, child: Child) -> None:
        """See to what a dead child leaves behind, and plan its return."""
        lived_s = time.monotonic() - child.started
        code = child.process.returncode if child.process is not None else None
        log.warning("child died", name=child.name, code=code, lived_s=round(lived_s, 2))
        child.process = None
        if lived_s >= _HEALTHY_S:
            child.pause_s = 0.0
        child.restart_at = time.monotonic() + child.pause_s
        child.pause_s = min(max(_FIRST_PAUSE_S, child.pause_s * 2.0), _LONGEST_PAUSE_S)
        if child.role == "worker" and self._queue is not None:
            with suppress(FarmError):
                lease = self._queue.release(child.lease_name)
                self._queue.forget_worker(child.lease_name)
                if lease is not None:
                    lease_lost(self.store, self._queue, child.lease_name, *lease, by="supervisor")

    def _shut(self) -> None:
        """End the children: those who work first, those who keep order next, the server last."""
        for roles in (("worker", "api"), ("steward", "assembler")):
            group = [
                child.process for child in self.children.values() if child.role in roles and child.process is not None
            ]
            for process in group:
                with suppress(ProcessLookupError):
                    process.terminate()
            deadline = time.monotonic() + contract.DRAIN_S
            for process in group:
                try:
                    process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    log.warning("child killed after the drain", pid=process.pid)
                    process.kill()
                    process.wait()
        if self._queue is not None:
            with suppress(FarmError):
                for child in self.children.values():
                    if child.role == "worker":
                        self._queue.release(child.lease_name)
                        self._queue.forget_worker(child.lease_name)
            self._queue.close()
        if self._server is not None:
            self._server.close()
        for resource in (self._socket, self._log_file):
            if resource is not None:
                resource.close()

    # ---- readiness --------------------------------------------------------------------------------------------------

    def _is_ready(self) -> bool:
        """Whether all workers have reported, the index is complete, and the API answers."""
        try:
            names = {worker.name for worker in self.queue.workers() if worker.alive}
            if self.queue.epoch() is None and self.settings.steward:
                return False
        except FarmError:
            return False
        ours = {child.lease_name for child in self.children.values() if child.role == "worker"}
        return ours <= names and (self.url is None or self._answers())

    def _answers(self) -> bool:
        assert self._socket is not None
        host, port = self._socket.getsockname()[:2]
        connection = http.client.HTTPConnection(host, port, timeout=2.0)
        try:
            connection.request("GET", "/healthz")
            return connection.getresponse().status == 200
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()
