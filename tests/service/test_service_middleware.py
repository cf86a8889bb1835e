"""What surrounds every request: headers, ids, host names, other sites, counters."""

import re

import pytest
from service_farm import Farm, assert_problem


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


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pages_of_other_sites_change_nothing(farm: Farm, site: str) -> None:
    job_id = farm.submit()
    answer = farm.client.post(f"/v1/jobs/{job_id}/cancel", headers={"Sec-Fetch-Site": site})
    assert_problem(answer, 403, "cross-site-request")
    assert farm.client.get(f"/v1/jobs/{job_id}", headers={"Sec-Fetch-Site": site}).json()["state"] == "queued"
    same = farm.client.post(f"/v1/jobs/{job_id}/cancel", headers={"Sec-Fetch-Site": "same-origin"})
    assert same.status_code == 202


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
