"""Query parameters that a call does not know."""

import pytest
from service_farm import Farm, assert_problem


@pytest.mark.parametrize(
    ("method", "path", "name", "expected"),
    [
        ("POST", "/v1/jobs", "validateonly", "validate_only"),
        ("POST", "/v1/jobs", "Validate-Only", "validate_only"),
        ("GET", "/v1/jobs", "curser", "cursor; also known: limit, state"),
        ("GET", "/v1/jobs", "page", "cursor or limit or state"),
        ("GET", "/v1/jobs/x", "wait", "no query parameters"),
        ("GET", "/v1/jobs/x/events", "last_event_id", "no query parameters"),
        ("GET", "/v1/jobs/x/result.png", "size", "no query parameters"),
        ("POST", "/v1/jobs/x/cancel", "force", "no query parameters"),
        ("DELETE", "/v1/jobs/x", "force", "no query parameters"),
        ("POST", "/v1/assets:missing", "all", "no query parameters"),
        ("PUT", "/v1/assets/x", "name", "no query parameters"),
        ("GET", "/v1/workers", "limit", "no query parameters"),
        ("GET", "/v1/schema", "version", "no query parameters"),
        ("GET", "/healthz", "deep", "no query parameters"),
        ("GET", "/metrics", "name", "no query parameters"),
        ("GET", "/", "tab", "no query parameters"),
    ],
)
def test_an_unknown_parameter_is_refused(farm: Farm, method: str, path: str, name: str, expected: str) -> None:
    body = assert_problem(farm.client.request(method, path, params={name: "1"}), 422, "parameters-invalid")
    (fault,) = body["errors"]
    assert fault["pointer"] == f"/query/{name}"
    assert fault["expected"] == expected


def test_a_mistyped_validate_only_makes_no_job(farm: Farm) -> None:
    before = set(farm.store.job_ids())
    assert_problem(farm.post(params={"validate_onyl": "true", "dry_run": "1"}), 422, "parameters-invalid")
    assert set(farm.store.job_ids()) == before


def test_every_unknown_parameter_is_named_and_known_ones_pass(farm: Farm) -> None:
    answer = farm.client.get("/v1/jobs", params={"limit": "3", "a": "1", "b": "2"})
    body = assert_problem(answer, 422, "parameters-invalid")
    assert [fault["pointer"] for fault in body["errors"]] == ["/query/a", "/query/b"]
    assert farm.client.get("/v1/jobs", params={"limit": "3", "state": "queued"}).status_code == 200
