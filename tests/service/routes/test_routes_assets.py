"""Assets: which are missing, uploads, and scenes that use them."""

import hashlib
import os
import socket
import threading
import time
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from service_farm import Farm, assert_problem, scene

from service.routes import assets

LIMIT = 3 << 20


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def put(farm: Farm, data: Any, sha256: str, **headers: str) -> httpx.Response:
    return farm.client.put(f"/v1/assets/{sha256}", content=data, headers=headers)


def test_new_then_present(farm: Farm) -> None:
    data = os.urandom(1000)
    first = put(farm, data, sha(data))
    assert first.status_code == 201
    assert first.json() == {"sha256": sha(data), "size_bytes": 1000, "created": True}
    second = put(farm, data, sha(data))
    assert second.status_code == 200
    assert second.json()["created"] is False
    assert farm.store.asset_path(sha(data)).read_bytes() == data


def test_an_upload_in_pieces_without_a_length(farm: Farm) -> None:
    data = os.urandom(2_500_001)
    pieces = (data[start : start + 70_000] for start in range(0, len(data), 70_000))
    assert put(farm, pieces, sha(data)).status_code == 201
    assert farm.store.asset_path(sha(data)).read_bytes() == data


def test_an_empty_file(farm: Farm) -> None:
    assert put(farm, b"", sha(b"")).status_code in {200, 201}


@pytest.mark.parametrize("present", [False, True])
def test_other_bytes_than_the_hash_says(farm: Farm, present: bool) -> None:
    data = os.urandom(100)
    if present:
        put(farm, data, sha(data))
    assert_problem(put(farm, b"other", sha(data)), 422, "hash-mismatch")
    assert farm.store.has_asset(sha(data)) is present
    assert not list(farm.store.temporary.glob(".asset-*"))


@pytest.mark.parametrize("name", ["x", "A" * 64, "g" * 64, "%2e%2e%2fjob", "0" * 63, "0" * 65])
def test_names_that_are_no_hash(farm: Farm, name: str) -> None:
    answer = put(farm, b"x", name)
    assert answer.status_code in {404, 422}
    assert answer.headers["Content-Type"] == "application/problem+json"


def test_too_large_by_announcement_and_on_arrival(farm: Farm) -> None:
    data = bytes(LIMIT + 1)
    assert assert_problem(put(farm, data, sha(data)), 413, "too-large")["limit_bytes"] == LIMIT
    assert_problem(put(farm, iter([data]), sha(data)), 413, "too-large")
    exact = bytes(LIMIT)
    assert put(farm, iter([exact]), sha(exact)).status_code == 201
    assert not list(farm.store.temporary.glob(".asset-*"))


def test_a_client_that_leaves_in_the_middle_leaves_nothing_behind(farm: Farm) -> None:
    data = os.urandom(2 << 20)
    host, port = farm.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as connection:
        head = f"PUT /v1/assets/{sha(data)} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(data)}\r\n\r\n"
        connection.sendall(head.encode() + data[: 1 << 20])
    for _ in range(100):
        if not list(farm.store.temporary.glob(".asset-*")):
            break
        farm.client.get("/healthz")
    assert not farm.store.has_asset(sha(data))
    assert put(farm, data, sha(data)).status_code == 201


