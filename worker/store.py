"""The store: plain files, the truth about every job.

Job: keep jobs, events, tiles, results and assets so that nothing acknowledged is lost and nothing is written twice.
Invariant: every path is made from a checked id, hash or one of our own names; records, events, plans and tiles are
create-if-absent; an event's number is taken by exactly one writer.
See ARCHITECTURE.md, "Two ideas carry it".

::

    assets/<sha256>                    content-addressed, checked on arrival
    jobs/<id>/job.json, scene.json     what was accepted, fsynced before 202
    jobs/<id>/events/<000001>.json     each transition and each fault of a tile; the last carries the state
    jobs/<id>/plan.json                tile grid and what made the compiled scene; written once
    jobs/<id>/tiles/<pass>-<tile>      film tile, write-once; deleted after the result is committed
    jobs/<id>/result.exr|.png, report.json, preview.png
    idempotency/<owner>/<key-hash>     request hash and job id, durable before 202
    steward/terminal.json              checkpoint of jobs that have ended: a restart need not open them
    identity                           made up once: tells this store from every other (`worker.identity`)
    tmp/                               files on their way; swept by the steward
"""
# os calls where they are measurably cheaper (listing 10,000 jobs) or have no Path spelling
# ruff: noqa: PTH100, PTH108, PTH208

import json
import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from worker import files
from worker.errors import (
    BadNameError,
    ConflictError,
    DamagedRecordError,
    IllegalTransitionError,
    JobNotFoundError,
)
from worker.products import Products
from worker.records import JobEvent, JobRecord, check_job_id, now
from worker.states import TERMINAL, JobState, allowed_from, can_transition
from worker.uploads import Uploads

# States that a client is told of as final: on disk before anybody hears of them.
_PROMISED = TERMINAL | {JobState.CANCELING}

# A file that is whole as soon as it has its name can only be found damaged after a power failure.
_SURELY_OLD_S = 10.0

# Terminal events are kept in memory (a few hundred bytes each): 10,000 jobs are listed without opening them again.
_REMEMBERED = 20_000


