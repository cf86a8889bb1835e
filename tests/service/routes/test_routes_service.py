"""The service about itself: health, readiness, schema; and how it does without Redis."""

import json
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest
from service_farm import MINIMAL, Farm, assert_problem, scene, serve


@pytest.mark.parametrize(
    "path", ["/", "/docs", "/healthz", "/readyz", "/metrics", "/v1/jobs", "/v1/schema", "/openapi.json"]
)
def test_head_is_get_without_the_body(farm: Farm, path: str) -> None:
    get, head = farm.client.get(path), farm.client.head(path)
    assert head.status_code == get.status_code
    assert head.content == b""
    assert head.headers["Content-Type"] == get.headers["Content-Type"]


def test_health(farm: Farm) -> None:
    assert farm.client.get("/healthz").json()["status"] == "ok"


def test_ready_only_with_a_live_worker(farm: Farm) -> None:
    queue = farm.context.queue
    problem = assert_problem(farm.client.get("/readyz"), 503, "service-not-ready")
    assert problem["checks"] == {"store": "ok", "queue": "ok", "workers": "none alive"}
    queue.report_worker("w1", {"host": "h", "pid": 7, "state": "idle", "started_at": 1.0})
    try:
        assert farm.client.get("/readyz").json() == {
            "status": "ready",
            "checks": {"store": "ok", "queue": "ok", "workers": "1 alive"},
        }
        worker = farm.client.get("/v1/workers").json()["workers"][0]
        assert {name: worker[name] for name in ("name", "host", "pid", "state", "job_id", "tile")} == {
            "name": "w1", "host": "h", "pid": 7, "state": "idle", "job_id": None, "tile": None,
        }  # fmt: skip
    finally:
        queue.forget_worker("w1")


def test_not_ready_when_the_store_cannot_be_written(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(farm.store, "temporary", Path("/proc/nowhere"))
    problem = assert_problem(farm.client.get("/readyz"), 503, "service-not-ready")
    assert problem["checks"]["store"].startswith("not writable")
    assert "/proc" not in json.dumps(problem)


def test_schema_is_that_of_the_scene(farm: Farm) -> None:
    answer = farm.client.get("/v1/schema")
    assert answer.headers["Content-Type"] == "application/schema+json"
    schema = answer.json()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(MINIMAL, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(scene(version=2), schema)


@pytest.fixture(scope="module")
def lonely(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Farm]:
    with serve(tmp_path_factory.mktemp("lonely"), None) as farm:
        yield farm


def test_without_redis_jobs_are_accepted_and_shown(lonely: Farm) -> None:
    answer = lonely.post(headers={"Idempotency-Key": "k"})
    assert answer.status_code == 202
    job_id = answer.json()["id"]
    assert lonely.client.get(f"/v1/jobs/{job_id}").json()["state"] == "queued"
    assert [job["id"] for job in lonely.client.get("/v1/jobs").json()["jobs"]] == [job_id]
    assert lonely.client.post(f"/v1/jobs/{job_id}/cancel").json()["state"] == "canceling"


def test_without_redis_a_waiting_client_still_hears_of_the_end(lonely: Farm) -> None:
    job_id = lonely.post(headers={"Idempotency-Key": "wait"}).json()["id"]
    thread = lonely.later(0.3, lonely.finish, job_id)
    answer = lonely.post(headers={"Idempotency-Key": "wait", "Prefer": "wait=10"})
    thread.join()
    assert answer.status_code == 200
    assert answer.json()["state"] == "succeeded"
    assert answer.json()["progress"]["fraction"] == 1.0


def test_without_redis_what_needs_it_says_so(lonely: Farm) -> None:
    answer = lonely.client.get("/v1/workers")
    assert_problem(answer, 503, "queue-unavailable")
    assert answer.headers["Retry-After"]
    problem = assert_problem(lonely.client.get("/readyz"), 503, "service-not-ready")
    assert problem["checks"]["queue"] == "Redis does not answer"
    assert lonely.client.get("/healthz").status_code == 200
    assert "smalti_queue_up 0.0" in lonely.client.get("/metrics").text