def stall(farm: Farm, stack: ExitStack, data: bytes) -> socket.socket:
    """Begin an upload, and send no more than its first half."""
    host, port = farm.url.removeprefix("http://").split(":")
    connection = stack.enter_context(socket.create_connection((host, int(port)), timeout=20))
    head = f"PUT /v1/assets/{sha(data)} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(data)}\r\n\r\n"
    connection.sendall(head.encode() + data[: len(data) // 2])
    return connection


def test_many_stalled_uploads_stop_nobody_else(farm: Farm) -> None:
    data = os.urandom(1000)
    with ExitStack() as stack:
        for _ in range(60):  # more than the threads that all requests share
            stall(farm, stack, data)
        time.sleep(0.3)
        assert farm.client.get("/v1/jobs", timeout=5).status_code == 200


def test_a_silent_upload_is_ended(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets, "SILENCE_S", 0.2)
    data = os.urandom(1000)
    with ExitStack() as stack:
        connection = stall(farm, stack, data)
        answer = b"".join(iter(lambda: connection.recv(4096), b""))  # to the end: the connection is closed
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"urn:smalti:problem:upload-stalled" in answer
    assert not list(farm.store.temporary.glob(".asset-*"))
    assert not farm.store.has_asset(sha(data))


def test_a_slow_upload_is_not_ended(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets, "SILENCE_S", 0.5)
    data = os.urandom(8)
    waits = threading.Event()

    def pieces() -> Any:
        for byte in data:  # 0.8 s in all, each piece well within the limit
            waits.wait(0.1)
            yield bytes([byte])

    assert put(farm, pieces(), sha(data)).status_code == 201


def test_who_asks_first_need_not_send_what_is_here(farm: Farm) -> None:
    data = os.urandom(1 << 20)
    put(farm, data, sha(data))
    host, port = farm.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        head = f"PUT /v1/assets/{sha(data)} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(data)}\r\nExpect: 100-continue\r\n\r\n"
        connection.sendall(head.encode())
        answer = connection.recv(4096)
    assert answer.startswith(b"HTTP/1.1 200 ")


def test_missing(farm: Farm) -> None:
    data = os.urandom(10)
    put(farm, data, sha(data))
    asked = [sha(b"a"), sha(data), sha(b"b"), sha(b"a")]
    answer = farm.client.post("/v1/assets:missing", json={"sha256": asked})
    assert answer.status_code == 200
    assert answer.json() == {"missing": [sha(b"a"), sha(b"b")]}


@pytest.mark.parametrize(
    ("body", "pointer", "expected"),
    [
        ({}, "/sha256", "an array of at most 10000 items, each 64 lower-case hex digits"),
        ({"sha256": "x"}, "/sha256", "an array of at most 10000 items, each 64 lower-case hex digits"),
        ({"sha256": ["x"]}, "/sha256/0", "64 lower-case hex digits"),
        ({"sha256": [1]}, "/sha256/0", "64 lower-case hex digits"),
        ({"sha256": ["../../etc"]}, "/sha256/0", "64 lower-case hex digits"),
        ({"sha256": [], "more": 1}, "/more", '"sha256"'),
        ([], "", "an object"),
    ],
)
def test_questions_that_are_none(farm: Farm, body: Any, pointer: str, expected: str) -> None:
    problem = assert_problem(farm.client.post("/v1/assets:missing", json=body), 422, "request-invalid")
    (fault,) = problem["errors"]
    assert fault["pointer"] == pointer
    assert fault["expected"].startswith(expected)


def test_a_scene_waits_for_its_assets(farm: Farm) -> None:
    mesh, texture, companion, unused = (os.urandom(20) for _ in range(4))
    document = scene(
        materials={"wood": {"diffuse_texture": {"asset": "wo/od"}}},
        objects=[{"type": "mesh_asset", "asset": "car", "material": "wood"}],
        assets={
            "car": {"file": "car.obj", "sha256": sha(mesh), "companions": {"car.mtl": sha(companion)}},
            "wo/od": {"file": "wood.png", "sha256": sha(texture)},
            "idle": {"file": "idle.png", "sha256": sha(unused)},
        },
    )
    put(farm, mesh, sha(mesh))
    problem = assert_problem(farm.post(document), 409, "assets-missing")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene/assets/car", "/scene/assets/wo~1od"]
    assert problem["missing"] == [sha(companion), sha(texture)]
    put(farm, companion, sha(companion))
    put(farm, texture, sha(texture))
    assert farm.post(document).status_code == 202
