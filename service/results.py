"""Files as answers: strong validators, digests, ranges.

Job: send a file of the store, whole or a slice.
Invariant: the file is opened before the first byte of the answer, so a job deleted meanwhile is still sent whole; its
hash is computed once per file and process, because results are written once.
Source: RFC 9110 sections 13 and 14, RFC 9530.
"""

import hashlib
import os
import threading
from collections import OrderedDict
from pathlib import Path
from typing import NamedTuple

import anyio.to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from service import problems
from service.conditional import ByteRange, RangeError, matches_none, parse_range, repr_digest, strong_etag
from service.middleware import HEAD_FLAG
from service.problems import Problem

# One thread hop (about 0.1 ms) a piece: 1 MiB keeps that below a tenth of the copying.
_PIECE_BYTES = 1 << 20
_REMEMBERED_DIGESTS = 4096


class OpenFile(NamedTuple):
    """A file that is open for reading, its size and the SHA-256 of its content in hexadecimal."""

    descriptor: int
    size: int
    sha256: str


class Digests:
    """SHA-256 of result files, remembered by inode, size and time of change."""

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[int, int, int, int], str] = OrderedDict()
        self._lock = threading.Lock()

    def open(self, path: Path) -> OpenFile:
        """Open a file and tell its size and hash; FileNotFoundError where there is none."""
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            key = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
            with self._lock:
                known = self._known.get(key)
            if known is None:
                with os.fdopen(os.dup(descriptor), "rb") as file:
                    known = hashlib.file_digest(file, "sha256").hexdigest()
                with self._lock:
                    self._known[key] = known
                    while len(self._known) > _REMEMBERED_DIGESTS:
                        self._known.popitem(last=False)
            return OpenFile(descriptor, status.st_size, known)
        except BaseException:
            os.close(descriptor)
            raise


class FileAnswer(Response):
    """A slice of an open file as the body; closes the file at the end, whatever happens."""

    def __init__(self, file: OpenFile, part: ByteRange, status_code: int, headers: dict[str, str]) -> None:
        self._file = file
        self._part = part
        self.background = None
        self.body = b""
        self.status_code = status_code
        self.init_headers({**headers, "Content-Length": str(part.length)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the slice."""
        del receive  # there is nothing more to hear
        try:
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            offset, left = self._part.start, 0 if scope.get(HEAD_FLAG) else self._part.length
            while left:
                piece = await anyio.to_thread.run_sync(os.pread, self._file.descriptor, min(left, _PIECE_BYTES), offset)
                if not piece:
                    raise OSError("the file became shorter while it was sent")
                offset += len(piece)
                left -= len(piece)
                await send({"type": "http.response.body", "body": piece, "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            os.close(self._file.descriptor)


def answer_file(request: Request, file: OpenFile, media_type: str, filename: str) -> Response:
    """Return the answer for a file: 304, 206 or 200; raises the 416 problem."""
    etag = strong_etag(file.sha256)
    headers = {
        "ETag": etag,
        "Repr-Digest": repr_digest(file.sha256),
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",  # ask again each time: a deleted job's picture must not live on
        "Content-Type": media_type,
        "Content-Disposition": f'inline; filename="{filename}"',
    }
    try:
        if matches_none(request.headers.get("if-none-match"), etag):
            os.close(file.descriptor)
            del headers["Content-Type"], headers["Content-Disposition"]
            return Response(status_code=304, headers=headers)
        part = parse_range(request.headers.get("range"), request.headers.get("if-range"), etag, file.size)
    except RangeError:
        os.close(file.descriptor)
        raise Problem(
            problems.RANGE_NOT_SATISFIABLE,
            f"The file has {file.size} bytes.",
            headers={"Content-Range": f"bytes */{file.size}"},
        ) from None
    if part is None:
        return FileAnswer(file, ByteRange(0, file.size), 200, headers)
    headers["Content-Range"] = f"bytes {part.start}-{part.start + part.length - 1}/{file.size}"
    return FileAnswer(file, part, 206, headers)


def answer_bytes(request: Request, body: bytes, media_type: str, headers: dict[str, str] | None = None) -> Response:
    """Return a small answer with a strong ETag of its bytes, or 304."""
    etag = strong_etag(hashlib.sha256(body).hexdigest())
    all_headers = {"ETag": etag, "Cache-Control": "private, no-cache", **(headers or {})}
    if matches_none(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=all_headers)
    return Response(body, media_type=media_type, headers=all_headers)
