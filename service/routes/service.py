"""The service itself: health, readiness, workers, metrics, the scene's schema.

Job: answer monitors and tools.
Invariant: liveness needs nothing but this process; readiness tries each part for real; a scrape never fails because a
part is away.
"""

import json
import secrets
import shutil
from contextlib import suppress
from functools import cache

import anyio.to_thread
from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST

from service import examples, problems
from service.context import MIN_FREE_BYTES, Context, InContext
from service.openapi import problem_answers
from service.problems import Problem
from service.results import answer_bytes
from service.schemas import Health, Readiness, WorkerList, WorkerView
from service.version import VERSION
from tracer.scene import json_schema
from worker.errors import QueueError

router = APIRouter(tags=["service"])


@router.get(
    "/healthz",
    summary="Is the process alive?",
    response_model=Health,
    responses={200: {"description": "It is.", **examples.answer(examples.HEALTH)}},
)
async def get_health() -> Response:
    """Answer."""
    return JSONResponse({"status": "ok", "version": VERSION}, headers={"Cache-Control": "no-store"})


@router.get(
    "/readyz",
    summary="Can jobs be accepted and rendered?",
    response_model=Readiness,
    responses={
        200: {"description": "They can.", **examples.answer(examples.READY)},
        **problem_answers(problems.NOT_READY_SERVICE),
    },
)
async def get_readiness(context: InContext) -> Response:
    """Try the store with a write, Redis with a ping, and look for a live worker."""
    checks = await anyio.to_thread.run_sync(_check, context)
    if all(problem is None for _, problem in checks.values()):
        shown = {name: text for name, (text, _) in checks.items()}
        return JSONResponse({"status": "ready", "checks": shown}, headers={"Cache-Control": "no-store"})
    missing = ", ".join(name for name, (_, problem) in checks.items() if problem is not None)
    raise Problem(
        problems.NOT_READY_SERVICE,
        f"Not ready: {missing}.",
        headers={"Retry-After": "2"},
        extra={"checks": {name: problem or text for name, (text, problem) in checks.items()}},
    )


def _check(context: Context) -> dict[str, tuple[str, str | None]]:
    """Name of the check -> (what is fine, what is wrong or None)."""
    checks: dict[str, tuple[str, str | None]] = {"store": ("ok", _check_store(context))}
    try:
        alive = sum(worker.alive for worker in context.queue.workers())
    except QueueError:
        checks["queue"] = ("ok", "Redis does not answer")
        checks["workers"] = ("ok", "unknown: Redis does not answer")
    else:
        checks["queue"] = ("ok", None)
        checks["workers"] = (f"{alive} alive", None if alive else "none alive")
    return checks


def _check_store(context: Context) -> str | None:
    probe = context.store.temporary / f".probe-{secrets.token_hex(8)}"
    try:
        if shutil.disk_usage(context.store.root).free < MIN_FREE_BYTES:
            return "nearly full"
        probe.write_bytes(b"probe")
    except OSError as error:
        return f"not writable ({error.strerror})"
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
    return None


@router.get(
    "/v1/workers",
    summary="The live workers",
    response_model=WorkerList,
    responses={
        200: {"description": "Those heard of lately.", **examples.answer(examples.WORKERS)},
        **problem_answers(problems.QUEUE_UNAVAILABLE),
    },
)
async def list_workers(context: InContext) -> Response:
    """Return the workers heard of in the last seconds, and what they are at."""
    found = await anyio.to_thread.run_sync(context.queue.workers)
    workers = [
        WorkerView(
            name=worker.name,
            host=worker.host or None,
            pid=worker.pid or None,
            state=worker.state or None,
            job_id=worker.job,
            tile=worker.tile,
            seen_s=round(worker.seen_s, 2),
        )
        for worker in found
        if worker.alive
    ]
    return Response(
        WorkerList(workers=workers).model_dump_json(),
        media_type="application/json",
        headers={"Cache-Control": "no-store"},
    )


@router.get(
    "/v1/schema",
    response_class=Response,
    summary="JSON Schema of the scene document",
    responses={
        200: {
            "description": "Draft 2020-12.",
            "content": {"application/schema+json": {"schema": {"type": "object"}, "example": examples.SCENE_SCHEMA}},
        }
    },
)
async def get_schema(request: Request) -> Response:
    """Return the schema: types and ranges; what refers to other places of the document is checked by validate_only."""
    return answer_bytes(request, _schema_bytes(), "application/schema+json")


@cache
def _schema_bytes() -> bytes:
    return json.dumps(json_schema(), indent=1).encode()


@router.get(
    "/metrics",
    response_class=Response,
    summary="Metrics for Prometheus",
    responses={
        200: {
            "description": "Text format.",
            "content": {"text/plain": {"schema": {"type": "string"}, "example": examples.METRICS}},
        },
    },
)
async def get_metrics(context: InContext) -> Response:
    """Return the counters of this process, and what queue and store say now."""

    def collect() -> bytes:
        metrics = context.metrics
        try:
            metrics.workers.set(sum(worker.alive for worker in context.queue.workers()))
            metrics.queued_tasks.set(sum(context.queue.queue_lengths().values()))
            metrics.queue_up.set(1)
        except QueueError:
            metrics.queue_up.set(0)
        with suppress(OSError):
            metrics.store_free_bytes.set(shutil.disk_usage(context.store.root).free)
        return metrics.render()

    body = await anyio.to_thread.run_sync(collect)
    return Response(body, headers={"Content-Type": CONTENT_TYPE_LATEST, "Cache-Control": "no-store"})
