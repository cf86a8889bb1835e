"""What surrounds the routes: methods, paths, headers, hosts, health, metrics, pages."""

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import jsonschema
import pytest
from redis.exceptions import ResponseError
from service_farm import MINIMAL, Farm, assert_problem, scene, serve

from service.problems import CATALOGUE
from service.reference import render_reference
from service.settings import ServiceSettings


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


@pytest.mark.parametrize(
    "path", ["/", "/docs", "/healthz", "/readyz", "/metrics", "/v1/jobs", "/v1/schema", "/openapi.json"]
)
def test_head_is_get_without_the_body(farm: Farm, path: str) -> None:
    get, head = farm.client.get(path), farm.client.head(path)
    assert head.status_code == get.status_code
    assert head.content == b""
    assert head.headers["Content-Type"] == get.headers["Content-Type"]


@pytest.mark.parametrize("path", ["/", "/v1/jobs", "/nope", "/static/page.js"])
def test_security_headers(farm: Farm, path: str) -> None:
    headers = farm.client.get(path).headers
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert re.fullmatch(r"[0-9a-f]{16}", headers["X-Request-ID"])


def test_request_ids_of_the_client_are_kept_when_harmless(farm: Farm) -> None:
    assert farm.client.get("/healthz", headers={"X-Request-ID": "abc-1"}).headers["X-Request-ID"] == "abc-1"
    assert farm.client.get("/healthz", headers={"X-Request-ID": "a b<script>"}).headers["X-Request-ID"] != "a b<script>"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil:80", ""])
def test_other_host_names_are_refused_on_loopback(farm: Farm, host: str) -> None:
    assert_problem(farm.client.get("/v1/jobs", headers={"Host": host}), 421, "host-refused")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:99", "127.0.0.1:1", "[::1]:8765"])
def test_loopback_names_are_served(farm: Farm, host: str) -> None:
    assert farm.client.get("/healthz", headers={"Host": host}).status_code == 200


def test_host_names_by_setting() -> None:
    assert ServiceSettings(host="127.0.0.1").host_names() == frozenset()
    assert ServiceSettings(host="::1").host_names() == frozenset()
    assert ServiceSettings(host="0.0.0.0").host_names() == {"*"}
    assert ServiceSettings(host="0.0.0.0", allowed_hosts="a.example, B.example").host_names() == {
        "a.example",
        "b.example",
    }


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pages_of_other_sites_change_nothing(farm: Farm, site: str) -> None:
    job_id = farm.submit()
    answer = farm.client.post(f"/v1/jobs/{job_id}/cancel", headers={"Sec-Fetch-Site": site})
    assert_problem(answer, 403, "cross-site-request")
    assert farm.client.get(f"/v1/jobs/{job_id}", headers={"Sec-Fetch-Site": site}).json()["state"] == "queued"
    same = farm.client.post(f"/v1/jobs/{job_id}/cancel", headers={"Sec-Fetch-Site": "same-origin"})
    assert same.status_code == 202


# ---- the service itself ----------------------------------------------------------------------------------------------


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


def test_metrics(farm: Farm) -> None:
    farm.submit()
    farm.client.get("/v1/jobs/some-secret-id")
    text = farm.client.get("/metrics").text
    assert re.search(r'smalti_http_requests_total\{method="POST",route="/v1/jobs",status="202"\} \d', text)
    assert 'route="/v1/jobs/{job_id}",status="404"' in text
    assert "smalti_queue_up 1.0" in text
    assert "smalti_jobs_accepted_total" in text
    assert "process_resident_memory_bytes" in text
    assert "some-secret-id" not in text  # routes are templates: series stay few


def test_schema_is_that_of_the_scene(farm: Farm) -> None:
    answer = farm.client.get("/v1/schema")
    assert answer.headers["Content-Type"] == "application/schema+json"
    schema = answer.json()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(MINIMAL, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(scene(version=2), schema)


# ---- Redis is away ---------------------------------------------------------------------------------------------------


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


def test_a_redis_that_refuses_is_an_outage_and_no_bug(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise ResponseError("MISCONF Errors writing to the AOF file: No space left on device")

    monkeypatch.setattr(farm.context.queue, "workers", refuse)
    assert_problem(farm.client.get("/v1/workers"), 503, "queue-unavailable")


# ---- pages -----------------------------------------------------------------------------------------------------------


class Links(HTMLParser):
    """Everything that a page loads or links to, and whatever a Content-Security-Policy would refuse."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.inline: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in {"href", "src"} and value:
                self.links.append(value)
            if name == "style" or name.startswith("on"):
                self.inline.append(f"{tag} {name}")
        if tag == "style" or (tag == "script" and "src" not in dict(attrs)):
            self.inline.append(tag)


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_pages_load_nothing_from_elsewhere(farm: Farm, path: str) -> None:
    answer = farm.client.get(path)
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    page = Links(answer.text)
    assert page.inline == []
    for link in page.links:
        assert link.startswith(("/", "#")), link
        if link.startswith("/") and link != "/readyz":
            assert farm.client.get(link).status_code == 200, link


def test_static_files_name_no_other_host() -> None:
    folder = Path(__file__).resolve().parents[2] / "service" / "static"
    for path in folder.iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "").replace("http://localhost", "")
        assert "http" not in text.replace("https?", ""), path.name
        assert "innerHTML" not in text


def test_the_reference_escapes() -> None:
    evil = "<script>alert(1)</script>"
    operation = {
        "tags": ["t"], "summary": evil, "description": evil, "parameters": [{"name": evil, "in": "query", "description": evil}],
        "responses": {"200": {"description": evil, "content": {"a/b": {"example": evil}}}},
    }  # fmt: skip
    document = {
        "info": {"title": evil, "version": evil},
        "tags": [{"name": "t", "description": evil}],
        "paths": {f"/{evil}": {"get": operation}},
    }
    page = render_reference(document)
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 8


def test_problem_types_are_unique_and_documented(farm: Farm) -> None:
    assert len({kind.slug for kind in CATALOGUE}) == len(CATALOGUE)
    page = farm.client.get("/docs").text
    for kind in CATALOGUE:
        assert kind.uri in page
