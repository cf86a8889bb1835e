"""Request bodies: read with a byte cap, checked for their media type, parsed as strict JSON off the event loop.

Job: turn a request into bytes or a JSON value, or raise the right problem (400, 413, 415, 422).
Invariant: never more than the cap is held; nothing is parsed on the event loop beyond a few kilobytes.
FastAPI's own ``max_body_size`` is not used: where the app answers before it has read the body, that middleware
replaces the answer by a plain-text 413, and here every error is a problem document.
"""

from collections.abc import AsyncIterator
from email.message import Message
from typing import Any

import anyio.to_thread
from starlette.requests import Request

from service import problems
from service.problems import Problem
from service.validation import parse_value


def refuse_length(request: Request, limit_bytes: int) -> None:
    """Refuse a body whose announced length is over the limit, before a byte of it is read."""
    announced = request.headers.get("content-length", "")
    if announced.isascii() and announced.isdigit() and int(announced) > limit_bytes:
        raise too_large(limit_bytes)


def too_large(limit_bytes: int) -> Problem:
    """Return the 413 problem for this limit."""
    return Problem(
        problems.TOO_LARGE, f"At most {limit_bytes} bytes are accepted here.", extra={"limit_bytes": limit_bytes}
    )


async def stream_capped(request: Request, limit_bytes: int) -> AsyncIterator[bytes]:
    """Yield the body's pieces; raise 413 as soon as their sum passes the limit."""
    refuse_length(request, limit_bytes)
    total = 0
    async for piece in request.stream():
        total += len(piece)
        if total > limit_bytes:
            raise too_large(limit_bytes)
        if piece:
            yield piece


async def read_capped(request: Request, limit_bytes: int) -> bytes:
    """Return the whole body, of at most ``limit_bytes``."""
    return b"".join([piece async for piece in stream_capped(request, limit_bytes)])


def require_json(request: Request) -> None:
    """Refuse a body that does not say it is JSON in UTF-8: 415.

    This is a guard, too: a page of another site can send text/plain without asking, but not application/json.
    """
    message = Message()
    message["content-type"] = request.headers.get("content-type", "")
    subtype = message.get_content_type()
    if subtype != "application/json" and not (subtype.startswith("application/") and subtype.endswith("+json")):
        raise Problem(problems.MEDIA_TYPE_UNSUPPORTED, "The header Content-Type must be application/json.")
    charset = message.get_param("charset")
    if charset is not None and str(charset).lower().replace("-", "") not in {"utf8", "usascii"}:
        raise Problem(problems.MEDIA_TYPE_UNSUPPORTED, "JSON is sent in UTF-8.")
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding not in {"", "identity"}:
        raise Problem(problems.MEDIA_TYPE_UNSUPPORTED, "Compressed bodies are not accepted (Content-Encoding).")


async def read_json(request: Request, limit_bytes: int) -> Any:
    """Return the body as a JSON value, parsed strictly in a thread."""
    require_json(request)
    return await anyio.to_thread.run_sync(parse_value, await read_capped(request, limit_bytes))
