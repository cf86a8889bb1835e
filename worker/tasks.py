"""What a worker does: prepare a job, render runs of its tiles.

Job: the two tasks that hints name, and what becomes of their failures.
Invariant: a task may be called twice, late, for a job that has ended, or be killed anywhere: the store's state decides
what is left to do, files are created once, and a lost hint comes again from the steward.
See ARCHITECTURE.md, "One datum's way".
"""

import hashlib
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from tracer.film.develop import develop_blocks
from tracer.film.tile import Rect, TileHeader, blocks_of_rect, encode_tile
from tracer.scene import AssetRef, AssetResolver, SceneError, parse_scene
from tracer.types import COUNTERS
from worker import contract, jobs
from worker.backends import CanceledError, SceneFaultError
from worker.context import Prepared, WorkerContext
from worker.errors import (
    AssetNotFoundError,
    IllegalTransitionError,
    JobNotFoundError,
    QueueError,
    StoreFullError,
)
from worker.grid import grid_of
from worker.leases import count_fault, reproduce_line
from worker.records import JobRecord, problem
from worker.states import JobState

log = structlog.get_logger()

_RAYS = tuple(index for index, name in enumerate(COUNTERS) if name.endswith("_rays"))


# ---- prepare ---------------------------------------------------------------------------------------------------------


def prepare(context: WorkerContext, job_id: str) -> None:
    """Compile a job's scene, write its plan, put it into the index, and begin with its tiles.

    Parameters
    ----------
    context
        Of this worker.
    job_id
        A job that is queued, or was left in preparation by a worker that died.
    """
    store, queue = context.store, context.queue
    try:
        state = store.last_event(job_id).state
        if state not in {JobState.QUEUED, JobState.PREPARING}:
            _stop_if_canceled(context, job_id, state)
            return
        with context.working_on(job_id):
            if not context.lease_preparation(job_id):
                return
            try:
                if store.last_event(job_id).state is JobState.QUEUED:
                    jobs.transition(store, queue, job_id, JobState.PREPARING, by=context.name)
                record = store.read_job(job_id)
                prepared = _compile(context, record)
                queue.init_job(job_id, prepared.grid.n_tiles, prepared.grid.columns, store.done_tiles(job_id))
                jobs.transition(store, queue, job_id, JobState.RENDERING, by=context.name)
            except IllegalTransitionError as error:
                context.release()
                _stop_if_canceled(context, job_id, error.current)
                return
            except CanceledError:
                _give_up(context, job_id)
                return
            except SceneFaultError as error:
                _fail(context, job_id, problem(error.kind, error.title, error.detail, **error.more))
                return
            except (JobNotFoundError, QueueError):
                raise
            except Exception as error:  # noqa: BLE001 - whatever it is, the job must hear of it
                _count_error(context, job_id, None, error)
                return
    except JobNotFoundError:
        context.release()
        return
    # Others may help; this worker goes on at once, without a way through the queue.
    with suppress(QueueError):
        helpers = min(prepared.grid.n_tiles, queue.count_workers()) - 1
        queue.enqueue_runs(job_id, record.priority, helpers)
    render_run(context, job_id)


def _compile(context: WorkerContext, record: JobRecord) -> Prepared:
    """Compile (or find compiled) and plan; the plan is written once and says how the picture is cut."""
    store = context.store
    try:
        scene = parse_scene(store.read_scene(record.id), require_hashes=True)
    except SceneError as error:
        raise scene_fault(error) from error
    started = time.perf_counter()
    compiled, figures = context.backend.compile(scene, _asset_resolver(context), context.settings.cache)
    grid = grid_of(record)
    store.write_plan(
        record.id,
        {
            "version": 1,
            **grid._asdict(),
            "samples": record.samples,
            "seed": scene.sampling.seed,
            "backend": context.backend.name,
            "arithmetic": context.backend.arithmetic,
            "prepare_s": round(time.perf_counter() - started, 6),
            "figures": dict(figures),
        },
    )
    return context.remember(record.id, Prepared(compiled, grid, record.samples, record.priority))


def scene_fault(error: SceneError) -> SceneFaultError:
    """Turn a refused document into the fault that fails its job; pointers count from the request's root."""
    faults = [
        {"pointer": f"/scene{fault.pointer}", "detail": fault.message, "expected": fault.expected}
        for fault in error.faults
    ]
    first = faults[0] if faults else {"pointer": "/scene", "detail": str(error)}
    return SceneFaultError(
        "scene-invalid", "The scene cannot be rendered", first["detail"], pointer=first["pointer"], errors=faults
    )


