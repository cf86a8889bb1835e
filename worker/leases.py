"""What is to be done when a lease has ended without its tile.

Job: one policy for the janitor, which sees overdue leases, and the supervisor, which sees dead children.
Invariant: the tile is already back in the index (a script did that); here it is counted, noted, and hinted at again, so
doing this twice costs a hint.
"""

from contextlib import suppress
from typing import Any

import structlog

from worker import jobs
from worker.contract import MAX_TILE_LOSSES
from worker.errors import JobNotFoundError
from worker.queue import Queue
from worker.records import problem
from worker.states import TERMINAL, JobState
from worker.store import Store

log = structlog.get_logger()


def reproduce_line(job_id: str, tile: int | None) -> str:
    """Return the command that does again, alone and in the foreground, what failed."""
    return f"python -m worker.main tile {job_id}" + ("" if tile is None else f" {tile}")


def count_fault(
    store: Store, queue: Queue, job_id: str, tile: int | None, kind: str, *, by: str, **detail: Any
) -> int | None:
    """Count one more "error" or "loss" of a tile (None: the preparation), and note it in the job's history.

    Returns
    -------
    int or None
        How many there were; None if the job has ended meanwhile. Its counts are then removed again: whoever ended it
        did so before this one was counted, and would have left it behind.
    """
    count = queue.count_fault(job_id, tile, kind)
    names = {"error": "errors", "loss": "losses"}
    body = {"tile": tile, **detail, names[kind]: count}
    try:
        event = store.note(job_id, "tile_error" if kind == "error" else "tile_lost", by=by, detail=body)
    except JobNotFoundError:
        event = None
    if event is None:
        queue.forget_job(job_id)
        return None
    return count


def lease_lost(store: Store, queue: Queue, worker: str, job_id: str, tile: int | None, *, by: str) -> None:
    """See to a tile (None: a preparation) whose worker has died or gone silent.

    Parameters
    ----------
    store, queue
        The farm.
    worker
        Who had the lease.
    job_id, tile
        What was leased.
    by
        Who noticed.
    """
    with suppress(JobNotFoundError):
        state = store.last_event(job_id).state
        log.warning("lease lost", worker=worker, job=job_id, tile=tile, state=str(state))
        if state in TERMINAL:
            return
        if state is JobState.CANCELING:
            if queue.stop_job(job_id) == 0:
                jobs.finish_cancel(store, queue, job_id, by=by)
            return
        losses = count_fault(store, queue, job_id, tile, "loss", by=by, worker=worker)
        if losses is None:
            return
        if losses >= MAX_TILE_LOSSES:
            what = "the preparation" if tile is None else f"tile {tile}"
            jobs.fail(
                store,
                queue,
                job_id,
                problem(
                    "worker-lost",
                    "A part of the picture ends its workers",
                    f"{losses} workers were lost with {what}",
                    tile=tile,
                    reproduce=reproduce_line(job_id, tile),
                ),
                by=by,
            )
            return
        priority = store.read_job(job_id).priority
        if tile is None:
            queue.enqueue_prepare(job_id, priority)
        else:
            queue.enqueue_runs(job_id, priority)
