"""A real API on a loopback port with a real Valkey, and a farm of one function: the test drives the states."""

import contextlib
import copy
import json
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import uvicorn

from service.app import context_of, create_app
from service.context import Context
from service.settings import ServiceSettings
from worker import jobs
from worker.states import JobState
from worker.store import Store

MINIMAL: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40},
    "image": {"width": 64, "height": 48},
}

FLOW = (JobState.PREPARING, JobState.RENDERING, JobState.ASSEMBLING, JobState.SUCCEEDED)
PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 10


def scene(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(MINIMAL), **changes}


class Farm:
    """The service under test, and the hands that play the workers."""

    def __init__(self, url: str, context: Context) -> None:
        self.url = url
        self.context = context
        self.client = httpx.Client(base_url=url, timeout=20)

    @property
    def store(self) -> Store:
        return self.context.store

    def post(self, document: Any = None, **arguments: Any) -> httpx.Response:
        body = arguments.pop("body", None) or {"scene": scene() if document is None else document}
        return self.client.post("/v1/jobs", json=body, **arguments)

    def submit(self, **arguments: Any) -> str:
        answer = self.post(**arguments)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def move(self, job_id: str, *states: JobState, detail: Any = None) -> None:
        for state in states:
            last = detail if state is states[-1] else None
            jobs.transition(self.store, self.context.queue, job_id, state, by="test", detail=last)

    def finish(self, job_id: str, png: bytes = PNG) -> None:
        """Play the whole farm: results, then the last event."""
        folder = self.store.temporary
        parts = {}
        for name, data in {
            "result.png": png,
            "result.exr": b"exr" * 1000,
            "preview.png": png,
            "report.json": b'{"tiles": 1}',
        }.items():
            path = folder / f"{job_id}-{name}"
            path.write_bytes(data)
            parts[name] = path
        done = [event.state for event in self.store.events(job_id)]
        self.move(job_id, *[state for state in FLOW[:-1] if state not in done])
        self.store.commit_result(job_id, parts)
        self.move(job_id, JobState.SUCCEEDED, detail={"rays": 1000, "rays_per_s": 10.0})

    def finished(self) -> str:
        job_id = self.submit()
        self.finish(job_id)
        return job_id

    def later(self, delay_s: float, action: Any, *arguments: Any) -> threading.Thread:
        def run() -> None:
            time.sleep(delay_s)
            action(*arguments)

        thread = threading.Thread(target=run)
        thread.start()
        return thread


@contextlib.contextmanager
def serve(root: Path, redis_url: str | None, **settings: Any) -> Iterator[Farm]:
    """Run the API in a thread until the end of the block."""
    chosen = ServiceSettings(
        store=root / "store", redis_url=redis_url, log_level="ERROR", **{"cache": root / "cache", **settings}
    )
    app = create_app(chosen)
    server = uvicorn.Server(
        uvicorn.Config(app, host="127.0.0.1", port=0, log_config=None, timeout_graceful_shutdown=2, access_log=False)
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        deadline = time.monotonic() + 20
        while not server.started:
            assert time.monotonic() < deadline, "the API did not start"
            time.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        farm = Farm(f"http://127.0.0.1:{port}", context_of(app))
        while redis_url is not None and not farm.context.wakeups.connected:
            assert time.monotonic() < deadline, "no subscription"
            time.sleep(0.01)
        with farm.client:
            yield farm
    finally:
        server.should_exit = True
        thread.join(20)
        shutil.rmtree(root / "store", ignore_errors=True)


def assert_problem(answer: httpx.Response, status: int, slug: str) -> dict[str, Any]:
    """Check the form that every error has."""
    assert answer.status_code == status, answer.text
    assert answer.headers["Content-Type"] == "application/problem+json"
    body = answer.json()
    assert body["type"] == f"urn:smalti:problem:{slug}", body
    assert body["status"] == status
    assert body["title"]
    assert body["detail"]
    assert body["instance"] == answer.request.url.path
    for fault in body.get("errors", []):
        assert set(fault) == {"pointer", "detail", "expected"}
        assert fault["pointer"] == "" or fault["pointer"].startswith("/")
        assert fault["detail"]
        assert fault["expected"]
    return dict(body)


def resolve(pointer: str, document: Any) -> Any:
    """Value at a JSON pointer; the last step may be missing from an object (that is the fault then)."""
    value = document
    tokens = [token.replace("~1", "/").replace("~0", "~") for token in pointer.split("/")[1:]]
    for number, token in enumerate(tokens):
        if isinstance(value, list):
            assert token.isdigit(), pointer
            assert int(token) < len(value) or number == len(tokens) - 1, pointer
            value = value[int(token)] if int(token) < len(value) else None
        else:
            assert isinstance(value, dict), f"{pointer} leads into {value!r}"
            assert token in value or number == len(tokens) - 1, pointer
            value = value.get(token)
    return value


def events_of(text: str) -> list[dict[str, Any]]:
    """Events of a stream's text: {event, id, data}."""
    found = []
    for block in text.split("\n\n"):
        fields: dict[str, Any] = {}
        for line in block.splitlines():
            if line and not line.startswith(":"):
                name, _, value = line.partition(": ")
                fields[name] = value
        if "data" in fields:
            found.append({**fields, "data": json.loads(fields["data"])})
    return found
