"""The steward: janitor of leases and reconciler of the index with the store.

Job: every half second end overdue leases; at boot, when the index is wiped or its server restarted, and every few
seconds for jobs that stand still: bring the index in line with the store.
Invariant: it only ever adds what the store says (jobs, done tiles, hints) and removes what has ended, so it may run
twice, late, or be killed at any moment. Terminal jobs are opened once and then remembered, also across restarts.
See ARCHITECTURE.md, "Two ideas carry it".
"""

import threading
import time
from contextlib import suppress
from datetime import UTC, datetime

import structlog

from worker import contract, jobs
from worker.errors import BadNameError, DamagedRecordError, FarmError, JobNotFoundError, QueueError, WrongStoreError
from worker.grid import grid_of
from worker.identity import claim_store
from worker.leases import lease_lost
from worker.queue import Queue
from worker.records import JobEvent
from worker.states import TERMINAL, JobState
from worker.store import Store

log = structlog.get_logger()

_SWEEP_EVERY_S = 60.0
_ABANDONED_S = 3600.0
_FORGET_WORKER_S = 60.0
# A queued job whose cancel was cut short is found when its hint comes up, or after this many looks.
_HINTED_EVERY = 10


class Steward:
    """One per host; several on one farm do no harm.

    Parameters
    ----------
    store, queue
        The farm.
    name
        For events.
    """

    def __init__(self, store: Store, queue: Queue, name: str = "steward") -> None:
        self._store, self._queue, self._name = store, queue, name
        self._stopped = threading.Event()
        self._ended = store.read_checkpoint()
        self._saved = len(self._ended)

    def stop(self) -> None:
        """Leave the loop."""
        self._stopped.set()

    def run(self) -> None:
        """Tick until stopped."""
        next_look = next_sweep = 0.0
        n_looks = 0
        while not self._stopped.is_set():
            try:
                is_fresh = self.tick()
                if time.monotonic() >= next_look and not is_fresh:
                    n_looks += 1
                    self.reconcile(hinted=n_looks % _HINTED_EVERY == 0)
                if time.monotonic() >= next_look or is_fresh:
                    next_look = time.monotonic() + contract.RECONCILE_EVERY_S
                if time.monotonic() >= next_sweep:
                    next_sweep = time.monotonic() + _SWEEP_EVERY_S
                    self.sweep()
            except QueueError as error:
                log.warning("queue away", error=str(error))
            except WrongStoreError as error:
                log.error("wrong store", error=str(error))  # noqa: TRY400 - the message says it all
            except Exception:
                log.exception("steward stumbled")
            self._stopped.wait(contract.JANITOR_EVERY_S)
        self._save()

    def tick(self) -> bool:
        """End overdue leases; rebuild the index if it is not complete, and return whether that was so.

        Raises
        ------
        WrongStoreError
            The index is about another store's jobs, and not to be touched.
        """
        claim_store(self._store, self._queue)
        sweep = self._queue.expire()
        for worker, job_id, tile in sweep.expired:
            try:
                lease_lost(self._store, self._queue, worker, job_id, tile, by=self._name)
            except QueueError:
                raise
            except Exception:  # one unreadable job must not stop the farm; its tile is free again already
                log.exception("lost lease not seen to", job=job_id, tile=tile)
        # An epoch that another server process wrote came back from its file, up to a second of writes short.
        if sweep.epoch and sweep.epoch.startswith(sweep.server[:12]):
            return False
        started = time.perf_counter()
        n_jobs = self.reconcile(everything=True)
        # Only for the server that was rebuilt; if it was restarted meanwhile, the next tick does it again.
        self._queue.set_epoch(sweep.server)
        log.info("index rebuilt", jobs=n_jobs, seconds=round(time.perf_counter() - started, 3))
        return True

    # ---- reconcile --------------------------------------------------------------------------------------------------

    def reconcile(self, *, everything: bool = False, hinted: bool = False) -> int:
        """Compare store and index.

        Parameters
        ----------
        everything
            Take nothing in the index for granted; else only see to jobs that stand still.
        hinted
            Open also jobs whose preparation is hinted at.

        Returns
        -------
        int
            Number of jobs that have not ended.
        """
        queue = self._queue
        hints = queue.hints()
        leased = {(job_id, tile is None) for job_id, tile in queue.leases().values()}
        in_index = queue.active_jobs()
        n_open = 0
        stored = set(self._store.job_names())
        for job_id in sorted(stored - (self._ended - in_index)):
            if not (everything or hinted) and (contract.TASK_PREPARE, job_id) in hints:
                n_open += 1  # its turn will come: ten thousand waiting jobs are not opened every few seconds
                continue
            try:
                event = self._store.last_event(job_id)
                if event.state in TERMINAL:
                    self._end(job_id, is_indexed=job_id in in_index)
                    continue
                n_open += 1
                self._see_to(job_id, event, hints, leased, in_index, everything=everything)
            except (JobNotFoundError, BadNameError):
                continue
            except QueueError:
                raise
            except DamagedRecordError as error:
                log.error("job damaged", job=job_id, error=str(error))  # noqa: TRY400 - the message says it all
            except Exception:  # a file gone, EACCES, EIO: one unreadable job must not keep the index from its epoch
                log.exception("job unreadable", job=job_id)
        for job_id in in_index - stored:
            if not self._store.has_job(job_id):
                queue.forget_job(job_id)
        self._ended &= stored
        return n_open

    def _see_to(
        self,
        job_id: str,
        event: JobEvent,
        hints: set[tuple[str, str]],
        leased: set[tuple[str, bool]],
        in_index: set[str],
        *,
        everything: bool,
    ) -> None:
        """Give one open job what it lacks."""
        store, queue = self._store, self._queue
        if event.state is JobState.CANCELING:
            if queue.stop_job(job_id) == 0:
                jobs.finish_cancel(store, queue, job_id, by=self._name)
            return
        is_old = (datetime.now(UTC) - datetime.fromisoformat(event.at)).total_seconds() > contract.STALLED_AFTER_S
        if not (everything or is_old):
            return
        if event.state in {JobState.QUEUED, JobState.PREPARING}:
            if (contract.TASK_PREPARE, job_id) not in hints and (job_id, True) not in leased:
                log.info("prepare again", job=job_id)
                queue.enqueue_prepare(job_id, store.read_job(job_id).priority)
            return
        is_hinted = (contract.TASK_RENDER_RUN, job_id) in hints
        if not everything and job_id in in_index:
            progress = queue.progress(job_id)
            if progress is not None and progress.done < progress.n_tiles:
                if is_hinted or not self._idle_workers():
                    return
                if (job_id, False) in leased:
                    # Others work on it; an idle worker (fresh, or back after a blip) may join if there is work left.
                    if queue.has_free_tiles(job_id):
                        queue.enqueue_runs(job_id, store.read_job(job_id).priority)
                    return
        self._index(job_id)
        queue.wake_assembler(job_id)
        progress = queue.progress(job_id)
        if progress is not None and progress.done < progress.n_tiles and not is_hinted:
            log.info("render again", job=job_id, done=progress.done, n_tiles=progress.n_tiles)
            count = min(progress.n_tiles - progress.done, max(1, queue.count_workers()))
            queue.enqueue_runs(job_id, store.read_job(job_id).priority, count)

    def _index(self, job_id: str) -> None:
        """Put a job that is being rendered into the index, with the tiles that are on disk and no others."""
        grid = grid_of(self._store.read_job(job_id))
        # Read before the folder is: a tile is written before it is counted, so a surplus means that a file is gone.
        before = self._queue.progress(job_id)
        done = [tile for tile in self._store.done_tiles(job_id) if tile < grid.n_tiles]
        self._queue.init_job(job_id, grid.n_tiles, grid.columns, done)
        if before is not None and before.done > len(done):
            log.warning("done tiles without a file", job=job_id, n_tiles=before.done - len(done))
            for tile in sorted(set(range(grid.n_tiles)) - set(done)):
                self._queue.redo_tile(job_id, tile)  # one in flight is rendered twice: harmless

    def _end(self, job_id: str, *, is_indexed: bool) -> None:
        """Clean up after a job that has ended, and open it no more."""
        if is_indexed:
            self._queue.forget_job(job_id)
        self._store.delete_tiles(job_id)
        self._store.delete_assemblies(job_id)
        self._ended.add(job_id)

    def _idle_workers(self) -> int:
        return sum(worker.alive and worker.state == "idle" for worker in self._queue.workers())

    # ---- housekeeping -----------------------------------------------------------------------------------------------

    def sweep(self) -> None:
        """Remove what crashes leave behind, and save what is known."""
        with suppress(FileNotFoundError):
            self._store.sweep(_ABANDONED_S)
        self._queue.sweep_hints()
        for worker in self._queue.workers():
            if worker.seen_s > _FORGET_WORKER_S:
                self._queue.forget_worker(worker.name)
        self._save()

    def _save(self) -> None:
        if len(self._ended) != self._saved:
            with suppress(OSError, FarmError):
                self._store.write_checkpoint(self._ended)
                self._saved = len(self._ended)