def _asset_resolver(context: WorkerContext) -> AssetResolver:
    """Return what finds a scene's files: a folder of links, because a model names its companions relative to itself."""
    store = context.store

    def resolve(asset: AssetRef) -> Path:
        names = {asset.file: asset.sha256, **dict(asset.companions or {})}
        key = hashlib.sha256(repr(sorted(names.items(), key=str)).encode()).hexdigest()
        folder = context.settings.cache / "assets" / key[:32]
        for name, sha256 in names.items():
            if sha256 is None:
                continue
            try:
                source = store.asset_path(sha256)
            except AssetNotFoundError as error:
                raise SceneFaultError(
                    "asset-missing",
                    "A file of the scene was not uploaded",
                    f"asset {asset.name!r}: {name!r} with sha256 {sha256} is not in the store",
                    file=name,
                    expected="an uploaded file: PUT /v1/assets/{sha256}, then send the job again",
                ) from error
            link = folder / name
            link.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                link.symlink_to(source)
            if link.resolve() != source.resolve():  # the store has moved since
                temporary = link.with_name(f".{os.getpid()}-{link.name}")
                temporary.symlink_to(source)
                temporary.replace(link)
        return folder / asset.file

    return resolve


# ---- render ----------------------------------------------------------------------------------------------------------


def render_run(context: WorkerContext, job_id: str) -> None:
    """Render tiles of a job until none is left, or another job has waited for about a second.

    Parameters
    ----------
    context
        Of this worker.
    job_id
        Any job; one that is not in the index is none of our business (any more).
    """
    with context.working_on(job_id):
        try:
            prepared = context.prepared.get(job_id) or _load(context, job_id)
            if prepared is not None:
                _render_tiles(context, job_id, prepared)
        except CanceledError:
            _give_up(context, job_id)
        except JobNotFoundError:
            context.release()
        except SceneFaultError as error:
            _fail(context, job_id, problem(error.kind, error.title, error.detail, **error.more))


def _load(context: WorkerContext, job_id: str) -> Prepared | None:
    """Map the compiled scene of a job that another worker prepared; None if there is nothing to render."""
    if context.store.last_event(job_id).state not in {JobState.RENDERING, JobState.ASSEMBLING}:
        return None
    return _compile(context, context.store.read_job(job_id))


def _render_tiles(context: WorkerContext, job_id: str, prepared: Prepared) -> None:
    """Lease, render, write; commit the tile and lease the next in one call."""
    store, queue = context.store, context.queue
    began = time.monotonic()
    looked = began
    finished: int | None = None
    rays, kernel_s = 0, 0.0
    is_yielding = False
    while True:
        lease = context.lease_next(job_id, finished=finished, rays=rays, kernel_s=kernel_s, commit_only=is_yielding)
        if is_yielding:
            if lease.done < lease.n_tiles:
                queue.enqueue_runs(job_id, prepared.priority)
            return
        if lease.tile is None:
            return
        finished, rays, kernel_s = None, 0, 0.0
        try:
            if not store.tile_path(job_id, lease.tile).exists():
                rays, kernel_s = _render_tile(context, job_id, prepared, lease.tile)
            finished = lease.tile
        except (CanceledError, JobNotFoundError, QueueError):
            raise
        except Exception as error:  # noqa: BLE001 - whatever it is, the job must hear of it
            if _count_error(context, job_id, lease.tile, error):
                return
        now = time.monotonic()
        if now - looked >= contract.RUN_S and finished is not None:
            looked = now
            with suppress(QueueError):
                is_yielding = now - began > contract.RUN_MAX_S or any(queue.queue_lengths().values())
        if context.draining.is_set():
            is_yielding = True


