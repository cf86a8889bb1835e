"""Bad bodies: each gets a problem that names every fault, none gets a 500."""

import json
import socket
from typing import Any

import httpx
import pytest
from service_farm import MINIMAL, Farm, assert_problem, resolve, scene

JSON = {"Content-Type": "application/json"}


def send(farm: Farm, body: bytes | str, **headers: str) -> httpx.Response:
    return farm.client.post("/v1/jobs", content=body, headers={**JSON, **headers})


@pytest.mark.parametrize(
    "body", [b"", b"{", b"nul", b'{"scene": }', b"\xff\xfe", b'{"a": "\xe9"}', b"{'a': 1}", b"[1,]", b"\x00"]
)
def test_what_is_not_json(farm: Farm, body: bytes) -> None:
    assert_problem(send(farm, body), 400, "malformed-json")


@pytest.mark.parametrize("body", ["[]", "1", "null", '"text"', "true"])
def test_json_that_is_no_object(farm: Farm, body: str) -> None:
    faults = assert_problem(send(farm, body), 422, "request-invalid")["errors"]
    assert faults[0]["pointer"] == ""


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


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ('{"scene": {"version": 1, "version": 1}}', "/scene/version"),
        ('{"priority": 1, "priority": 2, "scene": %s}', "/priority"),
        ('{"scene": %s, "scene": {}}', "/scene"),
        ('{"priority": NaN, "scene": %s}', "/priority"),
        ('{"output": {"tile_size": Infinity}, "scene": %s}', "/output/tile_size"),
        ('{"priority": 1e999, "scene": %s}', "/priority"),
        ('{"name": "\\ud800", "scene": %s}', "/name"),
        ('{"output": ' + "[" * 80 + "]" * 80 + ', "scene": %s}', "/output" + "/0" * 62),
        ('{"scene": {"camera": ' + "[" * 100 + "]" * 100 + "}}", "/scene/camera"),
    ],
)
def test_strict_json(farm: Farm, body: str, pointer: str) -> None:
    answer = send(farm, body.replace("%s", json.dumps(MINIMAL)))
    assert answer.status_code == 422, answer.text
    assert any(fault["pointer"].startswith(pointer) for fault in answer.json()["errors"]), answer.text


def test_very_deep_json_is_refused(farm: Farm) -> None:
    answer = send(farm, "[" * 500_000 + "]" * 500_000)
    assert answer.status_code in {400, 422}
    assert answer.headers["Content-Type"] == "application/problem+json"


def test_a_huge_number_of_digits_is_refused(farm: Farm) -> None:
    answer = send(farm, '{"priority": ' + "9" * 100_000 + ', "scene": ' + json.dumps(MINIMAL) + "}")
    assert answer.status_code == 422


def test_every_fault_is_listed_with_its_pointer(farm: Farm) -> None:
    body: dict[str, Any] = {
        "scene": scene(camera={"type": "perspective", "fov_deg": 190}, image={"width": 0, "height": 48}),
        "output": {"tile_size": 50, "png_color_space": "cmyk", "quality": 1},
        "priority": 101,
        "name": "",
        "extra": 1,
    }
    problem = assert_problem(farm.post(body=body), 422, "request-invalid")
    found = {fault["pointer"]: fault["expected"] for fault in problem["errors"]}
    expected = {
        "/output/tile_size": "a whole number >= 16 and <= 512, a multiple of 16",
        "/output/png_color_space": 'one of "srgb", "linear"',
        "/output/quality": 'one of "png_color_space", "tile_size"',
        "/priority": "a whole number >= 0 and <= 100",
        "/name": "a text, not empty, of at most 200 characters",
        "/extra": 'one of "name", "output", "priority", "scene"',
        "/scene/camera/fov_deg": "a number",
        "/scene/image/width": "a whole number >= 1",
    }
    assert set(found) == set(expected)
    for pointer, text in expected.items():
        assert found[pointer].startswith(text)
        resolve(pointer, body)


def test_a_fault_of_the_scene_alone_has_its_own_type(farm: Farm) -> None:
    problem = assert_problem(farm.post(scene(camera={"type": "fisheye"})), 422, "scene-invalid")
    assert problem["errors"][0]["pointer"] == "/scene/camera/type"
    assert "perspective" in problem["errors"][0]["expected"]


@pytest.mark.parametrize("wrong", [None, 1, [], "x", True])
def test_a_scene_that_is_no_object(farm: Farm, wrong: Any) -> None:
    problem = assert_problem(farm.post(body={"scene": wrong}), 422, "scene-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene"]


def test_a_missing_scene(farm: Farm) -> None:
    problem = assert_problem(farm.post(body={"name": "x"}), 422, "request-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene"]


@pytest.mark.parametrize("value", ["1", 1.5, True, None])
def test_numbers_are_not_guessed_from_other_types(farm: Farm, value: Any) -> None:
    problem = assert_problem(farm.post(body={"scene": scene(), "priority": value}), 422, "request-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/priority"]


@pytest.mark.parametrize("file", ["../x.obj", "/etc/passwd", "http://host/x.obj", "a/b.obj", "c:\\x.obj", "file:x"])
def test_paths_and_urls_are_refused(farm: Farm, file: str) -> None:
    document = scene(assets={"car": {"file": file, "sha256": "ab" * 32}})
    problem = assert_problem(farm.post(document), 422, "scene-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene/assets/car/file"]


def test_assets_without_a_hash_are_refused(farm: Farm) -> None:
    problem = assert_problem(farm.post(scene(assets={"car": {"file": "x.obj"}})), 422, "scene-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene/assets/car/sha256"]


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


def big_scene(n_rows: int) -> dict[str, Any]:
    rows = [[index * 0.001, 0.5, 1.25] for index in range(n_rows)]
    faces = [[index, (index + 1) % n_rows, (index + 2) % n_rows] for index in range(n_rows)]
    return scene(objects=[{"type": "mesh", "positions": rows, "faces": faces}])


def test_a_large_scene_is_parsed_in_a_process_of_its_own(farm: Farm) -> None:
    document = big_scene(30_000)
    assert len(json.dumps(document)) > 1_000_000
    answer = farm.post(document)
    assert answer.status_code == 202
    scene_json = farm.client.get(answer.json()["links"]["scene"])
    assert len(scene_json.json()["objects"][0]["faces"]) == 30_000
    document["objects"][0]["faces"][7] = [0, 1, 99_999]
    problem = assert_problem(farm.post(document), 422, "scene-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene/objects/0/faces/7/2"]