class Store(Uploads, Products):
    """Plain files under one folder; safe to use from many processes and threads at once.

    Parameters
    ----------
    root
        Folder, created if absent (mode 0700).
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(os.path.abspath(root))
        self.root.mkdir(mode=0o700, parents=True, exist_ok=True)
        Uploads.__init__(self, self.root)
        jobs = self.root / "jobs"
        jobs.mkdir(exist_ok=True)
        Products.__init__(self, jobs, self.temporary)
        self._terminal: dict[str, JobEvent] = {}

    @property
    def identity(self) -> str:
        """Name of this store, made up by whoever asked first: the same on every machine that shares its files."""
        path = self.root / "identity"
        with suppress(FileNotFoundError):
            return path.read_text()
        files.create(path, secrets.token_hex(16).encode(), self.temporary)
        return path.read_text()

    # ---- jobs -----------------------------------------------------------------------------------------------------

    def has_job(self, job_id: str) -> bool:
        """Whether there is such a job."""
        return self.job_dir(job_id).is_dir()

    def create_job(self, record: JobRecord, scene_json: bytes, *, by: str = "api") -> bool:
        """Write a job with its first event, complete and durable, or not at all.

        Parameters
        ----------
        record
            What was accepted.
        scene_json
            Canonical JSON of the scene.
        by
            Who created it.

        Returns
        -------
        bool
            False if that id exists already (nothing is changed then).
        """
        target = self.job_dir(record.id)
        if target.is_dir():
            return False
        event = _first_event(record, by)
        folder = self.temporary / f"job-{record.id}-{secrets.token_hex(4)}"
        try:
            with files.full_is_clear():
                (folder / "events").mkdir(parents=True)
                (folder / "tiles").mkdir()
                # Not fsynced: `_read_event` makes it again from the record, and every wait for the disk counts here.
                (folder / "events" / _event_name(1)).write_bytes(event.to_json())
                (folder / "job.json").write_bytes(record.to_json())
                (folder / "scene.json").write_bytes(scene_json)
                files.fsync_files([folder / "job.json", folder / "scene.json"])
                files.fsync_folder(folder)
            return files.publish_folder(folder, target)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def read_job(self, job_id: str) -> JobRecord:
        """Return what was accepted (without the scene); `JobNotFoundError` where there is none."""
        return JobRecord.from_json(self._read(job_id, "job.json"))

    def read_scene(self, job_id: str) -> bytes:
        """Return the canonical JSON of the job's scene."""
        return self._read(job_id, "scene.json")

    def job_ids(self, *, before: str | None = None) -> Iterator[str]:
        """Yield the ids of all jobs, newest first; only those older than `before` if given (a page's cursor)."""
        for name in sorted(self.job_names(), reverse=True):
            if before is None or name < before:
                with suppress(BadNameError):
                    yield check_job_id(name)

    def job_names(self) -> list[str]:
        """Return the names in the folder of jobs, unsorted and unchecked: 10,000 in 3 ms."""
        return os.listdir(self._jobs)

    def delete_job(self, job_id: str) -> None:
        """Remove a job with all its files and its idempotency record; `JobNotFoundError` where there is none.

        The name vanishes in one step; a crash afterwards leaves only a folder in ``tmp``.
        """
        record: JobRecord | None = None
        with suppress(DamagedRecordError):
            record = self.read_job(job_id)
        grave = self.temporary / f"deleted-{job_id}-{secrets.token_hex(4)}"
        try:
            self.job_dir(job_id).rename(grave)
        except FileNotFoundError:
            raise JobNotFoundError(f"no job {job_id}") from None
        self._terminal.pop(job_id, None)
        if record is not None and record.idempotency_key_sha256 is not None:
            self.free_idempotency(record.owner, record.idempotency_key_sha256, job_id)
        files.fsync_folder(self._jobs)
        shutil.rmtree(grave, ignore_errors=True)

    # ---- events ---------------------------------------------------------------------------------------------------

    def last_event(self, job_id: str) -> JobEvent:
        """Return the newest event: its `state` is the job's state.

        Raises
        ------
        JobNotFoundError
        """
        remembered = self._terminal.get(job_id)
        folder = self.job_dir(job_id) / "events"
        if remembered is not None and folder.is_dir():
            return remembered
        event: JobEvent | None = None
        while event is None:
            event = self._read_event(job_id, max(self._event_names(job_id)))
        if event.state in TERMINAL:
            if len(self._terminal) >= _REMEMBERED:
                self._terminal.clear()
            self._terminal[job_id] = event
        return event

    def events(self, job_id: str, after: int = 0) -> list[JobEvent]:
        """Return the events with a number above `after`, in order."""
        names = sorted(name for name in self._event_names(job_id) if int(name[:6]) > after)
        found = [self._read_event(job_id, name) for name in names]
        return [event for event in found if event is not None]

    def append_event(
        self,
        job_id: str,
        type_: str,
        state: JobState,
        expected: JobEvent,
        *,
        by: str,
        detail: Mapping[str, Any] | None = None,
    ) -> JobEvent:
        """Append one event after `expected`; durable if it is one that the client was promised (cancel, the end).

        The others cost no wait for the disk: a power failure that loses one only has the work done again.

        Raises
        ------
        ConflictError
            Another event followed `expected` meanwhile.
        """
        event = JobEvent(expected.seq + 1, now(), type_, state, expected.state, by, detail)
        path = self.job_dir(job_id) / "events" / _event_name(event.seq)
        is_promised = type_ == "state" and state in _PROMISED
        try:
            created = files.create(path, event.to_json(), self.temporary, durable=is_promised)
        except FileNotFoundError:
            raise JobNotFoundError(f"no job {job_id}") from None
        if not created:
            raise ConflictError(f"event {event.seq} of job {job_id} exists already")
        return event

    def transition(self, job_id: str, to: JobState, *, by: str, detail: Mapping[str, Any] | None = None) -> JobEvent:
        """Bring a job into state `to`, once.

        Raises
        ------
        IllegalTransitionError
            Its state does not allow that (being in `to` already included); carries `current` and `allowed`.
        JobNotFoundError
        """
        while True:
            last = self.last_event(job_id)
            if not can_transition(last.state, to):
                raise IllegalTransitionError(last.state, to, allowed_from(last.state))
            with suppress(ConflictError):
                return self.append_event(job_id, "state", to, last, by=by, detail=detail)

    def note(self, job_id: str, type_: str, *, by: str, detail: Mapping[str, Any]) -> JobEvent | None:
        """Append an event that leaves the state as it is; None if the job has ended (nothing follows the end)."""
        while True:
            last = self.last_event(job_id)
            if last.state in TERMINAL:
                return None
            with suppress(ConflictError):
                return self.append_event(job_id, type_, last.state, last, by=by, detail=detail)

    # ---- housekeeping (the steward's) -----------------------------------------------------------------------------

    def sweep(self, older_than_s: float, idempotency_s: float = 86_400.0) -> int:
        """Remove what crashes left in ``tmp`` and idempotency records past their day; return how many.

        Assemblers touch their folders, so that these are not taken for abandoned.
        """
        removed = 0
        limits = [(self.temporary, older_than_s)]
        limits += [(folder, idempotency_s) for folder in self._idempotency.iterdir()]
        for folder, limit in limits:
            for entry in os.scandir(folder):
                with suppress(FileNotFoundError):
                    if time.time() - entry.stat(follow_symlinks=False).st_mtime < limit:
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        shutil.rmtree(entry.path, ignore_errors=True)
                    else:
                        os.unlink(entry.path)
                    removed += 1
        return removed

    def read_checkpoint(self) -> set[str]:
        """Return the ids of jobs known to have ended, as last written; an empty set where there is none."""
        try:
            return set(json.loads((self.root / "steward" / "terminal.json").read_bytes()))
        except (FileNotFoundError, ValueError):
            return set()

    def write_checkpoint(self, ended: Iterable[str]) -> None:
        """Write the ids of jobs known to have ended."""
        (self.root / "steward").mkdir(exist_ok=True)
        path = self.root / "steward" / "terminal.json"
        files.replace(path, json.dumps(sorted(ended)).encode(), self.temporary, durable=False)

    # ---- inside ---------------------------------------------------------------------------------------------------

    def _event_names(self, job_id: str) -> list[str]:
        try:
            return os.listdir(self.job_dir(job_id) / "events") or [_event_name(1)]
        except FileNotFoundError:
            raise JobNotFoundError(f"no job {job_id}") from None

    def _read_event(self, job_id: str, name: str) -> JobEvent | None:
        """Read one event; None if it was a damaged one that is now gone (the work since is then done again)."""
        try:
            return JobEvent.from_json(self._read(job_id, f"events/{name}"))
        except FileNotFoundError:
            return _first_event(self.read_job(job_id)) if name == _event_name(1) else None
        except DamagedRecordError:
            if name == _event_name(1):
                return _first_event(self.read_job(job_id))
            path = self.job_dir(job_id) / "events" / name
            with suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime < _SURELY_OLD_S:
                    raise
                path.unlink()
            return None


def _event_name(seq: int) -> str:
    return f"{seq:06d}.json"


def _first_event(record: JobRecord, by: str = "api") -> JobEvent:
    return JobEvent(1, record.created_at, "created", JobState.QUEUED, None, by, None)
