"""Errors of the client: one hierarchy, each class with the exit code of the command line.

    SmaltiError (1)
    ├── UsageError (2)               arguments that contradict each other
    ├── SceneInvalidError (3)        the scene document has faults; `faults` lists them
    │   └── AssetError (3)           a file of the scene: missing, changed, or not allowed
    ├── JobFailedError (4)           the job ended as failed
    ├── JobCanceledError (5)         the job ended as canceled
    ├── NotReachableError (6)        no service answers at the address
    ├── NotFoundError (7)            no such job or result
    ├── ConflictError (8)            the job's state, a key used before, a port or store in use
    ├── TimedOutError (9)            the time given to wait ran out; the job goes on
    ├── ApiError (1)                 any other problem that the service answered
    └── DownloadError (1)            what arrived is not what was announced

Invariant: an error that came from the service carries its problem document (RFC 9457) unchanged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any


class ExitCode(IntEnum):
    """Exit codes of `smalti`; documented in `--help` and the README from `EXIT_CODE_MEANINGS`."""

    OK = 0
    UNEXPECTED = 1
    USAGE = 2
    SCENE_INVALID = 3
    JOB_FAILED = 4
    CANCELED = 5
    NOT_REACHABLE = 6
    NOT_FOUND = 7
    CONFLICT = 8
    TIMED_OUT = 9
    INTERRUPTED = 130


EXIT_CODE_MEANINGS: Mapping[ExitCode, str] = {
    ExitCode.OK: "success",
    ExitCode.UNEXPECTED: "unexpected error",
    ExitCode.USAGE: "wrong usage: unknown option, missing argument, unreadable file",
    ExitCode.SCENE_INVALID: "the scene document or one of its files is invalid or missing",
    ExitCode.JOB_FAILED: "the job failed",
    ExitCode.CANCELED: "the job was canceled",
    ExitCode.NOT_REACHABLE: "the service is not reachable",
    ExitCode.NOT_FOUND: "no such job or result",
    ExitCode.CONFLICT: "conflict: the job's state does not allow it, an idempotency key was used before, "
    "or the port or the store of `serve` is in use",
    ExitCode.TIMED_OUT: "timed out; the job goes on",
    ExitCode.INTERRUPTED: "interrupted (Ctrl-C)",
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a scene document: where (RFC 6901 pointer), what is wrong, what would be right."""

    pointer: str
    message: str
    expected: str = ""


class SmaltiError(Exception):
    """Something went wrong in the client or the service.

    Attributes
    ----------
    exit_code : ExitCode
        Exit status of the command line for this error.
    problem : Mapping[str, Any] or None
        The problem document that the service answered, unchanged.
    faults : tuple of Fault
        Faults of the scene document or the request, each with its place; may be empty.
    hint : str
        What the user can do about it; may be empty.
    """

    exit_code = ExitCode.UNEXPECTED

    def __init__(
        self,
        message: str = "",
        *,
        faults: Sequence[Fault] = (),
        problem: Mapping[str, Any] | None = None,
        hint: str = "",
    ) -> None:
        super().__init__(message or (self.__doc__ or "").strip().splitlines()[0])
        self.faults = tuple(faults)
        self.problem = problem
        self.hint = hint

    @property
    def message(self) -> str:
        """The text of the error, without the hint."""
        return str(self.args[0])

    @property
    def status(self) -> int | None:
        """HTTP status of the answer, if the service answered."""
        status = (self.problem or {}).get("status")
        return status if isinstance(status, int) else None


class UsageError(SmaltiError):
    """The arguments do not go together."""

    exit_code = ExitCode.USAGE


class SceneInvalidError(SmaltiError):
    """The scene document is not valid."""

    exit_code = ExitCode.SCENE_INVALID


class AssetError(SceneInvalidError):
    """A file that the scene names cannot be used."""


class JobFailedError(SmaltiError):
    """The job failed."""

    exit_code = ExitCode.JOB_FAILED


class JobCanceledError(SmaltiError):
    """The job was canceled."""

    exit_code = ExitCode.CANCELED


class NotReachableError(SmaltiError):
    """No service answers at this address."""

    exit_code = ExitCode.NOT_REACHABLE


class NotFoundError(SmaltiError):
    """There is no such job or result."""

    exit_code = ExitCode.NOT_FOUND


class ConflictError(SmaltiError):
    """The state does not allow this."""

    exit_code = ExitCode.CONFLICT


class TimedOutError(SmaltiError):
    """The time to wait ran out; the job goes on."""

    exit_code = ExitCode.TIMED_OUT


class ApiError(SmaltiError):
    """The service refused the request."""


class DownloadError(SmaltiError):
    """The file that arrived is not the file that was announced."""


def parse_faults(problem: Mapping[str, Any]) -> tuple[Fault, ...]:
    """Read the `errors` list of a problem document; entries of an unknown form are skipped."""
    entries = problem.get("errors")
    if not isinstance(entries, list):
        return ()
    return tuple(
        Fault(
            pointer=str(entry.get("pointer", "")),
            message=str(entry.get("detail", entry.get("message", ""))),
            expected=str(entry.get("expected") or ""),
        )
        for entry in entries
        if isinstance(entry, Mapping)
    )


def error_from_problem(problem: Mapping[str, Any], status: int) -> SmaltiError:
    """Choose the error class for a problem document by its HTTP status.

    Parameters
    ----------
    problem : Mapping
        Problem document (RFC 9457), or a stand-in made from an answer that had none.
    status : int
        HTTP status of the answer.
    """
    problem = {"status": status, **problem}
    title = str(problem.get("title") or f"HTTP {status}")
    detail = str(problem.get("detail") or "")
    message = detail if detail and title.rstrip(".").lower() in detail.lower() else f"{title}: {detail}".rstrip(": ")
    kind = str(problem.get("type", "")).rpartition(":")[2]
    if kind.startswith("idempotency") and status in {410, 422}:
        return ConflictError(message, problem=problem)
    if status in {404, 410}:
        return NotFoundError(message, problem=problem)
    if status == 409:
        allowed = problem.get("allowed")
        hint = f"allowed now: {', '.join(map(str, allowed))}" if isinstance(allowed, list) and allowed else ""
        return ConflictError(message, problem=problem, hint=hint)
    if status == 422:
        # One status for several kinds: a wrong upload or request, and (most often) a bad scene.
        faults = parse_faults(problem)
        if kind == "hash-mismatch":
            return AssetError(message, problem=problem)
        if kind in {"request-invalid", "parameters-invalid"}:
            return UsageError(message, faults=faults, problem=problem)
        return SceneInvalidError(message, faults=faults, problem=problem)
    if status == 413:
        return SceneInvalidError(message, problem=problem)
    if status in {502, 503, 504}:
        return NotReachableError(message, problem=problem, hint="the service is up but not ready; try again shortly")
    return ApiError(message, problem=problem)
