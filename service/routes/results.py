"""What a job leaves behind: its scene, pictures and report.

Job: send files of the store with validators, digests and ranges.
Invariant: a result is there only once the job has succeeded; before, 409 tells the state. Only the preview comes early.
"""

import hashlib
from typing import Any

import anyio.to_thread
from fastapi import APIRouter, Request
from fastapi.responses import Response

from service import examples, problems
from service.conditional import repr_digest
from service.context import Context, InContext
from service.openapi import problem_answers
from service.problems import Problem
from service.results import OpenFile, answer_bytes, answer_file
from service.routes.jobs import JobId
from worker import contract
from worker.states import TERMINAL, JobState

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])


def _file_answers(media_type: str, schema: dict[str, Any]) -> dict[int | str, dict[str, Any]]:
    headers = {
        "ETag": {"description": "Strong: the SHA-256.", "schema": {"type": "string"}},
        "Repr-Digest": {"description": "SHA-256 of the whole file (RFC 9530).", "schema": {"type": "string"}},
    }
    content = {media_type: {"schema": schema}}
    return {
        200: {"description": "The file.", "headers": headers, "content": content},
        206: {"description": "The range asked for.", "headers": headers, "content": content},
        304: {"description": "Unchanged since the ETag in If-None-Match."},
        **problem_answers(
            problems.JOB_NOT_FOUND, problems.NOT_READY, problems.NO_RESULT, problems.RANGE_NOT_SATISFIABLE
        ),
    }


_BINARY = {"type": "string", "format": "binary"}


def _open_result(context: Context, job_id: str, name: str) -> OpenFile:
    """Open a result; raises the 409 problem before there is one."""
    state = context.store.last_event(job_id).state
    # The preview grows while the job runs; the other files appear complete, with the last event.
    if state is JobState.SUCCEEDED or (name == contract.PREVIEW_PNG and context.store.has_result(job_id, name)):
        try:
            return context.digests.open(context.store.result_path(job_id, name))
        except FileNotFoundError:
            context.store.last_event(job_id)  # deleted meanwhile: this says so
            raise
    extra = {"current_state": str(state)}
    if state in TERMINAL:
        raise Problem(problems.NO_RESULT, f"The job is {state}: it has no {name}.", extra=extra)
    raise Problem(
        problems.NOT_READY, f"The job is {state}; {name} is there when it has succeeded.",
        headers={"Retry-After": "1"}, extra=extra,
    )  # fmt: skip


async def _answer(request: Request, context: Context, job_id: str, name: str, media_type: str) -> Response:
    file = await anyio.to_thread.run_sync(_open_result, context, job_id, name)
    return answer_file(request, file, media_type, f"{job_id}-{name}")


@router.get(
    "/result.png",
    response_class=Response,
    summary="The picture, 8 bits a channel",
    responses=_file_answers("image/png", _BINARY),
)
async def get_png(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return the PNG: clamped, sRGB unless linear was asked for."""
    return await _answer(request, context, job_id, contract.RESULT_PNG, "image/png")


@router.get(
    "/result.exr",
    response_class=Response,
    summary="The picture, float32, linear",
    responses=_file_answers("image/x-exr", _BINARY),
)
async def get_exr(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return the OpenEXR file."""
    return await _answer(request, context, job_id, contract.RESULT_EXR, "image/x-exr")


@router.get(
    "/preview.png", response_class=Response, summary="A small picture", responses=_file_answers("image/png", _BINARY)
)
async def get_preview(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return a preview of at most 512 pixels a side; before the end, of the rows done so far."""
    return await _answer(request, context, job_id, contract.PREVIEW_PNG, "image/png")


@router.get(
    "/report",
    response_class=Response,
    summary="Where the time went, and what was skipped",
    responses=_file_answers("application/json", {"type": "object", "examples": [examples.REPORT]}),
)
async def get_report(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return the report of a job that has succeeded."""
    return await _answer(request, context, job_id, contract.REPORT, "application/json")


@router.get(
    "/scene",
    response_class=Response,
    summary="The scene as accepted",
    responses={
        200: {
            "description": "The canonical document; its SHA-256 is the scene's hash.",
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/SceneDoc"}}},
        },
        304: {"description": "Unchanged since the ETag in If-None-Match."},
        **problem_answers(problems.JOB_NOT_FOUND),
    },
)
async def get_scene(request: Request, context: InContext, job_id: JobId) -> Response:
    """Return the scene in canonical JSON."""

    def read() -> tuple[bytes, str]:
        scene_json = context.store.read_scene(job_id)
        return scene_json, hashlib.sha256(scene_json).hexdigest()

    scene_json, sha256 = await anyio.to_thread.run_sync(read)
    return answer_bytes(request, scene_json, "application/json", {"Repr-Digest": repr_digest(sha256)})
