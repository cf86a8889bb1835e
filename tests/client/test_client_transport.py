"""Retries: what is sent again, when, and what is not."""

from collections.abc import Callable
from email.utils import formatdate
from typing import Any

import httpx
import pytest

from client.errors import ApiError, ConflictError, NotReachableError, UsageError
from client.transport import Transport, is_loopback, retry_after_s

REFUSED = httpx.ConnectError("refused")
BROKEN = httpx.ReadError("broken")


def test_a_get_is_sent_again_until_it_is_answered(fake: Any) -> None:
    fake.add_job()
    fake.next("GET", "/v1/jobs/job1", REFUSED, BROKEN, httpx.Response(502), httpx.Response(503))
    assert fake.client().status("job1").state == "succeeded"
    assert fake.count("GET", "/v1/jobs/job1") == 5
    assert len(fake.sleeps) == 4
    assert all(0.5 * 0.2 * 2**n <= one <= 0.2 * 2**n for n, one in enumerate(fake.sleeps))


def test_a_service_that_stays_away_is_not_reachable(fake: Any) -> None:
    fake.next("GET", "/v1/jobs/job1", *[REFUSED] * 9)
    with pytest.raises(NotReachableError, match=r"127\.0\.0\.1:9") as caught:
        fake.client(retries=2).status("job1")
    assert fake.count("GET", "/v1/jobs/job1") == 3
    assert "smalti serve" in caught.value.hint


def test_retry_after_is_respected(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.add_job()
    fake.next(
        "GET", "/v1/jobs/job1", make_problem(429, "slow-down", retry_after=7), make_problem(503, "x", retry_after=0)
    )
    fake.client().status("job1")
    assert fake.sleeps == [7.0, 0.0]


def test_a_wait_that_is_too_long_is_an_error_now(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.next("GET", "/v1/jobs/job1", make_problem(503, "x", retry_after=3600))
    with pytest.raises(NotReachableError):
        fake.client().status("job1")
    assert fake.sleeps == []


def test_a_post_without_key_is_sent_again_only_if_it_never_left(fake: Any) -> None:
    fake.add_job(state="rendering")
    fake.next("POST", "/v1/jobs/job1/cancel", REFUSED)
    assert fake.client().cancel("job1").state == "canceling"
    fake.next("POST", "/v1/jobs/job1/cancel", BROKEN)
    with pytest.raises(NotReachableError):
        fake.client().cancel("job1")
    assert fake.count("POST", "/v1/jobs/job1/cancel") == 3


def test_other_errors_are_told_at_once(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.next("GET", "/v1/jobs/job1", make_problem(500, "internal-error", detail="Oops."))
    with pytest.raises(ApiError, match="Oops"):
        fake.client().status("job1")
    assert len(fake.requests) == 1


def test_a_conflict_without_retry_after_is_told_at_once(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.next("POST", "/v1/jobs/job1/cancel", make_problem(409, "illegal-transition"))
    with pytest.raises(ConflictError):
        fake.client().cancel("job1")
    assert len(fake.requests) == 1


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        (None, None),
        ("5", 5.0),
        (" 0 ", 0.0),
        ("soon", None),
        ("-3", None),
        (formatdate(1010, usegmt=True), 10.0),
        (formatdate(5), 0.0),
    ],
)
def test_retry_after_reads_seconds_and_dates(value: str | None, seconds: float | None) -> None:
    assert retry_after_s(value, now=1000.0) == seconds


@pytest.mark.parametrize(
    ("url", "answer"),
    [
        ("http://127.0.0.1:1", True),
        ("http://localhost", True),
        ("http://[::1]:1", True),
        ("http://10.0.0.1", False),
        ("https://a.b", False),
    ],
)
def test_loopback(url: str, answer: bool) -> None:
    assert is_loopback(url) is answer


@pytest.mark.parametrize("url", ["", "localhost:8000", "ftp://a", "http://"])
def test_malformed_addresses_are_wrong_usage(url: str) -> None:
    with pytest.raises(UsageError):
        Transport(url)


@pytest.mark.parametrize(
    "answer", [httpx.Response(200, text="<html>"), httpx.Response(200, json=[1]), httpx.Response(200, json={"a": 1})]
)
def test_another_program_at_the_address_is_told(fake: Any, answer: httpx.Response) -> None:
    fake.next("GET", "/v1/jobs/job1", answer)
    with pytest.raises(ApiError, match=r"127\.0\.0\.1:9"):
        fake.client().status("job1")


def test_an_error_page_that_is_no_problem_document(fake: Any) -> None:
    fake.next("GET", "/v1/jobs/job1", httpx.Response(500, text="<html>", headers={"Content-Type": "application/json"}))
    with pytest.raises(ApiError, match="HTTP 500") as caught:
        fake.client().status("job1")
    assert "another program" in caught.value.hint
