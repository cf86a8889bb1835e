"""What can be done with a job: submit, view, cancel, delete. The API and the workers share these.

Job: the order of writes that makes each operation safe to repeat and to interrupt anywhere.
Invariant: the store first, the queue second; a queue that is away delays a job and never loses it.
See ARCHITECTURE.md, "Two ideas carry it".
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from worker import files
from worker.errors import (
    DamagedRecordError,
    FarmError,
    IdempotencyConflictError,
    IllegalTransitionError,
    JobActiveError,
    JobNotFoundError,
    QueueError,
    StoreFullError,
)
from worker.grid import TileGrid, choose_tile_size
from worker.queue import IndexProgress, Queue
from worker.records import JobEvent, JobRecord, check_owner, new_job_id, now, seconds_between
from worker.states import TERMINAL, JobState, allowed_from
from worker.store import Store
from worker.uploads import hash_key

if TYPE_CHECKING:
    from tracer.scene import SceneDoc

# What a key is bound to once its job was deleted: no job has this id, for it would be of the year 1970.
_DELETED = "0" * 26


class KeySpentError(FarmError):
    """The idempotency key's job was deleted: the same request again must not make a second one."""


@dataclass(frozen=True, slots=True)
class Submission:
    """Outcome of `submit`: the job's id, and whether an earlier request with the same key had made it."""

    job_id: str
    replayed: bool


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is.

    Attributes
    ----------
    tiles_done, tiles_total
        Tiles.
    fraction
        0 to 1, of tiles.
    rays
        Rays traced so far (since the index was last built, while the job runs).
    rays_per_s
        Rays over the seconds of rendering; None before there are any.
    eta_s
        Seconds until the last tile at this pace; None when nothing can be said, 0 at the end.
    """

    tiles_done: int
    tiles_total: int
    fraction: float
    rays: int
    rays_per_s: float | None
    eta_s: float | None


@dataclass(frozen=True, slots=True)
class JobView:
    """All that a client may know about a job; `problem` is set when it failed, `summary` when it succeeded."""

    record: JobRecord
    event: JobEvent
    progress: Progress
    problem: Mapping[str, Any] | None
    summary: Mapping[str, Any] | None

    @property
    def state(self) -> JobState:
        """State of the job."""
        return self.event.state

    @property
    def updated_at(self) -> str:
        """Time of the last event."""
        return self.event.at


def make_record(
    scene: "SceneDoc",
    scene_json: bytes,
    *,
    owner: str,
    job_id: str,
    name: str | None = None,
    output: Mapping[str, Any] | None = None,
    priority: int = 50,
    idempotency_key: str | None = None,
) -> JobRecord:
    """Return the record of a job that is about to be accepted.

    Parameters
    ----------
    scene, scene_json
        The document and its canonical JSON.
    owner, job_id, name, priority
        As in `JobRecord`.
    output
        ``png_color_space`` ("srgb" by default) and ``tile_size`` (None, the default: by the amount of work).
    idempotency_key
        Key of the request, if any.
    """
    image = scene.image
    crop = image.crop
    samples = scene.sampling.samples
    settings = {"png_color_space": "srgb", "tile_size": None, **(output or {})}
    x, y, width, height = (
        (0, 0, image.width, image.height) if crop is None else (crop.x, crop.y, crop.width, crop.height)
    )
    if settings["tile_size"] is None:
        settings["tile_size"] = choose_tile_size(x, y, width, height, samples)
    return JobRecord(
        id=job_id,
        owner=owner,
        created_at=now(),
        name=name,
        scene_sha256=hashlib.sha256(scene_json).hexdigest(),
        width=image.width,
        height=image.height,
        x=x,
        y=y,
        crop_width=width,
        crop_height=height,
        samples=samples,
        output=settings,
        priority=priority,
        n_tiles=TileGrid(x, y, width, height, int(settings["tile_size"])).n_tiles,
        idempotency_key_sha256=None if idempotency_key is None else hash_key(idempotency_key),
    )


def submit(
    store: Store,
    queue: Queue,
    scene: "SceneDoc",
    *,
    owner: str,
    name: str | None = None,
    output: Mapping[str, Any] | None = None,
    priority: int = 50,
    idempotency_key: str | None = None,
    request_sha256: str = "",
    scene_json: bytes | None = None,
) -> Submission:
    """Accept a job: on return it is on disk and will be rendered, whatever happens to this process or to the queue.

    Parameters
    ----------
    store, queue
        The farm.
    scene
        A document parsed with ``require_hashes=True``.
    owner, name, output, priority
        As in `JobRecord`.
    idempotency_key, request_sha256
        Key of the request and the hash of its body; the same pair again is answered with the same job.
    scene_json
        The document's canonical JSON, where the caller has it already; then `scene` may lack its objects.

    Returns
    -------
    Submission

    Raises
    ------
    IdempotencyConflictError
        The key belongs to another request.
    KeySpentError
        The key's job was deleted.
    StoreFullError
    """
    if scene_json is None:
        from tracer.scene import canonical_json

        scene_json = canonical_json(scene)
    job_id = own_id = new_job_id()
    if idempotency_key is not None:
        first_sha256, job_id = store.put_idempotency(owner, idempotency_key, request_sha256, own_id)
        if first_sha256 != request_sha256:
            raise IdempotencyConflictError
        if store.has_job(job_id):
            return Submission(job_id, replayed=True)
        if job_id != own_id:  # deleted, even just now? The key is marked before its job goes.
            _, job_id = store.put_idempotency(owner, idempotency_key, request_sha256, own_id)
            if job_id == _DELETED:
                raise KeySpentError
        # The first request died between its key and its job, or is about to write it: whoever is first creates it.
    record = make_record(
        scene,
        scene_json,
        owner=owner,
        job_id=job_id,
        name=name,
        output=output,
        priority=priority,
        idempotency_key=idempotency_key,
    )
    if not store.create_job(record, scene_json):
        return Submission(job_id, replayed=True)
    with suppress(QueueError):  # the reconciler finds the job in the store
        queue.enqueue_prepare(job_id, priority)
    return Submission(job_id, replayed=False)


def transition(
    store: Store, queue: Queue, job_id: str, to: JobState, *, by: str, detail: Mapping[str, Any] | None = None
) -> JobEvent:
    """Bring a job into a state, durable, and tell whoever waits for it; errors as in `Store.transition`."""
    event = store.transition(job_id, to, by=by, detail=detail)
    queue.publish_event(job_id, event)
    return event


def fail(store: Store, queue: Queue, job_id: str, problem: Mapping[str, Any], *, by: str) -> bool:
    """Fail a job with a problem and take it out of the queue; False if it has ended or is being canceled.

    Where the store cannot take the event (`StoreFullError`), nothing is stopped: the fault comes again, and then this.
    """
    try:
        transition(store, queue, job_id, JobState.FAILED, by=by, detail={**problem, **_work_done(store, queue, job_id)})
    except (IllegalTransitionError, JobNotFoundError):
        is_failed = False
    else:
        is_failed = True
    with suppress(QueueError):
        queue.stop_job(job_id)
    if is_failed:
        clean_up(store, queue, job_id)
    return is_failed


def cancel(store: Store, queue: Queue, job_id: str, *, by: str = "api") -> JobEvent:
    """Cancel a job; kernels stop within about a second. A job being canceled already is left as it is.

    Returns
    -------
    JobEvent
        Its last event: `canceling`, or `canceled` when nobody was at work on it.

    Raises
    ------
    JobNotFoundError
    IllegalTransitionError
        The job has ended; `allowed` is empty.
    """
    try:
        event = transition(store, queue, job_id, JobState.CANCELING, by=by)
    except IllegalTransitionError as error:
        if error.current is not JobState.CANCELING:
            raise IllegalTransitionError(error.current, JobState.CANCELED, allowed_from(error.current)) from None
        event = store.last_event(job_id)
    with suppress(QueueError):  # the reconciler goes on from the event
        if queue.stop_job(job_id) == 0:
            return finish_cancel(store, queue, job_id, by=by) or event
    return event


def finish_cancel(store: Store, queue: Queue, job_id: str, *, by: str) -> JobEvent | None:
    """Record that a job being canceled is canceled, once nobody works on it; None if it was not being canceled."""
    try:
        event = transition(store, queue, job_id, JobState.CANCELED, by=by, detail=_work_done(store, queue, job_id))
    except (IllegalTransitionError, JobNotFoundError):
        return None
    clean_up(store, queue, job_id)
    return event


def _work_done(store: Store, queue: Queue, job_id: str) -> dict[str, int]:
    """Return what the last event of a job keeps of its progress: tiles and index are gone after it."""
    index: IndexProgress | None = None
    with suppress(QueueError):
        index = queue.progress(job_id)
    return {"tiles_done": len(store.done_tiles(job_id)), "rays": 0 if index is None else index.rays}


def clean_up(store: Store, queue: Queue, job_id: str) -> None:
    """Remove what a job that has ended no longer needs: its tiles, and its place in the index."""
    store.delete_tiles(job_id)
    with suppress(QueueError):
        queue.forget_job(job_id)


def delete(store: Store, queue: Queue, job_id: str) -> None:
    """Remove a job that has ended, with its results; its idempotency key stays spent for the rest of its day.

    Raises
    ------
    JobNotFoundError
    JobActiveError
        It has not ended; carries its state.
    """
    state = store.last_event(job_id).state
    if state not in TERMINAL:
        raise JobActiveError(state)
    with suppress(DamagedRecordError, StoreFullError):  # above all, a full store must get rid of jobs
        _spend_key(store, store.read_job(job_id))
    store.delete_job(job_id)
    with suppress(QueueError):
        queue.forget_job(job_id)


def _spend_key(store: Store, record: JobRecord) -> None:
    """Mark the key of a job that is about to be deleted; a key that was swept, or is another job's, is left alone."""
    if record.idempotency_key_sha256 is None:
        return
    path = store.root / "idempotency" / check_owner(record.owner) / record.idempotency_key_sha256
    try:
        bound = json.loads(path.read_bytes())
        times = path.stat()
    except (FileNotFoundError, ValueError):
        return
    if isinstance(bound, dict) and bound.get("job_id") == record.id:
        files.replace(path, json.dumps({**bound, "job_id": _DELETED}).encode(), store.temporary)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # a day from the first request, not from now


