"""Assets: which are missing, and taking them in.

Job: the two calls by which a client brings files to the store before it names them in a scene.
Invariant: content-addressed; what lies under a hash has that hash. An upload holds one piece at a time in memory, and
a thread no longer than its client goes on sending.
"""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Final

import anyio.to_thread
from fastapi import APIRouter, Path, Request
from fastapi.responses import JSONResponse, Response

from service import examples, problems
from service.bodies import read_json, refuse_length, stream_capped, too_large
from service.context import Context, InContext
from service.openapi import json_body, problem_answers
from service.problems import FieldFault, Problem
from service.schemas import AssetAnswer, AssetQuery, AssetView
from service.validation import validate_body
from tracer.scene.faults import shown
from worker.errors import AssetTooLargeError, BadNameError
from worker.records import check_sha256

router = APIRouter(prefix="/v1", tags=["assets"])

# 10,000 hashes of 64 digits with their quotes and commas are 670 kB.
_MAX_QUERY_BYTES = 1 << 20
# A hop to the writing thread costs about 0.1 ms, so small network reads are gathered first.
_PIECE_BYTES = 1 << 20
# Longest silence of a client within its upload: longer than a lost packet takes on a bad line, and far from for ever.
SILENCE_S: Final = 30.0

Sha256Path = Annotated[
    str,
    Path(
        description="SHA-256 of the content, 64 lowercase hexadecimal digits.",
        json_schema_extra={"pattern": "^[0-9a-f]{64}$"},
        examples=[examples.SHA256],
    ),
]


@router.post(
    "/assets:missing",
    summary="Which of these assets are missing?",
    response_model=AssetAnswer,
    responses={
        200: {"description": "Those that are missing.", **examples.answer(examples.ASSETS_MISSING)},
        **problem_answers(
            problems.MALFORMED_JSON, problems.TOO_LARGE, problems.MEDIA_TYPE_UNSUPPORTED, problems.REQUEST_INVALID
        ),
    },
    openapi_extra=json_body(AssetQuery, {"two": examples.ASSETS_QUERY}),
)
async def find_missing(request: Request, context: InContext) -> Response:
    """Tell which hashes the store does not have, so that a client uploads those only."""
    body = await read_json(request, _MAX_QUERY_BYTES)
    query = validate_body(AssetQuery, body)

    def look() -> list[str]:
        return [sha256 for sha256 in dict.fromkeys(query.sha256) if not context.store.has_asset(sha256)]

    return JSONResponse({"missing": await anyio.to_thread.run_sync(look)})


@router.put(
    "/assets/{sha256}",
    summary="Upload an asset",
    response_model=AssetView,
    status_code=201,
    responses={
        200: {"model": AssetView, "description": "It was here already.", **examples.answer(examples.ASSET_PRESENT)},
        201: {"description": "Stored.", **examples.answer(examples.ASSET_CREATED)},
        **problem_answers(
            problems.UPLOAD_STALLED,
            problems.TOO_LARGE,
            problems.HASH_MISMATCH,
            problems.STORE_UNAVAILABLE,
            problems.STORE_FULL,
        ),
    },
    openapi_extra={
        "requestBody": {
            "description": "The file's bytes, as they are.",
            "required": True,
            "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def put_asset(request: Request, context: InContext, sha256: Sha256Path) -> Response:
    """Store a file under its hash. The same upload again is answered with 200; other bytes with 422."""
    try:
        check_sha256(sha256)
    except BadNameError:
        fault = FieldFault("/path/sha256", f"is {shown(sha256)}", "64 lowercase hexadecimal digits")
        raise Problem(problems.HASH_MISMATCH, "The URL must end in the content's SHA-256.", errors=[fault]) from None
    limit_bytes = context.settings.max_asset_bytes
    refuse_length(request, limit_bytes)
    if await anyio.to_thread.run_sync(context.store.has_asset, sha256):
        # A client that asked first (Expect: 100-continue) need not send it at all.
        if request.headers.get("expect", "").lower() != "100-continue":
            await _check_only(stream_capped(request, limit_bytes), sha256)
        created = False
    else:
        created = await _take_in(context, request, sha256, limit_bytes)
    size_bytes = (await anyio.to_thread.run_sync(context.store.asset_path, sha256)).stat().st_size
    if created:
        context.metrics.asset_bytes.inc(size_bytes)
    view = AssetView(sha256=sha256, size_bytes=size_bytes, created=created)
    return JSONResponse(view.model_dump(), status_code=201 if created else 200)


async def _check_only(pieces: AsyncIterator[bytes], sha256: str) -> None:
    """Read a body whose content is here already: a wrong one is an error of the client worth telling."""
    digest = hashlib.sha256()
    async for piece in _gather(pieces):
        await anyio.to_thread.run_sync(digest.update, piece)
    if digest.hexdigest() != sha256:
        raise Problem(problems.HASH_MISMATCH, f"The bytes have SHA-256 {digest.hexdigest()}, not {sha256}.")


async def _take_in(context: Context, request: Request, sha256: str, limit_bytes: int) -> bool:
    """Hand the body, piece by piece, to the store in a thread; True if the asset is new."""
    loop = asyncio.get_running_loop()
    pieces = _gather(stream_capped(request, limit_bytes))

    def chunks() -> Iterator[bytes]:
        # The store pulls, so the network is read no faster than the disk writes.
        while (piece := asyncio.run_coroutine_threadsafe(_next_gathered(pieces), loop).result()) is not None:
            yield piece

    try:
        return await anyio.to_thread.run_sync(
            context.store.put_asset, sha256, chunks(), limit_bytes, limiter=context.uploads
        )
    except AssetTooLargeError:
        raise too_large(limit_bytes) from None


async def _next_gathered(pieces: AsyncIterator[bytes]) -> bytes | None:
    return await anext(pieces, None)


async def _next_read(pieces: AsyncIterator[bytes]) -> bytes | None:
    """Return what the network brings next; None at the end.

    Raises
    ------
    Problem
        408 when the client has gone silent. Not a TimeoutError: that is an OSError, which is taken for the store's.
    """
    try:
        async with asyncio.timeout(SILENCE_S):
            return await anext(pieces, None)
    except TimeoutError:
        raise Problem(
            problems.UPLOAD_STALLED,
            f"Nothing came for {SILENCE_S:.0f} s; nothing was stored.",
            headers={"Connection": "close"},  # the rest of the body may come yet, and is no request
        ) from None


async def _gather(pieces: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Join small pieces into larger ones."""
    gathered = bytearray()
    while (piece := await _next_read(pieces)) is not None:
        gathered += piece
        if len(gathered) >= _PIECE_BYTES:
            yield bytes(gathered)
            gathered.clear()
    if gathered:
        yield bytes(gathered)
