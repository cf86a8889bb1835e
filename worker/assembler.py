"""The assembler: one process that turns tiles into pictures.

Job: for each active job, read tiles in order, stream their rows into EXR and PNG, and commit. A job that will soon be
rendered is left alone until its last tile is there: encoding would take the cores from its kernels, and afterwards
has all of them. A longer one is encoded while the rest of it is being rendered.
Invariant: memory is one row of tiles and four bands of 64 rows a job, 12 bytes a pixel; it may be killed at any moment
and begins anew from the tiles on disk; the result is committed before the state says so, and tiles are deleted only
after that.
See ARCHITECTURE.md, "One datum's way".
"""

import os
import shutil
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np
import redis
import structlog
from numpy.typing import NDArray

from tracer.film.develop import develop
from tracer.film.errors import ImageWriteError, TileError
from tracer.film.preview import Preview
from tracer.film.tile import Rect, decode_tile
from tracer.film.writer import FilmWriter
from worker import contract, files, jobs
from worker.contract import PREVIEW_PNG, REPORT, RESULT_EXR, RESULT_PNG
from worker.errors import FarmError, IllegalTransitionError, JobNotFoundError, QueueError, StoreFullError
from worker.grid import grid_of
from worker.leases import count_fault
from worker.queue import Queue
from worker.records import JobEvent, now, problem, seconds_between
from worker.report import TileTotals, build_report, summarize
from worker.settings import count_cores
from worker.states import JobState
from worker.store import Store
from worker.wire import connect

log = structlog.get_logger()

# Looked at even without a wake-up: a lost message costs this much.
_POLL_S = 1.0
# How long a claim lasts. It is renewed at each look and with each row of tiles, so a row must fit, and the commit (two
# files brought to a slow disk). Not longer: the jobs of a killed assembler wait this long for another.
_CLAIM_MS = 10_000
# A job with less than this left to render waits for its last tile: that costs its end 0.1 s a megapixel on two cores.
_STREAM_FROM_S = 10.0
# Jobs take turns, so that a small one is not kept waiting by a large one.
_TURN_S = 0.2
# A preview of 512 px costs about 10 ms: 0.5 % of a core.
_PREVIEW_EVERY_S = 2.0


