"""What clients bring: assets by their content, and the keys that make a request safe to repeat.

Job: the part of the store that is not about one job.
Invariant: an asset's bytes have the hash that its name says; an idempotency key belongs to the first request for ever
(that is, until the steward sweeps it a day later).
"""

import hashlib
import json
import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from worker import files
from worker.errors import AssetNotFoundError, AssetTooLargeError, BadNameError, DamagedRecordError, HashMismatchError
from worker.records import check_job_id, check_owner, check_sha256, now


class Uploads:
    """Assets and idempotency records under one folder.

    Parameters
    ----------
    root
        Folder of the store; must exist.
    """

    def __init__(self, root: Path) -> None:
        self._assets, self._idempotency, self.temporary = (root / name for name in ("assets", "idempotency", "tmp"))
        for folder in (self._assets, self._idempotency, self.temporary):
            folder.mkdir(exist_ok=True)

    # ---- assets ---------------------------------------------------------------------------------------------------

    def has_asset(self, sha256: str) -> bool:
        """Whether an asset of this hash is here."""
        return (self._assets / check_sha256(sha256)).is_file()

    def asset_path(self, sha256: str) -> Path:
        """Return the file of an asset; `AssetNotFoundError` where there is none."""
        path = self._assets / check_sha256(sha256)
        if not path.is_file():
            raise AssetNotFoundError(f"no asset {sha256}")
        return path

    def put_asset(self, sha256: str, chunks: Iterable[bytes], max_bytes: int) -> bool:
        """Take in an asset as it arrives.

        Parameters
        ----------
        sha256
            Hash that the bytes must have.
        chunks
            The bytes, in pieces; memory stays flat.
        max_bytes
            Most bytes to accept.

        Returns
        -------
        bool
            True if it is new; False if it was here (its bytes are then read no further).

        Raises
        ------
        HashMismatchError, AssetTooLargeError, StoreFullError, BadNameError
        """
        target = self._assets / check_sha256(sha256)
        if target.is_file():
            return False
        path = self.temporary / f".asset-{secrets.token_hex(8)}"
        digest = hashlib.sha256()
        size = 0
        try:
            with files.full_is_clear(), path.open("xb") as file:
                for chunk in chunks:
                    size += len(chunk)
                    if size > max_bytes:
                        raise AssetTooLargeError(f"larger than {max_bytes} bytes")
                    digest.update(chunk)
                    file.write(chunk)
                if digest.hexdigest() != sha256:
                    raise HashMismatchError(f"the bytes have sha256 {digest.hexdigest()}, not {sha256}")
                file.flush()
                os.fsync(file.fileno())
            with files.full_is_clear():
                created = files.move_if_absent(path, target)
                files.fsync_folder(self._assets)
        finally:
            path.unlink(missing_ok=True)
        return created

    # ---- idempotency ----------------------------------------------------------------------------------------------

    def put_idempotency(self, owner: str, key: str, request_sha256: str, job_id: str) -> tuple[str, str]:
        """Bind a key to a request, durable; the first one wins.

        Returns
        -------
        request_sha256, job_id
            Of whoever was first.
        """
        folder = self._idempotency / check_owner(owner)
        if not folder.is_dir():
            folder.mkdir(exist_ok=True)
            files.fsync_folder(self._idempotency)
        path = folder / hash_key(key)
        body = json.dumps({"request_sha256": request_sha256, "job_id": check_job_id(job_id), "at": now()}).encode()
        if files.create(path, body, self.temporary):
            return request_sha256, job_id
        return _read_binding(path)

    def free_idempotency(self, owner: str, key_sha256: str, job_id: str) -> None:
        """Unbind a key from a job that is gone, unless another job has it by now (a key is swept after a day)."""
        path = self._idempotency / check_owner(owner) / check_sha256(key_sha256)
        try:
            is_ours = _read_binding(path)[1] == job_id
        except FileNotFoundError:
            return
        except (DamagedRecordError, BadNameError):
            is_ours = True  # of no use to anybody
        if is_ours:
            path.unlink(missing_ok=True)


def _read_binding(path: Path) -> tuple[str, str]:
    """Return the hash of the request and the job id that a key is bound to."""
    try:
        first = json.loads(path.read_bytes())
        return str(first["request_sha256"]), check_job_id(first["job_id"])
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedRecordError(f"idempotency record: {error}") from error


def hash_key(key: str) -> str:
    """Return the file name of an idempotency key: its sha256."""
    return hashlib.sha256(key.encode()).hexdigest()
