"""Jobs: submit, look at, list, cancel, delete.

Job: the HTTP side of `worker.jobs`.
Invariant: 202 is answered after the job is on disk and not before; everything that touches the store runs in a thread.
Source: RFC 7240 (Prefer); the IETF draft on Idempotency-Key.
"""

import asyncio
import shutil
from typing import Annotated, Final

import anyio.to_thread
from fastapi import APIRouter, Header, Path, Query, Request
from fastapi.responses import Response
from starlette.requests import ClientDisconnect

from service import examples, problems
from service.bodies import read_capped, require_json
from service.conditional import parse_wait
from service.context import MIN_FREE_BYTES, OWNER, Context, InContext
from service.openapi import json_body, problem_answers
from service.parsing import fits_thread, parse_in_child
from service.problems import FieldFault, Problem
from service.results import answer_bytes
from service.schemas import Estimate, JobCreate, JobPage, JobView
from service.validation import ParsedJob, parse_job
from service.views import Snapshot, job_url, read_page, read_snapshot
from tracer.scene.faults import pointer_of
from worker import jobs
from worker.errors import IllegalTransitionError
from worker.states import TERMINAL, JobState

router = APIRouter(prefix="/v1", tags=["jobs"])

LONGEST_WAIT_S: Final = 60

JOB_ID_PATTERN: Final = "^[0-7][0-9a-hjkmnp-tv-z]{25}$"
"""What ids of jobs look like, and so cursors (see `worker.records`)."""

JobId = Annotated[str, Path(description="The job's id.", examples=[examples.JOB_ID])]


@router.post(
    "/jobs",
    summary="Submit a scene",
    status_code=202,
    response_model=JobView,
    responses={
        200: {
            "model": JobView | Estimate,
            "description": "The job ended within `Prefer: wait`; or, with `validate_only`, the estimate.",
            "content": {
                "application/json": {
                    "examples": {
                        "ended": {"value": examples.JOB_DONE},
                        "validate_only": {"value": examples.ESTIMATE},
                    }
                }
            },
        },
        202: {
            "description": "Accepted: the job is on disk.",
            "headers": {"Location": {"description": "The job's path.", "schema": {"type": "string"}}},
            **examples.answer(examples.JOB_RUNNING),
        },
        **problem_answers(
            problems.MALFORMED_JSON,
            problems.ASSETS_MISSING,
            problems.IDEMPOTENCY_IN_FLIGHT,
            problems.IDEMPOTENCY_SPENT,
            problems.TOO_LARGE,
            problems.MEDIA_TYPE_UNSUPPORTED,
            problems.SCENE_INVALID,
            problems.REQUEST_INVALID,
            problems.PARAMETERS_INVALID,
            problems.IDEMPOTENCY_MISMATCH,
            problems.STORE_UNAVAILABLE,
            problems.STORE_FULL,
        ),
    },
    openapi_extra=json_body(JobCreate, {"a red sphere": examples.JOB_CREATE}),
)
async def create_job(
    request: Request,
    context: InContext,
    validate_only: Annotated[bool, Query(description="Check and estimate; make no job.")] = False,
    idempotency_key: Annotated[
        str | None,
        Header(
            min_length=1,
            max_length=255,
            description="Sent again with the same body within a day, it gives the same job; 410 once that job was "
            "deleted.",
            examples=["4f8b0c9e-1d2a-4c56-9f0e-7a1b2c3d4e5f"],
        ),
    ] = None,
    prefer: Annotated[
        str | None,
        Header(
            description=(
                "`wait=1` to `wait=60`: answer when the job has ended. Longer ones count as 60; what is no such wait, "
                "as `wait=0` or `wait=abc`, is ignored [RFC 7240], and the answer lacks `Preference-Applied`."
            ),
            examples=["wait=30"],
        ),
    ] = None,
) -> Response:
    """Accept a job, durably, and answer at once; or wait for its end if asked to."""
    del prefer  # read below: there may be several headers of that name
    require_json(request)
    body = await read_capped(request, context.settings.max_body_bytes)
    if idempotency_key is None or validate_only:
        parsed = await _parse(context, body)
        if validate_only:
            return await _answer_estimate(context, parsed)
        submission = await _submit(context, parsed, None)
    else:
        # One request a key at a time. Another process of this API may still have the same key in hand: the store
        # decides then, and both answer with the same job.
        if idempotency_key in context.in_flight:
            raise Problem(
                problems.IDEMPOTENCY_IN_FLIGHT,
                "The first request with this Idempotency-Key has not been answered yet.",
                headers={"Retry-After": "1"},
            )
        context.in_flight.add(idempotency_key)
        try:
            submission = await _submit(context, await _parse(context, body), idempotency_key)
        finally:
            context.in_flight.discard(idempotency_key)

    headers = {"Location": job_url(submission.job_id), "Cache-Control": "no-store"}
    if submission.replayed:
        headers["Idempotency-Replayed"] = "true"
        context.metrics.jobs_replayed.inc()
    else:
        context.metrics.jobs_accepted.inc()

    wait_s = parse_wait(request.headers.getlist("prefer"), LONGEST_WAIT_S)
    if wait_s is not None:
        await _wait_for_end(request, context, submission.job_id, wait_s)
        headers["Preference-Applied"] = f"wait={wait_s}"
    snapshot = await anyio.to_thread.run_sync(read_snapshot, context, submission.job_id)
    status = 200 if wait_s is not None and snapshot.ended else 202
    return _answer_job(snapshot, status, headers)


