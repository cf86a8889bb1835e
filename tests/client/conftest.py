"""A service made of dictionaries, behind httpx.MockTransport."""

import base64
import hashlib
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from client.api import Client

URL = "http://127.0.0.1:9"
SCENE = {"version": 1, "camera": {"type": "perspective", "fov_deg": 40}, "image": {"width": 4, "height": 3}}

ESTIMATE = {"tiles": 1, "cpu_seconds": 0.27, "memory_bytes": 123456789, "features": ["sphere"]}


def problem(status: int, slug: str, **more: Any) -> httpx.Response:
    body = {"type": f"urn:smalti:problem:{slug}", "title": slug.replace("-", " "), "status": status, **more}
    headers = {"Content-Type": "application/problem+json"}
    if "retry_after" in more:
        headers["Retry-After"] = str(more["retry_after"])
    return httpx.Response(status, content=json.dumps(body), headers=headers)


class FakeService:
    """Answers like the service; `script` holds what the next requests get instead, by method and path."""

    def __init__(self) -> None:
        self.jobs: dict[str, dict[str, Any]] = {}
        self.keys: dict[str, str] = {}
        self.assets: dict[str, bytes] = {}
        self.results: dict[str, bytes] = {}
        self.requests: list[httpx.Request] = []
        self.script: dict[tuple[str, str], list[Any]] = {}
        self.events: Callable[[httpx.Request], Iterator[bytes]] | None = None
        self.sleeps: list[float] = []
        self.stop = threading.Event()

    def next(self, method: str, path: str, *answers: Any) -> None:
        self.script.setdefault((method, path), []).extend(answers)

    def count(self, method: str, path: str) -> int:
        return sum((one.method, one.url.path) == (method, path) for one in self.requests)

    def add_job(self, job_id: str = "job1", state: str = "succeeded", **more: Any) -> dict[str, Any]:
        self.jobs[job_id] = {
            "id": job_id,
            "name": None,
            "state": state,
            "created_at": "2026-01-02T03:04:05.000000Z",
            "updated_at": "2026-01-02T03:04:06.000000Z",
            "progress": {
                "tiles_done": 1,
                "tiles_total": 4,
                "fraction": 0.25,
                "rays": 1000,
                "rays_per_s": None,
                "eta_s": 3.5,
            },
            "image": {"width": 4, "height": 3},
            "samples": 16,
            "problem": None,
            "links": {},
            **more,
        }
        return self.jobs[job_id]

    def __call__(self, request: httpx.Request) -> httpx.Response:
        request.read()
        self.requests.append(request)
        waiting = self.script.get((request.method, request.url.path))
        if waiting:
            answer = waiting.pop(0)
            answer = answer(request) if callable(answer) else answer
            if isinstance(answer, Exception):
                raise answer
            if answer is not None:
                return answer
        return self.route(request)

    def route(self, request: httpx.Request) -> httpx.Response:
        method, parts = request.method, request.url.path.strip("/").split("/")
        match method, parts:
            case "POST", ["v1", "assets:missing"]:
                asked = json.loads(request.content)["sha256"]
                return httpx.Response(200, json={"missing": [one for one in asked if one not in self.assets]})
            case "PUT", ["v1", "assets", digest]:
                if hashlib.sha256(request.content).hexdigest() != digest:
                    return problem(422, "hash-mismatch", detail="other bytes")
                new = digest not in self.assets
                self.assets[digest] = request.content
                return httpx.Response(201 if new else 200, json={"sha256": digest, "created": new})
            case "POST", ["v1", "jobs"]:
                return self.post_job(request)
            case "GET", ["v1", "jobs"]:
                return self.list_jobs(request)
            case "GET", ["v1", "schema"]:
                return httpx.Response(200, json={"title": "scene"})
            case "GET", ["readyz"]:
                return httpx.Response(200, json={"status": "ready", "checks": {"store": "ok", "queue": "ok"}})
            case _, ["v1", "jobs", job_id, *rest]:
                if job_id not in self.jobs:
                    return problem(404, "job-not-found", detail=f"There is no job {job_id}.")
                return self.job_route(request, job_id, "/".join(rest))
        return problem(404, "route-not-found")

    def post_job(self, request: httpx.Request) -> httpx.Response:
        if request.url.params.get("validate_only") == "true":
            return httpx.Response(200, json=ESTIMATE)
        key = request.headers.get("Idempotency-Key", "")
        replayed = key in self.keys
        if not replayed:
            self.keys[key] = f"job{len(self.jobs) + 1}"
            self.add_job(self.keys[key], "queued")
        return httpx.Response(202, json=self.jobs[self.keys[key]])

    def list_jobs(self, request: httpx.Request) -> httpx.Response:
        state, cursor = request.url.params.get("state"), request.url.params.get("cursor")
        limit = int(request.url.params.get("limit", 50))
        ids = sorted((one for one in self.jobs if state in {None, self.jobs[one]["state"]}), reverse=True)
        ids = [one for one in ids if cursor is None or one < cursor]
        page = [self.jobs[one] for one in ids[:limit]]
        return httpx.Response(200, json={"jobs": page, "next_cursor": page[-1]["id"] if len(ids) > limit else None})

    def job_route(self, request: httpx.Request, job_id: str, rest: str) -> httpx.Response:
        job = self.jobs[job_id]
        match request.method, rest:
            case "GET", "":
                return httpx.Response(200, json=job)
            case "DELETE", "":
                if job["state"] not in {"succeeded", "failed", "canceled"}:
                    return problem(409, "job-running", detail="It is rendering.", current_state=job["state"])
                del self.jobs[job_id]
                return httpx.Response(204)
            case "POST", "cancel":
                job["state"] = "canceling"
                return httpx.Response(202, json=job)
            case "GET", "events":
                if self.events is None:
                    return problem(404, "route-not-found")
                return httpx.Response(200, headers={"Content-Type": "text/event-stream"}, content=self.events(request))
            case "GET", "report":
                return httpx.Response(200, content=iter([b'{"tiles": 4}']))
            case "GET", "scene":
                return httpx.Response(200, json=SCENE)
            case "GET", name if name in self.results:
                return self.answer_file(request, self.results[name])
            case "GET", _:
                return problem(409, "result-not-ready", detail="The result is not there yet.")
        return problem(405, "method-not-allowed")

    def answer_file(self, request: httpx.Request, body: bytes) -> httpx.Response:
        digest = base64.b64encode(hashlib.sha256(body).digest()).decode()
        headers = {"ETag": '"v1"', "Repr-Digest": f"sha-256=:{digest}:"}
        wanted = request.headers.get("Range")
        if wanted and request.headers.get("If-Range") == headers["ETag"]:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            headers["Content-Range"] = f"bytes {start}-{len(body) - 1}/{len(body)}"
            return httpx.Response(206, content=iter([body[start:]]), headers=headers)
        return httpx.Response(200, content=iter([body]), headers=headers)

    def client(self, **more: Any) -> Client:
        return Client(URL, http=httpx.MockTransport(self), sleep=self.sleeps.append, **more)


@pytest.fixture
def fake() -> Iterator[FakeService]:
    service = FakeService()
    yield service
    service.stop.set()


@pytest.fixture
def make_problem() -> Callable[..., httpx.Response]:
    return problem


@pytest.fixture(autouse=True)
def no_environment(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """No variable and no `../shared` of the developer's machine decides a test."""
    monkeypatch.chdir(tmp_path_factory.mktemp("current") / ".")
    for name in ("SMALTI_URL", "SMALTI_DATA", "SMALTI_TRACEBACK", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
