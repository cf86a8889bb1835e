"""The queue: hints in RQ and the index of leases and done tiles, in Redis.

Job: everything that is said to Redis; all of it can be rebuilt from the store.
Invariant: enqueued by name, with ids only; no blocking read shares a connection with commands; a method raises
`QueueUnavailableError` when the server does not answer, so that callers need not know Redis.
See ARCHITECTURE.md, "Two ideas carry it".
"""

import json
import secrets
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from redis.exceptions import RedisError, ResponseError
from rq import Queue as RqQueue
from rq.serializers import JSONSerializer

from worker import contract, scripts
from worker.errors import JobNotFoundError, QueueFullError, StaleIndexError
from worker.records import JobEvent
from worker.wire import clear_errors, connect, unix_url, watch

__all__ = ["IndexProgress", "Lease", "Queue", "Sweep", "WorkerInfo", "unix_url", "watch"]


class Lease(NamedTuple):
    """Answer of `Queue.lease_next`: `tile` is None when none is to be had; `done` of `n_tiles` are done."""

    tile: int | None
    done: int
    n_tiles: int


class IndexProgress(NamedTuple):
    """What the index knows of a job: tiles done and in all, rays and kernel seconds since the index was last built."""

    done: int
    n_tiles: int
    rays: int
    kernel_s: float
    stopped: bool


class Sweep(NamedTuple):
    """Answer of `Queue.expire`: the index's epoch ('' if none), the server's run id, and (worker, job, tile) expired.

    `tile` is None for a preparation.
    """

    epoch: str
    server: str
    expired: list[tuple[str, str, int | None]]


class WorkerInfo(NamedTuple):
    """One worker of the registry; it lives if it was heard of less than 5 s ago (judged when read)."""

    name: str
    host: str
    pid: int
    state: str
    job: str | None
    tile: int | None
    started_at: float
    seen_s: float

    @property
    def alive(self) -> bool:
        """Whether it was heard of lately."""
        return self.seen_s < 5.0