class Assembly:
    """One job's picture in the making.

    Parameters
    ----------
    store, queue
        The farm.
    job_id
        A job that has a plan, and on which the caller has won the claim.
    owner
        Name of this assembler, for events.
    """

    def __init__(self, store: Store, queue: Queue, job_id: str, owner: str) -> None:
        self.job_id = job_id
        self._store, self._queue, self._owner = store, queue, owner
        self.record = store.read_job(job_id)
        self._grid = grid_of(self.record)
        self._samples = self.record.samples
        self._totals = TileTotals()
        self._next = 0
        # The claim is ours, so whoever had one of these is dead or has lost the job.
        store.delete_assemblies(job_id)
        self._folder = store.assembly_folder(job_id)
        self._color_space = self.record.output["png_color_space"]
        self._writer: FilmWriter | None = None
        self._preview = Preview(
            Rect(self._grid.x, self._grid.y, self._grid.width, self._grid.height), contract.PREVIEW_MAX_PX
        )
        self._previewed_at = time.monotonic()
        self._row: NDArray[np.float32] | None = None
        self._spent_s = 0.0
        self._is_assembling = False

    @property
    def is_complete(self) -> bool:
        """Whether all tiles have been read."""
        return self._next == self._grid.n_tiles

    def advance(self, turn_s: float = float("inf")) -> bool:
        """Take in the tiles that follow, as far as they are there; whether any was.

        Parameters
        ----------
        turn_s
            After the first row of tiles, none is begun after this time.

        Raises
        ------
        TileError
            The next tile is damaged; `next_tile` says which.
        """
        began = self._next
        started = time.perf_counter()
        while not self.is_complete:
            is_row = self._next % self._grid.columns == 0
            if is_row and self._next > began and time.perf_counter() - started > turn_s:
                break
            try:
                data = self._store.read_tile(self.job_id, self._next)
            except FileNotFoundError:
                break
            if is_row and not self.renew():
                break  # another assembler has the job; the next look tells
            self._take(data)
            self._next += 1
        if self._next > began:
            self._show()
        self._spent_s += time.perf_counter() - started
        return self._next > began

    def begin(self) -> None:
        """Record, once, that all tiles are there and the picture is being put together."""
        if self._is_assembling:
            return
        try:
            jobs.transition(self._store, self._queue, self.job_id, JobState.ASSEMBLING, by=self._owner)
        except IllegalTransitionError as error:
            if error.current is not JobState.ASSEMBLING:  # canceled, failed: nothing of it is published
                raise
        self._is_assembling = True

    def renew(self) -> bool:
        """Renew the claim on the job; False if it is lost."""
        return self._queue.claim(self.job_id, self._owner, _CLAIM_MS)

    @property
    def next_tile(self) -> int:
        """Index of the tile that is wanted next (the damaged one after a `TileError`)."""
        return self._next

    def _take(self, data: bytes) -> None:
        rect = Rect(*self._grid.tile_rect(self._next))
        header, values = decode_tile(data)
        if header.rect != rect or header.sample_range != (0, self._samples):
            raise TileError(f"film tile is of {header.rect} {header.sample_range}, not {rect} (0, {self._samples})")
        if self._row is None:  # the first row may be lower than the others
            self._row = np.empty((min(self._grid.tile_size, self._grid.height), self._grid.width, 3), np.float32)
        row = self._row[: rect.height]
        left = rect.x - self._grid.x
        row[:, left : left + rect.width] = values if header.payload == "pixels" else develop(values, self._samples)
        self._totals.add(header)
        if (self._next + 1) % self._grid.columns == 0:
            if self._writer is None:  # not before there is something to write: a job may end without any
                self._writer = self._open()
            self._writer.write_rows(row)
            self._preview.add(Rect(self._grid.x, rect.y, self._grid.width, rect.height), row)

    def _open(self) -> FilmWriter:
        return FilmWriter(
            self._folder / RESULT_EXR,
            self._folder / RESULT_PNG,
            self._grid.width,
            self._grid.height,
            crop_origin=(self._grid.x, self._grid.y),
            display_size=(self.record.width, self.record.height),
            png_color_space=self._color_space,
            threads=count_cores(),
        )

    def _show(self) -> None:
        """Bring the preview up to date, now and then."""
        if not self.is_complete and time.monotonic() - self._previewed_at > _PREVIEW_EVERY_S:
            self._previewed_at = time.monotonic()
            path = self._store.result_path(self.job_id, PREVIEW_PNG)
            files.replace(path, self._preview.encode_png(self._color_space), self._store.temporary, durable=False)

    def commit(self) -> None:
        """Write the rest, move the results into place, and end the job; safe to do again after a crash anywhere."""
        store, job_id = self._store, self.job_id
        started = time.perf_counter()
        self._is_assembling = False  # look again: it may have been canceled meanwhile
        self.begin()
        assert self._writer is not None  # every tile was taken in, so the last row was written
        film_sha256 = self._writer.close()
        (self._folder / PREVIEW_PNG).write_bytes(self._preview.encode_png(self._color_space))
        sizes = {name: (self._folder / name).stat().st_size for name in (RESULT_EXR, RESULT_PNG)}
        report = build_report(
            self.record,
            store.read_plan(job_id) or {},
            store.events(job_id),
            self._totals,
            film_sha256=film_sha256,
            assembling_s=self._spent_s + time.perf_counter() - started,
            sizes=sizes,
        )
        (self._folder / REPORT).write_bytes(report)
        names = (RESULT_EXR, RESULT_PNG, PREVIEW_PNG, REPORT)
        # The writer has brought its two files to the disk.
        store.commit_result(job_id, {name: self._folder / name for name in names}, synced=(RESULT_EXR, RESULT_PNG))
        jobs.transition(
            store, self._queue, job_id, JobState.SUCCEEDED, by=self._owner, detail=summarize(self._totals, film_sha256)
        )
        jobs.clean_up(store, self._queue, job_id)

    def touch(self) -> bool:
        """Keep the working folder from being swept as abandoned; False if it is gone (this machine slept, perhaps)."""
        try:
            os.utime(self._folder)
        except FileNotFoundError:
            return False
        return True

    def close(self) -> None:
        """Drop what is not committed."""
        if self._writer is not None:
            self._writer.abandon()
        shutil.rmtree(self._folder, ignore_errors=True)


