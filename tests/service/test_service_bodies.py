"""Bodies: their media type, their length, and what arrives of them."""

import json
import socket
from typing import Any

import httpx
import pytest
from service_farm import MINIMAL, Farm, assert_problem

JSON = {"Content-Type": "application/json"}


def send(farm: Farm, body: bytes | str, **headers: str) -> httpx.Response:
    return farm.client.post("/v1/jobs", content=body, headers={**JSON, **headers})


@pytest.mark.parametrize(
    "content_type", ["", "text/plain", "application/x-www-form-urlencoded", "image/png", "nonsense"]
)
def test_other_media_types(farm: Farm, content_type: str) -> None:
    body = json.dumps({"scene": MINIMAL})
    answer = farm.client.post("/v1/jobs", content=body, headers={"Content-Type": content_type})
    assert_problem(answer, 415, "media-type-unsupported")


def test_other_charsets_and_encodings(farm: Farm) -> None:
    body = json.dumps({"scene": MINIMAL})
    assert_problem(
        send(farm, body, **{"Content-Type": "application/json; charset=latin-1"}), 415, "media-type-unsupported"
    )
    assert_problem(send(farm, body, **{"Content-Encoding": "gzip"}), 415, "media-type-unsupported")
    assert send(farm, body, **{"Content-Type": "application/json; charset=UTF-8"}).status_code == 202
    assert send(farm, body, **{"Content-Type": "application/vnd.smalti+json"}).status_code == 202


def test_a_body_over_the_limit_is_refused_by_its_announcement(farm: Farm) -> None:
    problem = assert_problem(send(farm, b" " * ((4 << 20) + 1)), 413, "too-large")
    assert problem["limit_bytes"] == 4 << 20


def test_the_announcement_is_enough(farm: Farm) -> None:
    host, port = farm.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        head = f"POST /v1/jobs HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\nContent-Length: {1 << 40}\r\n\r\n"
        connection.sendall(head.encode())
        assert connection.recv(4096).startswith(b"HTTP/1.1 413 ")


def test_a_body_over_the_limit_is_refused_while_it_arrives(farm: Farm) -> None:
    def pieces() -> Any:
        for _ in range(80):
            yield b" " * 65536

    answer = farm.client.post("/v1/jobs", content=pieces(), headers=JSON)
    assert_problem(answer, 413, "too-large")
