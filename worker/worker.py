"""The RQ worker: takes hints, calls our two tasks, keeps nothing in Redis.

Job: wait for a hint, check it, run its task in this process (kernels are warm here).
Invariant: only the names in `contract.TASKS` are ever called, with one job id as their argument; a hint's record is
deleted before its task begins, so RQ's keys do not grow and a killed worker leaves none behind.
RQ's own bookkeeping (executions, registries, results, heartbeats: about ten calls a job) is left out, because the store
and the leases know better.
"""

from datetime import UTC, datetime
from typing import Any

import redis
import structlog
from rq import SimpleWorker
from rq.exceptions import DeserializationError, StopRequested
from rq.job import Job
from rq.queue import Queue as RqQueue
from rq.serializers import JSONSerializer

from worker import contract
from worker.context import WorkerContext
from worker.errors import FarmError
from worker.records import check_job_id
from worker.wire import connect

log = structlog.get_logger()


class FarmWorker(SimpleWorker):
    """One worker process' main loop.

    Parameters
    ----------
    context
        Of this worker. The connection for waiting is the worker's own: its read timeout is longer than its wait.
    """

    # After a blip, look again each second; RQ would double its pause up to a minute.
    exponential_backoff_factor = 1.0
    log_result_lifespan = False

    def __init__(self, context: WorkerContext) -> None:
        self.context = context
        super().__init__(
            list(contract.QUEUES),
            name=context.name,
            connection=connect(context.queue.url, timeout_s=60.0),
            serializer=JSONSerializer,
            worker_ttl=20,  # RQ waits 15 s less than this for a hint, so a half-open connection is noticed
            log_job_description=False,
        )

    def execute_job(self, job: Job, queue: RqQueue) -> None:
        """Run one hint's task; whatever it raises ends here."""
        del queue
        self.connection.delete(job.key)
        call = self._parse(job)
        if call is None:
            return
        task, job_id = call
        from worker import tasks

        try:
            getattr(tasks, task.rpartition(".")[2])(self.context, job_id)
        except FarmError as error:
            log.warning("task ended early", task=task, job=job_id, error=str(error))
            self.context.release()  # else others take the tile for being worked on until the lease runs out
        except Exception:
            log.exception("task failed", task=task, job=job_id)
            self.context.release()
        if self.context.draining.is_set():
            self._stop_requested = True

    def _parse(self, job: Job) -> tuple[str, str] | None:
        """Return (task, job id) of a hint that is one of ours, else None."""
        try:
            task, arguments = job.func_name, list(job.args)
            if task in contract.TASKS and len(arguments) == 1 and not job.kwargs:
                return task, check_job_id(arguments[0])
        except (DeserializationError, FarmError, TypeError, ValueError, AttributeError) as error:
            log.warning("hint refused", error=str(error))
            return None
        log.warning("hint refused", task=str(task)[:100])
        return None

    def request_stop(self, signum: Any, frame: Any) -> None:
        """Python's part of SIGTERM: leave the wait for a hint (the signal thread has raised the flag already)."""
        del signum, frame
        self._stop_requested = True
        self.context.drain()
        if self.context.job is None:
            raise StopRequested

    # ---- RQ's bookkeeping, left out ---------------------------------------------------------------------------------

    def register_birth(self) -> None:
        """RQ's registry of workers is not kept: it forgets all of them on FLUSHALL; `Queue.report_worker` does it."""
        self.birth_date = self.last_heartbeat = datetime.now(UTC)

    def register_death(self) -> None:
        """Nothing to take back."""

    def subscribe(self) -> None:
        """RQ's remote commands are off; `worker.control` listens on our own channel."""

    def unsubscribe(self) -> None:
        """Nothing to take back."""

    def heartbeat(self, timeout: int | None = None, pipeline: Any = None) -> None:
        """Nothing: the control thread says each second that the worker lives."""
        del timeout, pipeline

    def set_state(self, state: str, pipeline: Any = None) -> None:
        """Keep the state in this process only."""
        del pipeline
        self._state = state

    def check_for_suspension(self, burst: bool) -> None:
        """RQ's suspension is not used; a look at the stop request instead."""
        del burst
        if self.context.draining.is_set():
            self._stop_requested = True

    def run_maintenance_tasks(self) -> None:
        """Nothing to maintain."""
        self.last_cleaned_at = datetime.now(UTC)  # type: ignore[assignment]

    def get_redis_server_version(self) -> tuple[int, int, int]:
        """Spare a call."""
        return (7, 2, 0)

    def _set_ip_address(self, connection: "redis.Redis") -> None:
        del connection
        self.ip_address = "unknown"
