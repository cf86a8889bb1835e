"""From exceptions to problems: one table, one handler each.

Job: translate what the farm, the framework and the operating system raise into the problem documents of the API.
Invariant: the text of an unexpected error never reaches a client; it goes to the log, under the request's id.
Source: RFC 9457; the error hierarchy in worker/errors.py.
"""

import errno
from collections.abc import Sequence
from typing import Annotated, Any, cast

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import TypeAdapter
from pydantic.fields import FieldInfo
from redis.exceptions import RedisError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import BaseRoute, Match, Route

from service import problems
from service.middleware import REQUEST_ID
from service.problems import Problem, ProblemType, render_problem
from service.validation import invalid
from tracer.scene.faults import Fault, pointer_of, shown
from tracer.scene.schema import Schema, described, without_references
from worker import errors
from worker.jobs import KeySpentError

log = structlog.get_logger()

_RETRY = {"Retry-After": "2"}
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


class NothingMore(Exception):  # noqa: N818 - not an error: the stream is over
    """The client has had the last event of a stream: 204 tells an EventSource to stay away."""


def answer(request: Request, problem: Problem) -> Response:
    """Return the answer for a problem of this request."""
    return render_problem(problem, request.scope["path"], request.scope.get(REQUEST_ID))


def from_farm(error: errors.FarmError) -> Problem:
    """Return the problem for an error of the farm."""
    match error:
        case errors.JobNotFoundError() | errors.BadNameError():
            return Problem(problems.JOB_NOT_FOUND, "No job has this id; it may have been deleted.")
        case errors.IllegalTransitionError():
            return Problem(
                problems.ILLEGAL_TRANSITION,
                f"The job is {error.current}; that cannot become {error.to}.",
                extra={"current_state": str(error.current), "allowed": [str(state) for state in error.allowed]},
            )
        case errors.JobActiveError():
            return Problem(
                problems.JOB_RUNNING,
                f"The job is {error.current}: cancel it, or wait for its end.",
                extra={"current_state": str(error.current)},
            )
        case errors.HashMismatchError():
            return Problem(problems.HASH_MISMATCH, f"Nothing was stored: {error}.")
        case errors.IdempotencyConflictError():
            return Problem(
                problems.IDEMPOTENCY_MISMATCH,
                "The Idempotency-Key belongs to a request with another body: use a new key.",
            )
        case KeySpentError():
            return Problem(
                problems.IDEMPOTENCY_SPENT,
                "This request was accepted before and its job was deleted: use a new Idempotency-Key to render again.",
            )
        case errors.StoreFullError():
            return Problem(
                problems.STORE_FULL,
                "The store has no space left; nothing was accepted. Delete jobs that have ended, or free some space.",
                headers=_RETRY,
            )
        case errors.QueueError():
            return Problem(problems.QUEUE_UNAVAILABLE, "Redis does not answer for now.", headers=_RETRY)
        case errors.DamagedRecordError():
            log.error("damaged record", error=str(error))
            return Problem(problems.RECORD_DAMAGED, "A file of this job in the store cannot be read back.")
    log.error("farm error", error=repr(error))
    return Problem(problems.STORE_UNAVAILABLE, "The store could not do what was asked.", headers=_RETRY)


def from_validation(request: Request, error: RequestValidationError) -> Problem:
    """Return the problem for query parameters and headers that FastAPI refused."""
    dependant = cast("APIRoute", request.scope["route"]).dependant
    expected = {
        (place, field.alias): described(_schema_of_parameter(field.field_info))
        for place, fields in (("query", dependant.query_params), ("header", dependant.header_params))
        for field in fields
    }
    faults = []
    for item in error.errors():
        place, name = item["loc"][:2]
        faults.append(Fault(pointer_of(place, name), f"is {shown(item['input'])}", expected[place, name]))
    return invalid(problems.PARAMETERS_INVALID, faults)


def _schema_of_parameter(info: FieldInfo) -> Schema:
    kind: Any = Annotated[info.annotation, info]
    schema = without_references(TypeAdapter(kind).json_schema())
    options = [option for option in schema.pop("anyOf", ()) if option != {"type": "null"}]
    return {**options[0], **schema} if options else schema  # the description of an enum's class is for programmers


def from_http(request: Request, error: HTTPException, routes: Sequence[BaseRoute]) -> Problem:
    """Return the problem for what the framework refused: unknown route, wrong method."""
    if error.status_code == 404:
        return Problem(problems.ROUTE_NOT_FOUND, "The API reference is at /docs.")
    if error.status_code == 405:
        allow = ", ".join(sorted(allowed_methods(request, routes)))
        return Problem(problems.METHOD_NOT_ALLOWED, f"Allowed here: {allow}.", headers={"Allow": allow})
    by_status: dict[int, ProblemType] = {413: problems.TOO_LARGE, 415: problems.MEDIA_TYPE_UNSUPPORTED}
    return Problem(by_status.get(error.status_code, problems.BAD_REQUEST), str(error.detail))


def allowed_methods(request: Request, routes: Sequence[BaseRoute]) -> set[str]:
    """Return every method that a route answers at the request's path; the framework tells those of the first only."""
    methods: set[str] = set()
    for route in routes:
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE:
            methods |= route.methods or set()
    return methods | {"HEAD"} if "GET" in methods else methods


def install_handlers(app: FastAPI, routes: Sequence[BaseRoute]) -> None:
    """Register the handlers; `routes` are those that ``Allow`` is made from."""

    async def on_problem(request: Request, error: Exception) -> Response:
        return answer(request, cast("Problem", error))

    async def on_farm(request: Request, error: Exception) -> Response:
        return answer(request, from_farm(cast("errors.FarmError", error)))

    async def on_validation(request: Request, error: Exception) -> Response:
        return answer(request, from_validation(request, cast("RequestValidationError", error)))

    async def on_http(request: Request, error: Exception) -> Response:
        return answer(request, from_http(request, cast("HTTPException", error), routes))

    async def on_redis(request: Request, error: Exception) -> Response:
        # Refusals of a server that does answer: still loading, read only, its disk full.
        log.error("redis refused", error=repr(error), request_id=request.scope.get(REQUEST_ID))
        return answer(request, from_farm(errors.QueueError()))

    async def on_os(request: Request, error: Exception) -> Response:
        if cast("OSError", error).errno in _FULL:
            return answer(request, from_farm(errors.StoreFullError()))
        log.error("store error", error=repr(error), request_id=request.scope.get(REQUEST_ID))
        return answer(
            request, Problem(problems.STORE_UNAVAILABLE, "Reading or writing the store failed.", headers=_RETRY)
        )

    async def on_nothing_more(_request: Request, _error: Exception) -> Response:
        return Response(status_code=204)

    handlers: dict[type[Exception], Any] = {
        Problem: on_problem,
        errors.FarmError: on_farm,
        RequestValidationError: on_validation,
        HTTPException: on_http,
        OSError: on_os,
        RedisError: on_redis,
        NothingMore: on_nothing_more,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)
