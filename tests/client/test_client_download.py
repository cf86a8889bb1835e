"""Downloads: whole or not at all, resumed, checked."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from client.download import parse_repr_digest
from client.errors import ConflictError, DownloadError, NotFoundError, NotReachableError

BODY = bytes(range(256)) * 5000


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


@pytest.fixture
def service(fake: Any) -> Any:
    fake.add_job()
    fake.results = {"result.png": BODY, "result.exr": b"exr", "preview.png": b"preview"}
    return fake


def breaking(service: Any, n_bytes: int, **changes: str) -> Any:
    """An answer whose connection breaks after so many bytes."""

    def answer(request: httpx.Request) -> httpx.Response:
        whole = service.answer_file(request, BODY)

        def part() -> Iterator[bytes]:
            yield whole.read()[:n_bytes]
            raise httpx.ReadError("broken")

        return httpx.Response(whole.status_code, headers={**whole.headers, **changes}, content=part())

    return answer


def test_file_is_whole_and_new_folders_are_made(service: Any, tmp_path: Path) -> None:
    target = tmp_path / "a/b/out.png"
    assert service.client().get("job1", target) == len(BODY)
    assert target.read_bytes() == BODY
    assert names(target.parent) == ["out.png"]
    mask = os.umask(0)
    os.umask(mask)
    assert target.stat().st_mode & 0o777 == 0o666 & ~mask


def test_kind_follows_the_extension_or_the_argument(service: Any, tmp_path: Path) -> None:
    service.client().get("job1", tmp_path / "a.EXR")
    service.client().get("job1", tmp_path / "b.png", kind="preview")
    assert (tmp_path / "a.EXR").read_bytes() == b"exr"
    assert (tmp_path / "b.png").read_bytes() == b"preview"


def test_only_the_rest_is_asked_for_after_a_break(service: Any, tmp_path: Path) -> None:
    service.next(
        "GET", "/v1/jobs/job1/result.png", breaking(service, 1000), breaking(service, 500), httpx.ConnectError("away")
    )
    service.client().get("job1", tmp_path / "out.png")
    assert (tmp_path / "out.png").read_bytes() == BODY
    ranges = [one.headers.get("Range") for one in service.requests]
    assert ranges == [None, "bytes=1000-", "bytes=1500-", "bytes=1500-"]
    assert service.requests[1].headers["If-Range"] == '"v1"'


def test_a_result_that_changed_meanwhile_is_read_from_the_start(service: Any, tmp_path: Path) -> None:
    service.next("GET", "/v1/jobs/job1/result.png", breaking(service, 1000, ETag='"v0"'))
    service.client().get("job1", tmp_path / "out.png")
    assert (tmp_path / "out.png").read_bytes() == BODY


def test_a_range_from_elsewhere_is_not_appended(service: Any, tmp_path: Path) -> None:
    def shifted(request: httpx.Request) -> httpx.Response:
        answer = service.answer_file(request, BODY)
        return httpx.Response(
            206,
            content=iter([BODY[999:]]),
            headers={**answer.headers, "content-range": f"bytes 999-{len(BODY) - 1}/{len(BODY)}"},
        )

    service.next("GET", "/v1/jobs/job1/result.png", breaking(service, 1000), shifted)
    service.client().get("job1", tmp_path / "out.png")
    assert (tmp_path / "out.png").read_bytes() == BODY
    assert [one.headers.get("Range") for one in service.requests] == [None, "bytes=1000-", None]


def test_damage_is_seen_and_the_old_file_stays(service: Any, tmp_path: Path) -> None:
    target = tmp_path / "out.png"
    target.write_bytes(b"old")
    good = service.answer_file(httpx.Request("GET", "http://x"), BODY)
    service.next(
        "GET", "/v1/jobs/job1/result.png", httpx.Response(200, content=iter([BODY[:-1] + b"x"]), headers=good.headers)
    )
    with pytest.raises(DownloadError, match="SHA-256"):
        service.client().get("job1", target)
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["out.png"]


def test_a_service_that_goes_away_leaves_nothing_behind(service: Any, tmp_path: Path) -> None:
    service.next("GET", "/v1/jobs/job1/result.png", *[breaking(service, 10)] * 9)
    with pytest.raises(NotReachableError):
        service.client().get("job1", tmp_path / "out.png")
    assert names(tmp_path) == []


def test_results_that_are_not_there(service: Any, tmp_path: Path) -> None:
    del service.results["result.exr"]
    with pytest.raises(ConflictError, match="not there yet"):
        service.client().get("job1", tmp_path / "out.exr")
    with pytest.raises(NotFoundError):
        service.client().get("job9", tmp_path / "out.exr")
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("header", "digest"),
    [
        (None, None),
        ("", None),
        ("sha-256=:AAEC:", b"\0\1\2"),
        ("sha-512=:AAEC:, sha-256=:AAEC:", b"\0\1\2"),
        ("sha-512=:AAEC:", None),
        ("sha-256=AAEC", None),
        ("sha-256=:%%:", None),
    ],
)
def test_digest_header(header: str | None, digest: bytes | None) -> None:
    assert parse_repr_digest(header) == digest