def _render_tile(context: WorkerContext, job_id: str, prepared: Prepared, tile: int) -> tuple[int, float]:
    """Render one tile into the store; return its rays and the seconds in the kernel."""
    rect = Rect(*prepared.grid.tile_rect(tile))
    leased_at = time.time()
    started, cpu_started = time.perf_counter(), time.thread_time()
    film = context.backend.render(prepared.compiled, blocks_of_rect(rect), (0, prepared.samples), context.cancel)
    kernel_s, kernel_cpu_s = time.perf_counter() - started, time.thread_time() - cpu_started
    counters = {name: int(value) for name, value in zip(COUNTERS, film.counters, strict=True)}
    header = TileHeader(
        rect=rect,
        sample_range=(0, prepared.samples),
        counters=counters,
        kernel_s=kernel_s,
        kernel_cpu_s=kernel_cpu_s,
        leased_at=leased_at,
        finished_at=time.time(),
        worker=context.name,
    )
    pixels = develop_blocks(rect, film.sums, prepared.samples)
    context.store.write_tile(job_id, tile, encode_tile(header, pixels))
    return int(np.sum(film.counters[list(_RAYS)])), kernel_s


def render_alone(context: WorkerContext, job_id: str, tile: int | None) -> Mapping[str, Any]:
    """Do one preparation or one tile again in the foreground, writing nothing: for `reproduce_line`."""
    record = context.store.read_job(job_id)
    scene = parse_scene(context.store.read_scene(job_id), require_hashes=True)
    compiled, figures = context.backend.compile(scene, _asset_resolver(context), context.settings.cache)
    if tile is None:
        return dict(figures)
    grid = grid_of(record)
    rect = Rect(*grid.tile_rect(tile))
    started = time.perf_counter()
    film = context.backend.render(compiled, blocks_of_rect(rect), (0, record.samples), context.cancel)
    seconds = time.perf_counter() - started
    pixels = develop_blocks(rect, film.sums, record.samples)
    return {
        "tile": tile,
        "rect": list(rect),
        "kernel_s": seconds,
        "mean": pixels.mean(axis=(0, 1), dtype=np.float64).tolist(),
    }


# ---- failures --------------------------------------------------------------------------------------------------------


def _count_error(context: WorkerContext, job_id: str, tile: int | None, error: Exception) -> bool:
    """See to a tile (None: the preparation) that raised; True if that was the last time for the job."""
    log.error("tile failed" if tile is not None else "preparation failed", job=job_id, tile=tile, exc_info=error)
    store, queue = context.store, context.queue
    text = f"{type(error).__name__}: {error}"[:2000]
    errors = count_fault(store, queue, job_id, tile, "error", by=context.name, error=text)
    if errors is None:
        context.release()
        return True
    if errors >= contract.MAX_TILE_ERRORS:
        what = "preparing the scene" if tile is None else f"tile {tile}"
        kind, title = "tile-failed", "A part of the picture cannot be rendered"
        if isinstance(error, StoreFullError):
            kind, title = "store-full", "The store has no space left"
        elif tile is None:
            kind, title = "preparation-failed", "The scene could not be prepared"
        detail = f"{what} failed {errors} times, last with {text}"
        _fail(context, job_id, problem(kind, title, detail, tile=tile, reproduce=reproduce_line(job_id, tile)))
        return True
    context.release()
    if tile is None:
        queue.enqueue_prepare(job_id, store.read_job(job_id).priority)
    return False


def _fail(context: WorkerContext, job_id: str, body: Mapping[str, Any]) -> None:
    """Fail the job; if it is being canceled, that goes first."""
    context.release()
    context.prepared.pop(job_id, None)
    if not jobs.fail(context.store, context.queue, job_id, body, by=context.name):
        with suppress(JobNotFoundError):
            _stop_if_canceled(context, job_id, context.store.last_event(job_id).state)


def _give_up(context: WorkerContext, job_id: str) -> None:
    """After the cancel flag: give the tile back, and see whether this was the last lease of a canceled job."""
    context.release()
    with suppress(JobNotFoundError, QueueError):
        state = context.store.last_event(job_id).state
        _stop_if_canceled(context, job_id, state)
        if context.draining.is_set():
            # Somebody else is to go on with it.
            priority = context.store.read_job(job_id).priority
            if state in {JobState.RENDERING, JobState.ASSEMBLING}:
                context.queue.enqueue_runs(job_id, priority)
            elif state in {JobState.QUEUED, JobState.PREPARING}:
                context.queue.enqueue_prepare(job_id, priority)


def _stop_if_canceled(context: WorkerContext, job_id: str, state: JobState) -> None:
    """Record `canceled` if the job is being canceled and nobody works on it any more."""
    context.prepared.pop(job_id, None)
    if state is JobState.CANCELING and context.queue.stop_job(job_id) == 0:
        jobs.finish_cancel(context.store, context.queue, job_id, by=context.name)