async def _parse(context: Context, body: bytes) -> ParsedJob:
    if fits_thread(body):
        return await anyio.to_thread.run_sync(parse_job, body)
    return await parse_in_child(body, context.parsers)


async def _submit(context: Context, parsed: ParsedJob, key: str | None) -> jobs.Submission:
    """Check assets and room, and make the job durable, in one visit to a thread."""

    def submit() -> jobs.Submission:
        missing = _missing_assets(context, parsed)
        if missing:
            raise _assets_problem(missing)
        _check_room(context, parsed.estimate)
        return jobs.submit(
            context.store,
            context.queue,
            parsed.scene,
            owner=OWNER,
            name=parsed.options.name or parsed.scene.name,
            output=parsed.options.output.model_dump(),
            priority=parsed.options.priority,
            idempotency_key=key,
            request_sha256=parsed.request_sha256,
            scene_json=parsed.scene_json,
        )

    return await anyio.to_thread.run_sync(submit)


def _check_room(context: Context, estimate: Estimate) -> None:
    """Refuse a job whose tiles and pictures alone would fill the store: it would take every other job down with it."""
    free_bytes = shutil.disk_usage(context.store.root).free
    if free_bytes < estimate.store_bytes + MIN_FREE_BYTES:
        raise Problem(
            problems.STORE_FULL,
            f"The job needs {estimate.store_bytes} bytes of the store, and {MIN_FREE_BYTES} must stay free beside it; "
            f"{free_bytes} are. Render fewer pixels (image.crop), or delete jobs that have ended.",
            extra={"needed_bytes": estimate.store_bytes + MIN_FREE_BYTES, "free_bytes": free_bytes},
        )


def _missing_assets(context: Context, parsed: ParsedJob) -> dict[str, list[str]]:
    """Name in the scene's table -> those of its hashes that the store does not have."""
    found = {}
    for name, hashes in parsed.assets.items():
        missing = [sha256 for sha256 in hashes if not context.store.has_asset(sha256)]
        if missing:
            found[name] = missing
    return found


def _assets_problem(missing: dict[str, list[str]]) -> Problem:
    hashes = list(dict.fromkeys(sha256 for each in missing.values() for sha256 in each))
    return Problem(
        problems.ASSETS_MISSING,
        f"{len(hashes)} file(s) are not in the store: upload them, then send the request again.",
        errors=[
            FieldFault(
                "/scene" + pointer_of("assets", name),
                f"is not in the store: {', '.join(each[:4])}{' and more' if len(each) > 4 else ''}",
                "an uploaded asset: PUT /v1/assets/{sha256} first",
            )
            for name, each in missing.items()
        ],
        extra={"missing": hashes},
    )


async def _answer_estimate(context: Context, parsed: ParsedJob) -> Response:
    missing = await anyio.to_thread.run_sync(_missing_assets, context, parsed)
    estimate = parsed.estimate.model_copy(update={"assets_missing": sorted(missing)})
    return Response(estimate.model_dump_json(), media_type="application/json", headers={"Cache-Control": "no-store"})