def view(store: Store, queue: Queue, job_id: str) -> JobView:
    """Return all that a client may know about a job.

    Works while the queue is away (progress is then counted from the tiles on disk). Costs two small files and one call
    to Redis; a job that has ended costs no call.

    Raises
    ------
    JobNotFoundError
    """
    record = store.read_job(job_id)
    event = store.last_event(job_id)
    is_failed = event.state is JobState.FAILED
    is_succeeded = event.state is JobState.SUCCEEDED
    return JobView(
        record,
        event,
        _progress(store, queue, record, event),
        event.detail if is_failed else None,
        event.detail if is_succeeded else None,
    )


def _progress(store: Store, queue: Queue, record: JobRecord, event: JobEvent) -> Progress:
    """Return a job's progress: from its last event at the end, from the index while it runs, else from the tiles."""
    total = record.n_tiles
    kept = event.detail or {}
    if event.state is JobState.SUCCEEDED:
        return Progress(total, total, 1.0, int(kept.get("rays", 0)), kept.get("rays_per_s"), 0.0)
    if event.state in TERMINAL:
        done = int(kept.get("tiles_done", 0))
        return Progress(done, total, done / total, int(kept.get("rays", 0)), None, None)
    if event.state in {JobState.QUEUED, JobState.PREPARING}:
        return Progress(0, total, 0.0, 0, None, None)
    index: IndexProgress | None = None
    with suppress(QueueError):
        index = queue.progress(record.id)
    if index is None:
        done, rays = len(store.done_tiles(record.id)), 0
    else:
        done, rays = index.done, index.rays
    elapsed = seconds_between(_started_at(store, event, record.id), now())
    fraction = done / total
    eta = elapsed * (1.0 - fraction) / fraction if done and event.state is JobState.RENDERING else None
    return Progress(done, total, fraction, rays, rays / elapsed if rays and elapsed > 0.0 else None, eta)


def _started_at(store: Store, event: JobEvent, job_id: str) -> str:
    """Return when rendering began."""
    if event.type == "state" and event.state is JobState.RENDERING:
        return event.at
    for earlier in reversed(store.events(job_id)):
        if earlier.type == "state" and earlier.state is JobState.RENDERING:
            return earlier.at
    return event.at
