"""Download of a result to a file: streamed, resumed, checked, and put in place whole.

Invariants: the target is either its old self or the complete new file (temporary name, then rename); a file whose
`Repr-Digest` (RFC 9530) does not match never gets there; after a broken connection only the missing bytes are asked for
(`Range` with `If-Range`, RFC 9110).
"""

import base64
import hashlib
import os
import tempfile
from pathlib import Path
from typing import BinaryIO

from client.errors import DownloadError
from client.http import httpx
from client.transport import Transport

TRIES = 5


def parse_repr_digest(value: str | None) -> bytes | None:
    """Read the SHA-256 of a `Repr-Digest` header (`sha-256=:base64:`); None when it has none."""
    for member in (value or "").split(","):
        name, _, item = member.strip().partition("=")
        if name.strip().lower() == "sha-256" and item.startswith(":") and item.rstrip().endswith(":"):
            try:
                return base64.b64decode(item.strip()[1:-1], validate=True)
            except ValueError:
                return None
    return None


class _Part:
    """The part of the file that has arrived, and the hash over it."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.size = 0
        self.hash = hashlib.sha256()
        self.etag: str | None = None
        self.digest: bytes | None = None

    def restart(self) -> None:
        self.file.seek(0)
        self.file.truncate()
        self.size = 0
        self.hash = hashlib.sha256()

    def request_headers(self) -> dict[str, str]:
        headers = {"Accept": "*/*", "Accept-Encoding": "identity"}  # ranges and digests are of the plain bytes
        if self.size and self.etag:
            headers |= {"Range": f"bytes={self.size}-", "If-Range": self.etag}
        return headers

    def read_from(self, response: httpx.Response) -> None:
        if response.status_code != 206:
            self.restart()
        elif not response.headers.get("Content-Range", "").startswith(f"bytes {self.size}-"):
            self.restart()
            raise httpx.RemoteProtocolError("another range came than the one asked for")
        self.etag = response.headers.get("ETag")
        self.digest = parse_repr_digest(response.headers.get("Repr-Digest")) or self.digest
        for chunk in response.iter_raw():  # as it comes: chunks of a given size are lost when it breaks off
            self.file.write(chunk)
            self.hash.update(chunk)
            self.size += len(chunk)


def _fetch(transport: Transport, path: str, part: _Part) -> None:
    for attempt in range(TRIES):
        try:
            with transport.stream(path, headers=part.request_headers()) as response:
                part.read_from(response)
        except httpx.TransportError as error:
            if attempt + 1 == TRIES:
                raise transport.not_reachable(error) from error
            transport.pause(attempt)
        else:
            return


def download(transport: Transport, path: str, target: Path) -> int:
    """Fetch `path` of the service into the file `target`.

    Parameters
    ----------
    path : str
        Path of the URL, such as `/v1/jobs/ID/result.png`.
    target : Path
        File to write; its folder is made when it is missing.

    Returns
    -------
    int
        Size in bytes.

    Raises
    ------
    NotFoundError, ConflictError
        There is no such job, or it has no result yet.
    DownloadError
        What arrived does not match the announced digest.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    descriptor, part_name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            part = _Part(file)
            _fetch(transport, path, part)
        if part.digest is not None and part.digest != part.hash.digest():
            announced = part.digest.hex()
            raise DownloadError(  # noqa: TRY301 - the cleanup below is for this, too
                f"{target.name} arrived damaged: its SHA-256 is {part.hash.hexdigest()}, announced was {announced}"
            )
        Path(part_name).chmod(0o666 & ~_umask())
        Path(part_name).replace(target)
    except BaseException:
        Path(part_name).unlink(missing_ok=True)
        raise
    return part.size


def _umask() -> int:
    """Return the process's file mode mask: mkstemp makes private files, results should be like any other."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
