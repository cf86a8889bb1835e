"""From what the framework, the farm and Redis raise to problem documents."""

import pytest
from redis.exceptions import ResponseError
from service_farm import Farm, assert_problem


@pytest.mark.parametrize("path", ["/nope", "/v1", "/v1/jobs/", "/v1/jobs/x/y/z", "/static/../app.py", "/static/app.py"])
def test_unknown_paths(farm: Farm, path: str) -> None:
    assert_problem(farm.client.get(path), 404, "route-not-found")


@pytest.mark.parametrize(
    ("method", "path", "allow"),
    [
        ("PUT", "/v1/jobs", "GET, HEAD, POST"),
        ("PATCH", "/v1/jobs/x", "DELETE, GET, HEAD"),
        ("GET", "/v1/jobs/x/cancel", "POST"),
        ("POST", "/healthz", "GET, HEAD"),
        ("GET", "/v1/assets/x", "PUT"),
        ("OPTIONS", "/v1/jobs", "GET, HEAD, POST"),
        ("TRACE", "/", "GET, HEAD"),
        ("POST", "/openapi.json", "GET, HEAD"),
    ],
)
def test_wrong_methods(farm: Farm, method: str, path: str, allow: str) -> None:
    answer = farm.client.request(method, path)
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["Allow"] == allow


def test_a_redis_that_refuses_is_an_outage_and_no_bug(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise ResponseError("MISCONF Errors writing to the AOF file: No space left on device")

    monkeypatch.setattr(farm.context.queue, "workers", refuse)
    assert_problem(farm.client.get("/v1/workers"), 503, "queue-unavailable")