async def _wait_for_end(request: Request, context: Context, job_id: str, wait_s: float) -> None:
    """Wait until the job has ended, the time is over, the client is gone or the service stops."""
    deadline = asyncio.get_running_loop().time() + wait_s
    with context.wakeups.waiting(job_id, end_only=True) as waiter:
        while not context.wakeups.closing:
            event = await anyio.to_thread.run_sync(context.store.last_event, job_id)
            left_s = deadline - asyncio.get_running_loop().time()
            if event.state in TERMINAL or left_s <= 0:
                return
            if not await waiter.wait(left_s) and await request.is_disconnected():
                raise ClientDisconnect


def _answer_job(snapshot: Snapshot, status: int, headers: dict[str, str]) -> Response:
    return Response(snapshot.view.model_dump_json(), status_code=status, media_type="application/json", headers=headers)


@router.get(
    "/jobs",
    summary="List jobs, newest first",
    response_model=JobPage,
    responses={
        200: {"description": "A page.", **examples.answer(examples.JOB_PAGE)},
        **problem_answers(problems.PARAMETERS_INVALID),
    },
)
async def list_jobs(
    request: Request,
    context: InContext,
    state: Annotated[JobState | None, Query(description="Only jobs in this state.")] = None,
    cursor: Annotated[
        str | None,
        Query(pattern=JOB_ID_PATTERN, description="`next_cursor` of the page before.", examples=[examples.JOB_ID]),
    ] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="Most jobs of a page.")] = 50,
) -> Response:
    """Return a page. It may be short and still have a next one: the scan for a rare state is bounded in time."""
    page = await anyio.to_thread.run_sync(read_page, context, state, cursor, limit)
    return answer_bytes(request, page.model_dump_json().encode(), "application/json")


@router.get(
    "/jobs/{job_id}",
    summary="State and progress of a job",
    response_model=JobView,
    responses={
        200: {"description": "The job.", **examples.answer(examples.JOB_RUNNING)},
        304: {"description": "Unchanged since the ETag in If-None-Match."},
        **problem_answers(problems.JOB_NOT_FOUND),
    },
)
async def get_job(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return the job as it stands, with a strong ETag."""
    snapshot = await anyio.to_thread.run_sync(read_snapshot, context, job_id)
    return answer_bytes(request, snapshot.view.model_dump_json().encode(), "application/json")


@router.post(
    "/jobs/{job_id}/cancel",
    summary="Cancel a job",
    status_code=202,
    response_model=JobView,
    responses={
        202: {
            "description": "It is being canceled, or is canceled already: `state` tells.",
            **examples.answer({**examples.JOB_RUNNING, "state": "canceling"}),
        },
        **problem_answers(problems.JOB_NOT_FOUND, problems.ILLEGAL_TRANSITION),
    },
)
async def cancel_job(context: InContext, job_id: JobId) -> Response:
    """Stop a job: kernels end within about a second. Asked again, meanwhile or after, the answer is 202 as well.

    So a request whose answer was lost can be sent again. A job that succeeded or failed gives 409.
    """

    def cancel() -> Snapshot:
        try:
            jobs.cancel(context.store, context.queue, job_id)
        except IllegalTransitionError as error:
            if error.current is not JobState.CANCELED:
                raise
        return read_snapshot(context, job_id)

    snapshot = await anyio.to_thread.run_sync(cancel)
    return _answer_job(snapshot, 202, {"Location": job_url(job_id), "Cache-Control": "no-store"})


@router.delete(
    "/jobs/{job_id}",
    summary="Remove a job and its results",
    status_code=204,
    responses={204: {"description": "Gone."}, **problem_answers(problems.JOB_NOT_FOUND, problems.JOB_RUNNING)},
)
async def delete_job(context: InContext, job_id: JobId) -> Response:
    """Remove a job that has ended; 409 while it runs. Its Idempotency-Key stays spent for the rest of its day."""
    await anyio.to_thread.run_sync(jobs.delete, context.store, context.queue, job_id)
    return Response(status_code=204)