class Queue:
    """The farm's side of Redis; safe to share between threads.

    Parameters
    ----------
    url
        redis://, rediss:// or unix:// URL.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.redis = connect(url)
        self._rq = {name: RqQueue(name, connection=self.redis, serializer=JSONSerializer) for name in contract.QUEUES}
        self._script = {
            name: self.redis.register_script(getattr(scripts, name))
            for name in (
                "NEXT PREPARE RELEASE RENEW EXPIRE INIT REDO STOP FORGET CLAIM UNCLAIM".split()  # noqa: SIM905 - reads better
            )
        }

    def close(self) -> None:
        """Close the connections."""
        self.redis.close()

    def ping(self) -> bool:
        """Whether the server answers."""
        try:
            return bool(self.redis.ping())
        except RedisError:
            return False

    # ---- hints ----------------------------------------------------------------------------------------------------

    def enqueue_prepare(self, job_id: str, priority: int = 50) -> None:
        """Hint that a job waits to be prepared."""
        self._enqueue(contract.TASK_PREPARE, job_id, priority, 1)

    def enqueue_runs(self, job_id: str, priority: int = 50, count: int = 1) -> None:
        """Hint that tiles of a job wait: `count` workers may help."""
        self._enqueue(contract.TASK_RENDER_RUN, job_id, priority, count)

    def queue_lengths(self) -> dict[str, int]:
        """Return the number of waiting hints of each queue."""
        with clear_errors():
            pipeline = self.redis.pipeline(transaction=False)
            for name in contract.QUEUES:
                pipeline.llen(f"rq:queue:{name}")
            return dict(zip(contract.QUEUES, pipeline.execute(), strict=True))

    def hints(self) -> set[tuple[str, str]]:
        """Return the (task, job) of all waiting hints."""
        with clear_errors():
            pipeline = self.redis.pipeline(transaction=False)
            for name in contract.QUEUES:
                pipeline.lrange(f"rq:queue:{name}", 0, -1)
            lists = pipeline.execute()
        found = set()
        for raw in (hint for hints in lists for hint in hints):
            kind, _, rest = raw.decode().partition("-")
            found.add((contract.TASK_PREPARE if kind == "p" else contract.TASK_RENDER_RUN, rest.partition("-")[0]))
        return found

    def sweep_hints(self) -> int:
        """Delete records of hints that are in no queue (a worker died between taking and deleting); return how many.

        Call it rarely: it looks at all hints. One that is just being enqueued is in no queue for a moment, so only
        those that are still without a queue after a second look go.
        """
        with clear_errors():
            orphans = self._orphans()
            if orphans:
                time.sleep(0.05)
                orphans &= self._orphans()
            return int(self.redis.delete(*orphans)) if orphans else 0

    def _orphans(self) -> set[bytes]:
        records: set[Any] = set(self.redis.scan_iter("rq:job:*", count=1000))
        queued: set[Any] = set()
        for name in contract.QUEUES:
            hints: Any = self.redis.lrange(f"rq:queue:{name}", 0, -1)
            queued.update(b"rq:job:" + hint for hint in hints)
        return records - queued

    def _enqueue(self, task: str, job_id: str, priority: int, count: int) -> None:
        queue = self._rq[contract.queue_for(priority)]
        letter = "p" if task == contract.TASK_PREPARE else "r"
        with clear_errors():
            for _ in range(count):
                queue.enqueue_call(
                    task,
                    args=(job_id,),
                    job_id=f"{letter}-{job_id}-{secrets.token_hex(4)}",
                    timeout=contract.JOB_TIMEOUT_S,
                    result_ttl=contract.RESULT_TTL_S,
                    failure_ttl=contract.FAILURE_TTL_S,
                    description=task,
                )

    # ---- leases ---------------------------------------------------------------------------------------------------

    def epoch(self) -> str | None:
        """Return the index's epoch; None while it is wiped or being rebuilt."""
        with clear_errors():
            value = self.redis.get(contract.KEY_EPOCH)
        return value.decode() if value is not None else None  # type: ignore[union-attr]

    def lease_next(
        self,
        epoch: str,
        job_id: str,
        worker: str,
        *,
        finished: int | None = None,
        rays: int = 0,
        kernel_s: float = 0.0,
        ttl_ms: int = contract.LEASE_TTL_MS,
    ) -> Lease:
        """Commit the finished tile, if any, and lease the next one, in one step.

        Raises
        ------
        StaleIndexError
            The index was wiped or rebuilt: nothing happened; ask for the epoch and call again.
        JobNotFoundError
            The index does not know the job (it has ended, or is not prepared).
        QueueUnavailableError
        """
        tile = -1 if finished is None else finished
        answer = self._run("NEXT", epoch, job_id, worker, ttl_ms, tile, rays, round(kernel_s * 1e6))
        if answer[0] == -3:
            raise StaleIndexError
        if answer[0] == -2:
            raise JobNotFoundError(f"job {job_id} is not in the index")
        return Lease(None if answer[0] < 0 else int(answer[0]), int(answer[1]), int(answer[2]))

    def lease_preparation(self, epoch: str, job_id: str, worker: str, *, ttl_ms: int = contract.LEASE_TTL_MS) -> bool:
        """Take on the preparation of a job; False while another live worker has it. `StaleIndexError` as above."""
        answer = int(self._run("PREPARE", epoch, job_id, worker, ttl_ms))
        if answer == -3:
            raise StaleIndexError
        return answer == 1

    def release(self, worker: str) -> tuple[str, int | None] | None:
        """End a worker's lease and give its tile back; return (job, tile) or None if it had none."""
        lease = self._run("RELEASE", worker)
        return _split_lease(lease.decode()) if lease else None

    def renew(self, workers: Iterable[str], *, ttl_ms: int = contract.LEASE_TTL_MS) -> set[str]:
        """Renew the leases of workers; return those that have none (any more)."""
        return {name.decode() for name in self._run("RENEW", ttl_ms, *workers)}

    def expire(self, limit: int = 1000) -> Sweep:
        """End overdue leases and give their tiles back."""
        answer = [part.decode() for part in self._run("EXPIRE", limit)]
        expired = []
        for line in answer[2:]:
            worker, lease = line.split(" ", 1)
            expired.append((worker, *_split_lease(lease)))
        return Sweep(answer[0], answer[1], expired)

    def leases(self) -> dict[str, tuple[str, int | None]]:
        """Return worker -> (job, tile) of all leases; tile None is a preparation."""
        with clear_errors():
            raw = self.redis.hgetall(contract.KEY_LEASES)
        return {name.decode(): _split_lease(lease.decode()) for name, lease in raw.items()}  # type: ignore[union-attr]

    def count_fault(self, job_id: str, tile: int | None, kind: str) -> int:
        """Count one more "error" or "loss" of a tile (None: the preparation) and return how many there were."""
        field = f"{kind[0]}{'p' if tile is None else tile}"
        with clear_errors():
            pipeline = self.redis.pipeline()
            pipeline.hincrby(contract.KEY_FAULTS + job_id, field, 1)
            # A job that never gets into the index (its preparation kills workers) must not leave this behind.
            pipeline.expire(contract.KEY_FAULTS + job_id, 7 * 86_400)
            return int(pipeline.execute()[0])

    # ---- the index ------------------------------------------------------------------------------------------------

    def init_job(
        self, job_id: str, n_tiles: int, columns: int, done: Iterable[int] = (), *, stopped: bool = False
    ) -> bool:
        """Put a job into the index, or add done tiles to it; True if it was not there."""
        bits = bytearray((n_tiles + 7) // 8)
        for tile in done:
            bits[tile >> 3] |= 0x80 >> (tile & 7)
        state = "c" if stopped else "r"
        return bool(self._run("INIT", job_id, n_tiles, columns, state, bytes(bits)))

    def redo_tile(self, job_id: str, tile: int) -> bool:
        """Hand out again a tile whose file was damaged; False if the index does not know the job."""
        return bool(self._run("REDO", job_id, tile))

    def stop_job(self, job_id: str) -> int:
        """Hand out no more tiles of a job and stop the kernels that render it; return its number of live leases."""
        return int(self._run("STOP", job_id))

    def forget_job(self, job_id: str) -> None:
        """Remove a job from the index."""
        self._run("FORGET", job_id)

    def active_jobs(self) -> set[str]:
        """Return the ids of the jobs in the index."""
        with clear_errors():
            return {name.decode() for name in self.redis.smembers(contract.KEY_ACTIVE)}  # type: ignore[union-attr]

    def progress(self, job_id: str) -> IndexProgress | None:
        """Return a job's progress, or None if the index does not know it."""
        with clear_errors():
            answer: Any = self.redis.hmget(contract.KEY_JOB + job_id, "done", "n", "rays", "kernel_us", "state")
        if answer[1] is None:
            return None
        done, n_tiles, rays, kernel_us = (int(value or 0) for value in answer[:4])
        return IndexProgress(done, n_tiles, rays, kernel_us / 1e6, answer[4] == b"c")

    def has_free_tiles(self, job_id: str) -> bool:
        """Whether a lease of this job could be had now."""
        with clear_errors():
            pipeline = self.redis.pipeline(transaction=False)
            pipeline.hmget(contract.KEY_JOB + job_id, "n", "next", "state")
            pipeline.scard(contract.KEY_RETRY + job_id)
            (n_tiles, cursor, state), n_retry = pipeline.execute()
        return state == b"r" and (n_retry > 0 or int(cursor) < int(n_tiles))

    def set_epoch(self, server: str) -> str:
        """Declare the index complete under a new epoch; `server` is the run id that `expire` told."""
        epoch = f"{server[:12]}-{secrets.token_hex(4)}"
        with clear_errors():
            self.redis.set(contract.KEY_EPOCH, epoch)
        return epoch

    def claim(self, job_id: str, owner: str, ttl_ms: int = contract.LEASE_TTL_MS) -> bool:
        """Take or renew the right to assemble a job; False while another has it."""
        return bool(self._run("CLAIM", job_id, owner, ttl_ms))

    def unclaim(self, job_id: str, owner: str) -> None:
        """Give up the right to assemble a job."""
        self._run("UNCLAIM", job_id, owner)

    # ---- workers --------------------------------------------------------------------------------------------------

    def report_worker(self, name: str, facts: Mapping[str, Any]) -> None:
        """Say that a worker lives; `facts` has host, pid, state and started_at (its lease tells job and tile)."""
        with clear_errors():
            seconds, micros = self.redis.time()
            body = json.dumps({**facts, "at": seconds + micros / 1e6})
            self.redis.hset(contract.KEY_WORKERS, name, body)

    def forget_worker(self, name: str) -> None:
        """Remove a worker that is gone."""
        with clear_errors():
            self.redis.hdel(contract.KEY_WORKERS, name)

    def workers(self) -> list[WorkerInfo]:
        """Return all workers of the registry, the dead ones too (`alive` is judged here and now)."""
        with clear_errors():
            pipeline = self.redis.pipeline(transaction=False)
            pipeline.time()
            pipeline.hgetall(contract.KEY_WORKERS)
            pipeline.hgetall(contract.KEY_LEASES)
            (seconds, micros), raw, leases = pipeline.execute()
        found = []
        for name, body in raw.items():
            facts = json.loads(body)
            job, tile = _split_lease(leases[name].decode()) if name in leases else (None, None)
            found.append(
                WorkerInfo(
                    name.decode(),
                    str(facts.get("host", "")),
                    int(facts.get("pid", 0)),
                    str(facts.get("state", "")),
                    job,
                    tile,
                    float(facts.get("started_at", 0.0)),
                    max(0.0, seconds + micros / 1e6 - float(facts.get("at", 0.0))),
                )
            )
        return sorted(found)

    def count_workers(self) -> int:
        """Return the number of workers in the registry (the dead leave it within a minute)."""
        with clear_errors():
            return int(self.redis.hlen(contract.KEY_WORKERS))

    # ---- wake-ups -------------------------------------------------------------------------------------------------

    def publish_event(self, job_id: str, event: JobEvent) -> None:
        """Tell whoever waits that a job has a new event; silently nothing when the server is away (they poll, too)."""
        with suppress(RedisError):
            self.redis.publish(contract.CHANNEL_EVENTS, f"{job_id} {event.seq} {event.state}")

    def wake_assembler(self, job_id: str) -> None:
        """Tell the assembler to look at a job."""
        with clear_errors():
            self.redis.publish(contract.CHANNEL_ASSEMBLER, job_id)

    # ---- inside ---------------------------------------------------------------------------------------------------

    def _run(self, name: str, *arguments: Any) -> Any:
        with clear_errors():
            try:
                return self._script[name](args=arguments)
            except ResponseError as error:
                if "OOM" in str(error):
                    raise QueueFullError from error
                raise


def _split_lease(lease: str) -> tuple[str, int | None]:
    job, tile = lease.rsplit("/", 1)
    return job, None if tile == "p" else int(tile)
