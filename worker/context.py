"""What a task can reach: the one object that a worker process is built around.

Job: hold store, queue, backend, the shared cancel flag and what is being worked on.
Invariant: `cancel[0]` belongs to the current job: it is set only under the lock, only for the job that is current, and
cleared when the next begins; while draining it stays set.
A flag polled by kernels is what stops native code.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import structlog

from worker.backends import CanceledError, FarmBackend
from worker.contract import LEASE_TTL_MS
from worker.errors import FarmError, JobNotFoundError, QueueUnavailableError, StaleIndexError
from worker.grid import TileGrid
from worker.queue import Lease, Queue
from worker.settings import FarmSettings
from worker.store import Store

log = structlog.get_logger()

CANCELED = 1
DRAINING = 2

# Compiled scenes are memory-mapped, so a few cost little; jobs that take turns need not be mapped again each second.
_KEPT_SCENES = 4
# A task gives up on a queue that is away for this long; the worker goes on waiting for hints, which the steward brings.
_OUTAGE_S = 120.0


class Prepared(NamedTuple):
    """What a worker keeps of a job that it renders."""

    compiled: Any
    grid: TileGrid
    samples: int
    priority: int


class WorkerContext:
    """State of one worker process, shared by its main and its control thread.

    Parameters
    ----------
    settings
        Of the farm.
    name
        The worker's name, unique in the farm.
    store, queue, backend
        What it works with.
    """

    def __init__(self, settings: FarmSettings, name: str, store: Store, queue: Queue, backend: FarmBackend) -> None:
        self.settings = settings
        self.name = name
        self.store = store
        self.queue = queue
        self.backend = backend
        self.cancel = np.zeros(1, np.int64)
        self.prepared: OrderedDict[str, Prepared] = OrderedDict()
        self.draining = threading.Event()
        self.state = "starting"
        self.started_at = time.time()
        self._lock = threading.Lock()
        self._job: str | None = None
        self._epoch: str | None = None

    # ---- current job and its flag ---------------------------------------------------------------------------------

    @contextmanager
    def working_on(self, job_id: str) -> Iterator[None]:
        """Make a job the current one: from now on a cancel command for it raises the flag."""
        with self._lock:
            self._job = job_id
            self.state = "busy"
            if not self.draining.is_set():
                self.cancel[0] = 0
        try:
            yield
        finally:
            with self._lock:
                self._job = None
                self.state = "draining" if self.draining.is_set() else "idle"

    @property
    def job(self) -> str | None:
        """Id of the current job."""
        return self._job

    def cancel_job(self, job_id: str) -> bool:
        """Raise the flag if that job is the current one."""
        with self._lock:
            is_current = self._job == job_id
            if is_current and not self.draining.is_set():
                self.cancel[0] = CANCELED
            return is_current

    def drain(self) -> None:
        """Stop work: kernels return at once, tiles are given back, the process ends."""
        with self._lock:
            self.draining.set()
            self.cancel[0] = DRAINING
            self.state = "draining"

    def check(self) -> None:
        """Raise `CanceledError` if the flag is up."""
        if self.cancel[0]:
            raise CanceledError

    def remember(self, job_id: str, prepared: Prepared) -> Prepared:
        """Keep a job's compiled scene for its next run."""
        self.prepared[job_id] = prepared
        self.prepared.move_to_end(job_id)
        while len(self.prepared) > _KEPT_SCENES:
            self.prepared.popitem(last=False)
        return prepared

    # ---- the index, patiently -------------------------------------------------------------------------------------

    def lease_next(self, job_id: str, *, finished: int | None, rays: int, kernel_s: float, commit_only: bool) -> Lease:
        """Commit and lease as `Queue.lease_next`, through outages and rebuilds of the index.

        Raises
        ------
        JobNotFoundError
            The job has ended, or the index lost it and has not got it back yet (the finished tile is on disk).
        QueueUnavailableError
            The queue stayed away.
        CanceledError
            While waiting.
        """

        def lease(epoch: str) -> Lease:
            return self.queue.lease_next(
                epoch,
                job_id,
                self.name,
                finished=finished,
                rays=rays,
                kernel_s=kernel_s,
                ttl_ms=0 if commit_only else LEASE_TTL_MS,
            )

        answer: Lease = self._patiently(lease)
        return answer

    def lease_preparation(self, job_id: str) -> bool:
        """Take on a preparation as `Queue.lease_preparation`, through outages and rebuilds of the index."""
        answer: bool = self._patiently(lambda epoch: self.queue.lease_preparation(epoch, job_id, self.name))
        return answer

    def _patiently(self, call: Any) -> Any:
        deadline = time.monotonic() + _OUTAGE_S
        pause_s = 0.02
        while True:
            try:
                if self._epoch is None:
                    self._epoch = self.queue.epoch()
                if self._epoch is not None:
                    return call(self._epoch)
            except StaleIndexError:
                self._epoch = None
                continue
            except JobNotFoundError:
                raise
            except QueueUnavailableError:
                if time.monotonic() > deadline:
                    raise
            if time.monotonic() > deadline:
                raise QueueUnavailableError("the index is not being rebuilt: is a steward running?")
            self.check()
            time.sleep(pause_s)
            pause_s = min(pause_s * 2.0, 0.5)

    def release(self) -> None:
        """Give the current tile back; an outage does the same by the lease's end."""
        try:
            self.queue.release(self.name)
        except FarmError as error:
            log.warning("lease not released", error=str(error))
