"""The Python client: the verbs of the command line as methods.

    with Client("http://127.0.0.1:8000") as client:
        job = client.submit(Path("scene.json"))
        client.wait(job.id)
        client.get(job.id, Path("out.png"))

Invariants: `submit` makes an `Idempotency-Key`, so a POST that is sent again never makes a second job; every error is
one of `client.errors`. Source: the table "HTTP" of the service's design.
"""

import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

from client.assets import PreparedScene, absent_error, prepare_scene, read_scene
from client.download import download
from client.errors import (
    ApiError,
    ConflictError,
    JobCanceledError,
    JobFailedError,
    SmaltiError,
    TimedOutError,
    UsageError,
    parse_faults,
)
from client.http import httpx
from client.models import Job, JobPage
from client.results import RESULTS, result_kind
from client.transport import CHUNK_BYTES, Transport
from client.watch import watch

DEFAULT_URL = "http://127.0.0.1:8000"
LONGEST_PREFER_WAIT_S = 60  # the service's limit


def default_url() -> str:
    """`SMALTI_URL`, else the service on this machine."""
    return os.environ.get("SMALTI_URL") or DEFAULT_URL


class Client:
    """A client of one Smalti service.

    Parameters
    ----------
    url : str, optional
        Address of the service; `SMALTI_URL`, else `http://127.0.0.1:8000`.
    timeout_s : float
        Longest wait for one answer.
    retries : int
        How often a request is sent again after a failure that may pass.
    http : httpx.BaseTransport, optional
        For tests.
    sleep : callable
        For tests.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        timeout_s: float = 30.0,
        retries: int = 4,
        http: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.transport = Transport(url or default_url(), retries=retries, timeout_s=timeout_s, http=http, sleep=sleep)

    @property
    def url(self) -> str:
        """Address of the service."""
        return self.transport.base_url

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self.transport.close()

    # Jobs

    def submit(
        self,
        scene: Path | str | Mapping[str, Any] | PreparedScene,
        *,
        output: Mapping[str, Any] | None = None,
        priority: int | None = None,
        name: str | None = None,
        idempotency_key: str | None = None,
        prefer_wait_s: int | None = None,
    ) -> Job:
        """Upload what is missing and create a job.

        Parameters
        ----------
        scene : Path, str, Mapping or PreparedScene
            Scene file (`-` is standard input), a document whose files lie relative to the current folder, or the
            outcome of `prepare_scene`.
        output : Mapping, optional
            `png_color_space` ("srgb" or "linear") and `tile_size` (pixels).
        priority : int, optional
            0 to 100; higher is sooner.
        name : str, optional
            A title.
        idempotency_key : str, optional
            Sent again, the same key gives the same job; made anew by default.
        prefer_wait_s : int, optional
            Ask the service to answer only when the job has ended, or after so many seconds (1 to 60).

        Returns
        -------
        Job
            As accepted; it is on the service's disk.
        """
        prepared = self._prepare(scene)
        body = self._body(prepared, output=output, priority=priority, name=name)
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        read_timeout_s = None
        if prefer_wait_s is not None:
            wait_s = min(max(int(prefer_wait_s), 1), LONGEST_PREFER_WAIT_S)
            headers["Prefer"] = f"wait={wait_s}"
            read_timeout_s = wait_s + 30.0
        self.upload(prepared)
        try:
            response = self.transport.request(
                "POST", "/v1/jobs", json=body, headers=headers, read_timeout_s=read_timeout_s
            )
        except ConflictError as error:
            # Removed between the upload and the POST (a store that was emptied): upload again, once.
            if not str((error.problem or {}).get("type", "")).endswith("assets-missing"):
                raise
            self.upload(prepared)
            response = self.transport.request(
                "POST", "/v1/jobs", json=body, headers=headers, read_timeout_s=read_timeout_s
            )
        return self._job(self.transport.json_object(response))

    def validate(
        self, scene: Path | str | Mapping[str, Any] | PreparedScene, *, output: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Check a scene without rendering it.

        Returns
        -------
        dict
            The estimate: tiles, memory, features.

        Raises
        ------
        SceneInvalidError
            With every fault.
        AssetError
            When a file is neither here nor there.
        """
        prepared = self._prepare(scene)
        body = self._body(prepared, output=output)
        response = self.transport.request("POST", "/v1/jobs", params={"validate_only": "true"}, json=body)
        self._find_missing(prepared, prepared.absent)
        return self.transport.json_object(response)

    def status(self, job_id: str) -> Job:
        """Fetch the job as it is now."""
        return self._job(self.transport.json_object(self.transport.request("GET", self._path(job_id))))

    def list(self, *, state: str | None = None, cursor: str | None = None, limit: int | None = None) -> JobPage:
        """One page of jobs, newest first."""
        given = {"state": state, "cursor": cursor, "limit": limit}
        params = {key: value for key, value in given.items() if value is not None}
        data = self.transport.json_object(self.transport.request("GET", "/v1/jobs", params=params))
        entries = data.get("jobs", [])
        return JobPage(jobs=tuple(self._job(entry) for entry in entries), next_cursor=data.get("next_cursor"))

    def watch(self, job_id: str, *, timeout_s: float | None = None) -> Iterator[Job]:
        """Yield the job whenever it changes, until it ends; see `client.watch.watch`."""
        return watch(self.transport, self._path(job_id), self.status, job_id, timeout_s=timeout_s)

    def wait(self, job_id: str, *, timeout_s: float | None = None, check: bool = True) -> Job:
        """Wait until a job ends.

        Parameters
        ----------
        timeout_s : float, optional
            Longest wait; without it, as long as it takes.
        check : bool
            Raise when the job did not succeed.

        Raises
        ------
        TimedOutError, JobFailedError, JobCanceledError
        """
        job = None
        for job in self.watch(job_id, timeout_s=timeout_s):
            if job.is_terminal:
                break
        if job is None or not job.is_terminal:
            raise TimedOutError(f"job {job_id} has not ended")
        if check:
            require_success(job)
        return job

    def get(self, job_id: str, target: Path | str, *, kind: str | None = None) -> int:
        """Download a result into a file, whole or not at all.

        Parameters
        ----------
        target : Path
            File to write.
        kind : str, optional
            "png", "exr", "preview" or "report"; by the file's extension otherwise.

        Returns
        -------
        int
            Size in bytes.
        """
        kind = kind or result_kind(Path(target))
        if kind not in RESULTS:
            raise UsageError(f"no such kind of result: {kind!r}; there are {', '.join(RESULTS)}")
        return download(self.transport, f"{self._path(job_id)}/{RESULTS[kind]}", Path(target))

    def report(self, job_id: str) -> dict[str, Any]:
        """Where the time of a job went, and what was skipped."""
        return self.transport.json_object(self.transport.request("GET", f"{self._path(job_id)}/report"))

    def scene(self, job_id: str) -> dict[str, Any]:
        """Fetch the scene document as accepted."""
        return self.transport.json_object(self.transport.request("GET", f"{self._path(job_id)}/scene"))

    def cancel(self, job_id: str) -> Job:
        """Stop a job; what it has rendered is dropped. One that is canceled already stays so.

        Raises
        ------
        ConflictError
            When it has succeeded or failed.
        """
        response = self.transport.request("POST", f"{self._path(job_id)}/cancel")
        return self._job(self.transport.json_object(response)) if response.content else self.status(job_id)

    def delete(self, job_id: str) -> None:
        """Remove a job that has ended, with its results."""
        self.transport.request("DELETE", self._path(job_id), gone_is_done=True)

    # Service

    def schema(self) -> dict[str, Any]:
        """JSON Schema of the scene document."""
        return self.transport.json_object(self.transport.request("GET", "/v1/schema"))

    def readiness(self) -> dict[str, str]:
        """Return the service's checks of its parts, all well.

        Raises
        ------
        NotReachableError
            When it does not take jobs now, or is not there at all.
        """
        answer = self.transport.json_object(self.transport.request("GET", "/readyz", read_timeout_s=5.0, retries=0))
        checks = answer.get("checks")
        return {str(key): str(value) for key, value in checks.items()} if isinstance(checks, dict) else {}

    def ready(self) -> bool:
        """Tell whether the service takes jobs now; False when it is not reachable."""
        try:
            self.readiness()
        except SmaltiError:
            return False
        return True

    # Assets

    def missing_assets(self, hashes: Iterable[str]) -> tuple[str, ...]:
        """Those of the given SHA-256 hashes that the service does not have."""
        wanted = sorted(set(hashes))
        if not wanted:
            return ()
        response = self.transport.request(
            "POST", "/v1/assets:missing", json={"sha256": wanted}, headers={"Idempotency-Key": uuid.uuid4().hex}
        )
        missing = self.transport.json_object(response).get("missing", [])
        return tuple(digest for digest in wanted if digest in missing)

    def put_asset(self, path: Path, sha256: str) -> bool:
        """Upload one file; True when it was new to the service."""

        def chunks() -> Iterator[bytes]:
            with path.open("rb") as file:
                while chunk := file.read(CHUNK_BYTES):
                    yield chunk

        headers = {"Content-Length": str(path.stat().st_size), "Content-Type": "application/octet-stream"}
        response = self.transport.request(
            "PUT", f"/v1/assets/{sha256}", body=chunks, headers=headers, read_timeout_s=120.0
        )
        return response.status_code == 201

    def upload(self, prepared: PreparedScene) -> int:
        """Upload the files of a scene that the service does not have; returns how many.

        Raises
        ------
        AssetError
            When a file is neither here nor there.
        """
        missing = self._find_missing(prepared, [*prepared.uploads, *prepared.absent])
        for digest in missing:
            self.put_asset(prepared.uploads[digest], digest)
        return len(missing)

    # Inside

    def _find_missing(self, prepared: PreparedScene, hashes: Iterable[str]) -> tuple[str, ...]:
        """Those of the scene's files that the service does not have; `AssetError` where they are not here either."""
        missing = self.missing_assets(hashes)
        nowhere = [digest for digest in missing if digest not in prepared.uploads]
        if nowhere:
            raise absent_error(prepared, nowhere)
        return missing

    def _prepare(self, scene: Path | str | Mapping[str, Any] | PreparedScene) -> PreparedScene:
        if isinstance(scene, PreparedScene):
            return scene
        if isinstance(scene, Path | str):
            return prepare_scene(*read_scene(scene))
        return prepare_scene(scene)

    def _body(
        self,
        prepared: PreparedScene,
        *,
        output: Mapping[str, Any] | None = None,
        priority: int | None = None,
        name: str | None = None,
    ) -> dict[str, Any]:
        given = {"output": dict(output) if output else None, "priority": priority, "name": name}
        return {"scene": prepared.document} | {key: value for key, value in given.items() if value is not None}

    def _path(self, job_id: str) -> str:
        return f"/v1/jobs/{quote(job_id, safe='')}"

    def _job(self, data: Any) -> Job:
        try:
            return Job.parse(data)
        except ValueError as error:
            raise ApiError(f"{self.url} sent an answer that cannot be read: {error}") from error


def require_success(job: Job) -> None:
    """Raise the error of a job that ended otherwise than well.

    Raises
    ------
    JobFailedError, JobCanceledError
    """
    if job.state == "canceled":
        raise JobCanceledError(f"job {job.id} was canceled")
    if job.is_terminal and job.state != "succeeded":
        problem = job.problem or {}
        reason = str(problem.get("detail") or problem.get("title") or job.state)
        raise JobFailedError(f"job {job.id} failed: {reason}", faults=parse_faults(problem), problem=job.problem)
