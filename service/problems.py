"""Errors as RFC 9457 problem documents: the catalogue of types, the exception, and the answer.

Job: every answer of 400 and above has the media type ``application/problem+json`` and one of the types below.
Invariant: a type's name and status never change once released; clients branch on ``type``, people read ``detail``.
Source: RFC 9457 (problem details), RFC 6901 (the JSON pointers in ``errors``).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from starlette.responses import Response

from worker.contract import PROBLEM_PREFIX

MEDIA_TYPE: Final = "application/problem+json"


@dataclass(frozen=True)
class ProblemType:
    """One kind of problem: its stable name, the title, the HTTP status and when it occurs."""

    slug: str
    status: int
    title: str
    meaning: str

    @property
    def uri(self) -> str:
        """The value of ``type`` in the document."""
        return PROBLEM_PREFIX + self.slug


@dataclass(frozen=True)
class FieldFault:
    """One fault in what the client sent: where (a JSON pointer from the body's root), what, and what would be right."""

    pointer: str
    detail: str
    expected: str

    def document(self) -> dict[str, str]:
        """Return the fault as it stands in ``errors``."""
        return {"pointer": self.pointer, "detail": self.detail, "expected": self.expected}


MALFORMED_JSON = ProblemType(
    "malformed-json", 400, "The body is not JSON", "The body is empty, not UTF-8, or breaks off."
)
BAD_REQUEST = ProblemType("bad-request", 400, "The request cannot be understood", "The request breaks HTTP's rules.")
CROSS_SITE = ProblemType(
    "cross-site-request", 403, "Refused: sent by another site", "A page of another origin tried to change something."
)
HOST_REFUSED = ProblemType(
    "host-refused", 421, "This service does not answer to that host name", "Guards a local service from DNS rebinding."
)
ROUTE_NOT_FOUND = ProblemType("route-not-found", 404, "There is nothing at this address", "No route has this path.")
JOB_NOT_FOUND = ProblemType("job-not-found", 404, "There is no such job", "The id is wrong, or the job was deleted.")
METHOD_NOT_ALLOWED = ProblemType(
    "method-not-allowed", 405, "This method is not allowed here", "The header Allow lists the methods."
)
UPLOAD_STALLED = ProblemType(
    "upload-stalled", 408, "The upload stands still", "The client stopped sending in the middle of a body."
)
ILLEGAL_TRANSITION = ProblemType(
    "illegal-transition", 409, "The job's state does not allow this", "See current_state and allowed."
)
JOB_RUNNING = ProblemType(
    "job-running", 409, "The job has not ended", "Cancel it and wait for its end before deleting it."
)
NOT_READY = ProblemType(
    "result-not-ready", 409, "The result is not there yet", "Wait for the job's end: its events tell."
)
NO_RESULT = ProblemType(
    "result-never", 409, "This job ended without a result", "It failed or was canceled: there is nothing to fetch."
)
ASSETS_MISSING = ProblemType(
    "assets-missing", 409, "Assets of the scene are not in the store", "Upload those in missing, then send it again."
)
IDEMPOTENCY_IN_FLIGHT = ProblemType(
    "idempotency-in-flight", 409, "A request with this key is being answered", "Send it again after Retry-After."
)
IDEMPOTENCY_MISMATCH = ProblemType(
    "idempotency-mismatch", 422, "This key was used for another request", "Use a new key for a new request."
)
IDEMPOTENCY_SPENT = ProblemType(
    "idempotency-spent", 410, "The job of this key was deleted", "Use a new key to render it again."
)
TOO_LARGE = ProblemType("too-large", 413, "The body is too large", "The limit, in bytes, is in limit_bytes.")
MEDIA_TYPE_UNSUPPORTED = ProblemType(
    "media-type-unsupported", 415, "The body's media type is not supported", "Send application/json, in UTF-8."
)
RANGE_NOT_SATISFIABLE = ProblemType(
    "range-not-satisfiable", 416, "The range lies outside the file", "Content-Range tells the size."
)
SCENE_INVALID = ProblemType(
    "scene-invalid", 422, "The scene document is not valid", "errors lists every fault with a JSON pointer."
)
REQUEST_INVALID = ProblemType(
    "request-invalid", 422, "The request is not valid", "errors lists every fault of the body."
)
PARAMETERS_INVALID = ProblemType(
    "parameters-invalid", 422, "A parameter is not valid", "errors lists the query parameters and headers."
)
HASH_MISMATCH = ProblemType(
    "hash-mismatch", 422, "The content does not have this SHA-256", "The bytes that arrived have another hash."
)
INTERNAL = ProblemType(
    "internal-error", 500, "Something went wrong here", "A fault of the service; request_id finds it in the log."
)
RECORD_DAMAGED = ProblemType(
    "record-damaged", 500, "A file of the store is damaged", "The other jobs are not concerned; the log has the file."
)
QUEUE_UNAVAILABLE = ProblemType(
    "queue-unavailable", 503, "The queue cannot be reached", "Redis is away for now; jobs in the store are safe."
)
STORE_UNAVAILABLE = ProblemType(
    "store-unavailable", 503, "The store cannot be used", "Reading or writing the store failed."
)
NOT_READY_SERVICE = ProblemType(
    "service-not-ready", 503, "The service is not ready", "checks tells which part is missing."
)
STORE_FULL = ProblemType("store-full", 507, "The store is full", "Nothing was accepted; free some space first.")

CATALOGUE: Final[tuple[ProblemType, ...]] = tuple(
    sorted(
        (value for value in list(globals().values()) if isinstance(value, ProblemType)),
        key=lambda kind: (kind.status, kind.slug),
    )
)


@dataclass(eq=False)
class Problem(Exception):  # noqa: N818 - RFC 9457 calls it a problem
    """A problem on its way to the client: raised anywhere in a route, rendered by the app's handler.

    Parameters
    ----------
    kind
        The type out of the catalogue.
    detail
        What happened in this case, for a person; never a path of this machine, never a secret.
    errors
        Every fault found, in the order of the document.
    headers
        Headers of the answer, such as ``Retry-After`` (seconds).
    extra
        Further members of the document, such as ``current_state``.
    """

    kind: ProblemType
    detail: str
    errors: Sequence[FieldFault] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def document(self, instance: str, request_id: str | None = None) -> dict[str, Any]:
        """Return the members of the problem document."""
        document: dict[str, Any] = {
            "type": self.kind.uri,
            "title": self.kind.title,
            "status": self.kind.status,
            "detail": self.detail,
            "instance": instance,
        }
        if self.errors:
            document["errors"] = [fault.document() for fault in self.errors]
        document.update(self.extra)
        if request_id is not None:
            document["request_id"] = request_id
        return document


def render_problem(problem: Problem, instance: str, request_id: str | None = None) -> Response:
    """Return the answer for a problem.

    Lone surrogates in a client's text would make UTF-8 fail, so the JSON is pure ASCII.
    """
    body = json.dumps(problem.document(instance, request_id), ensure_ascii=True, allow_nan=False).encode("ascii")
    headers = {**problem.headers, "Cache-Control": "no-store"}
    return Response(body, status_code=problem.kind.status, media_type=MEDIA_TYPE, headers=headers)
