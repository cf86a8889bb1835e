"""What surrounds every request: id, host and origin checks, HEAD, security headers, access log, the last net.

Job: one pure ASGI wrapper, the outermost of ours, so that it sees every answer, those of other layers included.
Invariant: no exception leaves it; a request ends in an answer of the app or in a problem document with a request id.
Source: RFC 9110 (HEAD), the Fetch standard (Sec-Fetch-Site), RFC 9457.
"""

import re
import secrets
import time
from typing import Final

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import problems
from service.metrics import Metrics
from service.problems import Problem, render_problem

HEAD_FLAG: Final = "smalti.head"
"""Scope key: true when the client sent HEAD; routes with costly bodies read it and leave the body out."""
REQUEST_ID: Final = "smalti.request_id"
"""Scope key: the id of this request, as in the header X-Request-ID and in the log."""

SECURITY_HEADERS: Final = {
    # Nothing from elsewhere, no inline script, no frames, no forms: the page's own files and this API are all there is.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

_LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})
_SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")

log = structlog.get_logger()


def host_name(host_header: str) -> str:
    """Return the name in a ``Host`` header without the port, in lower case."""
    host = host_header.strip().lower()
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


class SurroundMiddleware:
    """The wrapper described above.

    Parameters
    ----------
    app
        What it surrounds.
    metrics
        Where requests are counted.
    allowed_hosts
        Names that ``Host`` may hold beside the loopback names; ``*`` allows all.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics, allowed_hosts: frozenset[str]) -> None:
        self.app = app
        self.metrics = metrics
        self.allowed_hosts = allowed_hosts

    def refusal(self, method: str, headers: Headers) -> Problem | None:
        """Return why a request is not even looked at, or None."""
        if "*" not in self.allowed_hosts:
            name = host_name(headers.get("host", ""))
            if name not in _LOOPBACK_NAMES and name not in self.allowed_hosts:
                return Problem(problems.HOST_REFUSED, "Add the name to SMALTI_ALLOWED_HOSTS if it is meant.")
        if method not in _SAFE_METHODS and headers.get("sec-fetch-site") in {"cross-site", "same-site"}:
            return Problem(problems.CROSS_SITE, "Only pages of this service, and programs, may change something here.")
        return None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1000, "reason": ""})
            return
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        headers = Headers(scope=scope)
        method: str = scope["method"]
        request_id = headers.get("x-request-id", "")
        if not _REQUEST_ID.fullmatch(request_id):
            request_id = secrets.token_hex(8)
        # A copy: the server goes on reading its own scope, where the method must stay HEAD.
        scope = {**scope, REQUEST_ID: request_id, HEAD_FLAG: method == "HEAD"}
        if method == "HEAD":  # HEAD is GET without the body, for every route alike
            scope["method"] = "GET"

        started = time.perf_counter()
        status = 0

        async def send_dressed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                answer = MutableHeaders(raw=message["headers"])
                for name, value in SECURITY_HEADERS.items():
                    answer.setdefault(name, value)
                answer["X-Request-ID"] = request_id
            elif message["type"] == "http.response.body" and scope[HEAD_FLAG]:
                message = {**message, "body": b""}
            await send(message)

        async def answer_problem(problem: Problem) -> None:
            await render_problem(problem, scope["path"], request_id)(scope, receive, send_dressed)

        try:
            refusal = self.refusal(method, headers)
            if refusal is None:
                await self.app(scope, receive, send_dressed)
            else:
                await answer_problem(refusal)
        except ClientDisconnect:
            status = status or 499  # nginx's number for "the client went away"; it is only logged
        except Exception:
            log.exception("unexpected", request_id=request_id, method=method, path=scope["path"])
            if status == 0:
                await answer_problem(
                    Problem(problems.INTERNAL, f"The log has the reason under request id {request_id}.")
                )
            else:
                # The answer has begun: breaking the connection off is the only way left to tell the client.
                raise
        finally:
            seconds = time.perf_counter() - started
            route = getattr(scope.get("route"), "path", None) or "(none)"
            self.metrics.observe_request(method, route, status, seconds)
            log.info(
                "request",
                request_id=request_id,
                method=method,
                path=scope["path"],
                status=status,
                duration_ms=round(seconds * 1000, 2),
            )
