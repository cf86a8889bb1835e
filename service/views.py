"""From the farm's values to the API's bodies.

Job: pure translations, and the one scan that makes a page of the list.
Invariant: what a view says comes from the store; Redis only adds rates.
"""

import time
from contextlib import suppress
from typing import Final, NamedTuple

import structlog

from service.context import OWNER, Context
from service.schemas import EventView, ImageView, JobLinks, JobPage, JobProblem, JobView, Progress
from worker import contract, jobs
from worker.errors import DamagedRecordError, JobNotFoundError
from worker.records import JobEvent
from worker.states import TERMINAL, JobState

# A page ends after this time even if it is not full: a rare state among 100,000 jobs must not hold up a thread.
_SCAN_S: Final = 0.25

log = structlog.get_logger()


class Snapshot(NamedTuple):
    """A job's body, and whether it has ended."""

    view: JobView
    ended: bool


def job_url(job_id: str) -> str:
    """Return the path of a job."""
    return f"/v1/jobs/{job_id}"


def progress_view(progress: jobs.Progress) -> Progress:
    """Return the progress as the API shows it; the digits that mean nothing are cut."""
    return Progress(
        tiles_done=progress.tiles_done,
        tiles_total=progress.tiles_total,
        fraction=min(1.0, round(progress.fraction, 6)),
        rays=progress.rays,
        rays_per_s=None if progress.rays_per_s is None else round(progress.rays_per_s, 1),
        eta_s=None if progress.eta_s is None else round(progress.eta_s, 2),
    )


def job_view(found: jobs.JobView, *, has_preview: bool) -> JobView:
    """Return the body for a job; `has_preview` tells whether a job that runs has one already."""
    record, state = found.record, found.state
    url = job_url(record.id)
    done = state is JobState.SUCCEEDED
    return JobView(
        id=record.id,
        name=record.name,
        state=state,
        created_at=record.created_at,
        updated_at=found.updated_at,
        progress=progress_view(found.progress),
        image=ImageView(width=record.width, height=record.height),
        samples=record.samples,
        problem=None if found.problem is None else _problem_view(found.problem),
        links=JobLinks(
            self=url,
            events=f"{url}/events",
            scene=f"{url}/scene",
            cancel=None if state in TERMINAL or state is JobState.CANCELING else f"{url}/cancel",
            result_png=f"{url}/result.png" if done else None,
            result_exr=f"{url}/result.exr" if done else None,
            preview_png=f"{url}/preview.png" if done or has_preview else None,
            report=f"{url}/report" if done else None,
        ),
    )


def _problem_view(problem: object) -> JobProblem:
    """Return a failed job's problem, complete even where a worker left members out."""
    default = {"type": f"{contract.PROBLEM_PREFIX}job-failed", "title": "The job failed"}
    return JobProblem.model_validate({**default, **(dict(problem) if isinstance(problem, dict) else {})})


def read_snapshot(context: Context, job_id: str) -> Snapshot:
    """Return a job as it stands; `JobNotFoundError` where there is none."""
    found = jobs.view(context.store, context.reading_queue(), job_id)
    return Snapshot(_view(context, found), found.state in TERMINAL)


def _view(context: Context, found: jobs.JobView) -> JobView:
    runs = found.state in {JobState.RENDERING, JobState.ASSEMBLING}
    return job_view(found, has_preview=runs and context.store.has_result(found.record.id, contract.PREVIEW_PNG))


def event_view(event: JobEvent) -> EventView:
    """Return an event as the stream sends it."""
    return EventView(
        seq=event.seq,
        at=event.at,
        type=event.type,
        state=event.state,
        previous=event.previous,
        by=event.by,
        detail=None if event.detail is None else dict(event.detail),
    )


def read_page(context: Context, state: JobState | None, before: str | None, limit: int) -> JobPage:
    """Return a page of jobs, newest first.

    A page may hold fewer jobs than asked for, none even, and still name a next cursor: the scan for a rare state ends
    after a quarter of a second. Jobs that cannot be read are left out and logged: one must not hide the others.
    """
    found: list[JobView] = []
    queue = context.reading_queue()
    deadline = time.monotonic() + _SCAN_S
    last: str | None = None
    for job_id in context.store.job_ids(before=before):
        if last is not None and (len(found) >= limit or time.monotonic() > deadline):
            return JobPage(jobs=found, next_cursor=last)
        last = job_id
        try:
            with suppress(JobNotFoundError):  # deleted meanwhile
                if state is not None and context.store.last_event(job_id).state is not state:
                    continue
                view = jobs.view(context.store, queue, job_id)
                if view.record.owner == OWNER and state in {None, view.state}:
                    found.append(_view(context, view))
        except (DamagedRecordError, OSError):
            log.exception("job cannot be read", job_id=job_id)
    return JobPage(jobs=found, next_cursor=None)
