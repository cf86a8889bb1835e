"""The event stream of a job.

Job: replay the store's events after `Last-Event-ID`, then follow; progress in between.
Invariant: ids are the store's event numbers, so they are monotonic and a resume misses nothing; progress has no id, so
it never moves the point of resumption; nothing follows the terminal event.
Source: the HTML standard, server-sent events (204 tells a client not to reconnect).
"""

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated, Final

import anyio.to_thread
import structlog
from fastapi import APIRouter, Depends, Header
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.requests import Request

from service import examples, problems
from service.context import Context, InContext
from service.handlers import NothingMore
from service.middleware import HEAD_FLAG
from service.openapi import problem_answers
from service.routes.jobs import JobId
from service.schemas import Progress
from service.views import event_view, progress_view
from service.wakeups import Waiter
from worker import jobs
from worker.errors import FarmError, JobNotFoundError
from worker.records import JobEvent
from worker.states import TERMINAL, JobState

router = APIRouter(prefix="/v1", tags=["jobs"])

# Twice a second is as fast as a person reads; a client that wants the end is told by the event itself.
_PROGRESS_S: Final = 0.5
_RETRY_MS: Final = 1000

log = structlog.get_logger()


@dataclass(frozen=True)
class Resume:
    """Which job is followed, and after which event."""

    job_id: str
    after: int
    head_only: bool
    waiter: Waiter


async def find_start(
    request: Request,
    context: InContext,
    job_id: JobId,
    last_event_id: Annotated[
        str | None, Header(description="Id of the last event that the client has seen.", examples=["2"])
    ] = None,
) -> AsyncIterator[Resume]:
    """Check, before the stream begins, that there is a job and something to tell; then hold the place of one who waits.

    An id that is no event number counts as none: to tell everything again is safe.

    The place is held here and not in the stream's generator: when a client leaves while the generator is not running,
    nobody closes it before the garbage collector, but a dependency ends with its request.
    """
    after = 0
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = int(last_event_id[:18])
    last = await anyio.to_thread.run_sync(context.store.last_event, job_id)
    if last.state in TERMINAL and after >= last.seq:
        raise NothingMore
    context.metrics.event_streams.inc()
    try:
        with context.wakeups.waiting(job_id) as waiter:
            yield Resume(job_id, after, bool(request.scope.get(HEAD_FLAG)), waiter)
    finally:
        context.metrics.event_streams.dec()


@router.get(
    "/jobs/{job_id}/events",
    summary="Follow a job",
    response_class=EventSourceResponse,
    responses={
        200: {
            "description": "Server-sent events: the job's history from the start or after `Last-Event-ID`, then what "
            "happens; `progress` events, without id, in between. It ends after the terminal event.",
            "content": {"text/event-stream": {"example": examples.EVENTS}},
        },
        204: {"description": "The client has had the terminal event: nothing follows."},
        **problem_answers(problems.JOB_NOT_FOUND),
    },
)
async def follow_job(
    context: InContext, start: Annotated[Resume, Depends(find_start)]
) -> AsyncIterator[ServerSentEvent]:
    """Stream the job's events."""
    if start.head_only:
        return
    try:
        async for item in _follow(context, start):
            yield item
    except JobNotFoundError:
        return  # deleted while it was followed
    except (FarmError, OSError):
        # The stream has begun, so it can only end; the client comes back with its last id.
        log.exception("stream broken off", job_id=start.job_id)


async def _follow(context: Context, start: Resume) -> AsyncIterator[ServerSentEvent]:
    yield ServerSentEvent(retry=_RETRY_MS)
    after = start.after
    shown: Progress | None = None
    while not context.wakeups.closing:
        events, progress = await anyio.to_thread.run_sync(_look, context, start.job_id, after)
        for event in events:
            yield ServerSentEvent(id=str(event.seq), event=event.type, data=event_view(event))
            after = event.seq
            if event.state in TERMINAL:
                return
        if progress is not None and progress != shown:
            shown = progress
            state = JobState.RENDERING.value
            yield ServerSentEvent(event="progress", data={"state": state, "progress": progress.model_dump()})
        await start.waiter.wait(_PROGRESS_S)


def _look(context: Context, job_id: str, after: int) -> tuple[list[JobEvent], Progress | None]:
    """Return the events after `after`, and the progress while the job is being rendered."""
    events = context.store.events(job_id, after)
    last = events[-1] if events else context.store.last_event(job_id)
    if last.state is not JobState.RENDERING:
        return events, None
    return events, progress_view(jobs.view(context.store, context.reading_queue(), job_id).progress)
