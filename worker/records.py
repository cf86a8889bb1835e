"""What the store keeps of a job: its record, its events, its id; and the problem of a failed one.

Job: small frozen values and their JSON.
Invariant: a record is written once; an event carries the state after it, so that a reader opens only the last one.
"""

import json
import re
import secrets
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

from worker.contract import PROBLEM_PREFIX
from worker.errors import BadNameError, DamagedRecordError
from worker.states import JobState

_CROCKFORD = "0123456789abcdefghjkmnpqrstvwxyz"
_JOB_ID = re.compile(r"[0-7][0-9a-hjkmnp-tv-z]{25}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_OWNER = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")

_id_lock = threading.Lock()
_last_id = 0


def new_job_id() -> str:
    """Return a fresh id: 26 characters, base 32 of 48 bits of milliseconds and 80 random bits (a lowercase ULID).

    Ids sort by time; within one process each is greater than the one before.
    """
    global _last_id  # noqa: PLW0603 - the last id is what makes the next one greater
    with _id_lock:
        value = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
        if value <= _last_id:
            value = _last_id + 1
        _last_id = value
    return "".join(_CROCKFORD[(value >> shift) & 31] for shift in range(125, -5, -5))


def check_job_id(text: str) -> str:
    """Return `text` if it can be a job's id.

    Raises
    ------
    BadNameError
        It cannot; so no path is ever made from it.
    """
    if not isinstance(text, str) or not _JOB_ID.fullmatch(text):
        raise BadNameError("not a job id")
    return text


def check_sha256(text: str) -> str:
    """Return `text` if it is 64 lowercase hexadecimal digits; `BadNameError` otherwise."""
    if not isinstance(text, str) or not _SHA256.fullmatch(text):
        raise BadNameError("not a sha256 in lowercase hexadecimal")
    return text


def check_owner(text: str) -> str:
    """Return `text` if it can name an owner; `BadNameError` otherwise."""
    if not isinstance(text, str) or not _OWNER.fullmatch(text):
        raise BadNameError("not an owner's name")
    return text


def now() -> str:
    """Return the time as RFC 3339 in UTC with microseconds."""
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def seconds_between(earlier: str, later: str) -> float:
    """Return the seconds between two times of `now`."""
    return (datetime.fromisoformat(later) - datetime.fromisoformat(earlier)).total_seconds()


def problem(kind: str, title: str, detail: str, **more: Any) -> dict[str, Any]:
    """Return a problem (RFC 9457) as kept in a failed job's last event; members that are None are left out."""
    body = {"type": f"{PROBLEM_PREFIX}{kind}", "title": title, "detail": detail, **more}
    return {name: value for name, value in body.items() if value is not None}


@dataclass(frozen=True, slots=True)
class JobRecord:
    """What was accepted; all but the scene, which lies beside it in a file of its own (it can be large).

    Attributes
    ----------
    id, owner, created_at, name
        Identity; `created_at` is RFC 3339, UTC.
    scene_sha256
        Hash of the canonical scene document.
    width, height
        Size of the whole image, px.
    x, y, crop_width, crop_height
        Rectangle that is rendered, px from the top left; the whole image without a crop.
    samples
        Samples a pixel.
    output
        ``{"png_color_space": "srgb" | "linear", "tile_size": int}``.
    priority
        0 to 100.
    n_tiles
        Number of tiles of the plan.
    idempotency_key_sha256
        Hash of the key of the request, if it had one.
    """

    id: str
    owner: str
    created_at: str
    name: str | None
    scene_sha256: str
    width: int
    height: int
    x: int
    y: int
    crop_width: int
    crop_height: int
    samples: int
    output: Mapping[str, Any]
    priority: int
    n_tiles: int
    idempotency_key_sha256: str | None = None
    version: int = 1

    def to_json(self) -> bytes:
        """Return the content of ``job.json``."""
        return json.dumps(asdict(self), indent=1).encode()

    @classmethod
    def from_json(cls, data: bytes) -> "JobRecord":
        """Read what `to_json` wrote; `DamagedRecordError` where it is something else."""
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError) as error:
            raise DamagedRecordError(f"job.json: {error}") from error


@dataclass(frozen=True, slots=True)
class JobEvent:
    """One entry of a job's history.

    Attributes
    ----------
    seq
        Number, from 1 without gaps; the id of the server-sent event.
    at
        Time, RFC 3339 in UTC.
    type
        "created", "state" (a transition), "tile_error" or "tile_lost".
    state
        State after this event: the snapshot that makes the last event enough.
    previous
        State before it; None for the first.
    by
        Who caused it: "api", a worker's name, "assembler", "steward".
    detail
        Whatever belongs to it; a problem (RFC 9457) for "failed", the summary for "succeeded".
    """

    seq: int
    at: str
    type: str
    state: JobState
    previous: JobState | None
    by: str
    detail: Mapping[str, Any] | None = field(default=None)

    def to_json(self) -> bytes:
        """Return the content of ``events/<seq>.json``."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, data: bytes) -> "JobEvent":
        """Read what `to_json` wrote; `DamagedRecordError` where it is something else."""
        try:
            fields = json.loads(data)
            previous = fields["previous"]
            fields["state"] = JobState(fields["state"])
            fields["previous"] = None if previous is None else JobState(previous)
            return cls(**fields)
        except (ValueError, TypeError, KeyError) as error:
            raise DamagedRecordError(f"event: {error}") from error