class Assembler:
    """The loop over active jobs.

    Parameters
    ----------
    store, queue
        The farm.
    owner
        Name of this assembler, unique in the farm.
    """

    def __init__(self, store: Store, queue: Queue, owner: str) -> None:
        self._store, self._queue, self._owner = store, queue, owner
        self._assemblies: dict[str, Assembly] = {}
        self._awake = threading.Event()
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._news: set[str] = set()

    def stop(self) -> None:
        """Leave the loop; nothing is lost."""
        self._stopped.set()
        self._awake.set()

    def run(self) -> None:
        """Assemble until stopped."""
        threading.Thread(target=self._listen, name="wake-ups", daemon=True).start()
        next_poll = 0.0
        unfinished: set[str] = set()
        while not self._stopped.is_set():
            self._awake.wait(0.0 if unfinished else max(0.0, next_poll - time.monotonic()))
            self._awake.clear()
            with self._lock:
                news, self._news = self._news, set()
            if time.monotonic() >= next_poll:
                next_poll = time.monotonic() + _POLL_S
                news |= self._poll()
            unfinished = {job_id for job_id in sorted(news | unfinished) if self.advance(job_id)}
        for job_id in list(self._assemblies):
            self._drop(job_id)

    def _poll(self) -> set[str]:
        """Keep our folders and return all jobs that might have news."""
        active = set(self._assemblies)
        for job_id in active:
            if not self._assemblies[job_id].touch():
                self._drop(job_id)  # it begins anew
        with suppress(QueueError):
            active |= self._queue.active_jobs()
        return active

    def advance(self, job_id: str) -> bool:
        """Bring one job forward, for a turn; whether there is more to do now. What goes wrong with it stays with it."""
        try:
            return self._advance(job_id)
        except (JobNotFoundError, IllegalTransitionError):
            self._drop(job_id)  # deleted, canceled or failed meanwhile
        except QueueError as error:
            log.warning("queue away", error=str(error))
        except (StoreFullError, ImageWriteError) as error:
            log.exception("no place for the result", job=job_id)
            self._fail(job_id, problem("store-full", "The result could not be written", str(error)))
        except Exception as error:
            log.exception("assembly failed", job=job_id)
            self._fail(
                job_id,
                problem("assembly-failed", "The picture could not be put together", f"{type(error).__name__}: {error}"),
            )
        return False

    def _advance(self, job_id: str) -> bool:
        event = self._store.last_event(job_id)
        if event.state not in {JobState.RENDERING, JobState.ASSEMBLING}:
            if job_id in self._assemblies:
                self._drop(job_id)
            return False
        is_rendered, left_s = self._outlook(job_id, event)
        if job_id not in self._assemblies and not is_rendered and left_s < _STREAM_FROM_S:
            return False
        if not self._queue.claim(job_id, self._owner, _CLAIM_MS):
            self._drop(job_id)  # another host's assembler has it
            return False
        if job_id not in self._assemblies:
            self._assemblies[job_id] = Assembly(self._store, self._queue, job_id, self._owner)
        assembly = self._assemblies[job_id]
        if is_rendered:
            assembly.begin()
        try:
            has_news = assembly.advance(_TURN_S)
        except TileError as error:
            self._repair(assembly, error)
            return False
        if not assembly.is_complete:
            return has_news
        if assembly.renew():
            assembly.commit()
            log.info("job assembled", job=job_id)
            self._drop(job_id)
        return False

    def _outlook(self, job_id: str, event: JobEvent) -> tuple[bool, float]:
        """Return whether all tiles are there as far as the index knows, and how many seconds they take at this pace."""
        progress = self._queue.progress(job_id)
        if progress is None:  # the index is being rebuilt: the tiles on disk decide
            return False, float("inf")
        if progress.done >= progress.n_tiles:
            return True, 0.0
        elapsed_s = seconds_between(event.at, now())
        return False, elapsed_s * (progress.n_tiles - progress.done) / max(1, progress.done)

    def _repair(self, assembly: Assembly, error: TileError) -> None:
        """Have a damaged tile rendered again."""
        job_id, tile = assembly.job_id, assembly.next_tile
        log.warning("tile damaged", job=job_id, tile=tile, error=str(error))
        damages = count_fault(self._store, self._queue, job_id, tile, "error", by=self._owner, error=str(error))
        if damages is None:
            self._drop(job_id)
            return
        if damages >= contract.MAX_TILE_ERRORS:
            self._fail(
                job_id, problem("tile-failed", "A part of the picture is damaged on disk", str(error), tile=tile)
            )
            return
        self._store.tile_path(job_id, tile).unlink(missing_ok=True)
        self._queue.redo_tile(job_id, tile)
        self._queue.enqueue_runs(job_id, assembly.record.priority)

    def _fail(self, job_id: str, body: dict[str, Any]) -> None:
        """Fail a job, unless another assembler has it by now: then the error is ours, and none of the job's."""
        self._close(job_id)  # first: the event may need the space
        with suppress(FarmError):
            if self._queue.claim(job_id, self._owner, _CLAIM_MS):
                jobs.fail(self._store, self._queue, job_id, body, by=self._owner)
                self._queue.unclaim(job_id, self._owner)

    def _drop(self, job_id: str) -> None:
        if self._close(job_id):
            with suppress(QueueError):
                self._queue.unclaim(job_id, self._owner)

    def _close(self, job_id: str) -> bool:
        assembly = self._assemblies.pop(job_id, None)
        if assembly is not None:
            assembly.close()
        return assembly is not None

    def _listen(self) -> None:
        """Note which jobs have news; reconnect for ever."""
        client = connect(self._queue.url, timeout_s=None)
        while not self._stopped.is_set():
            try:
                with client.pubsub(ignore_subscribe_messages=True) as pubsub:  # type: ignore[no-untyped-call]
                    pubsub.subscribe(contract.CHANNEL_ASSEMBLER)
                    for message in pubsub.listen():
                        with self._lock:
                            self._news.add(message["data"].decode())
                        self._awake.set()
            except (redis.RedisError, OSError) as error:
                log.warning("wake-ups lost", error=str(error))
                self._stopped.wait(0.25)
