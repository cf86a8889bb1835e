"""Malformed requests and scenes over HTTP: 4xx with pointers that lead somewhere, never a 500."""

import copy
import json
import string
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from service_farm import MINIMAL, Farm, assert_problem, resolve, scene

VALID: dict[str, Any] = {
    "version": 1,
    "name": "t",
    "camera": {"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 1, 5], "target": [0, 1, 0]}},
    "image": {"width": 64, "height": 48, "crop": {"x": 1, "y": 2, "width": 10, "height": 10}},
    "integrator": {"type": "blinn_phong", "max_depth": 2},
    "sampling": {"samples": 4, "sampler": "sobol", "seed": 7},
    "materials": {"a/b": {"kd": [0.8, 0.1, 0.1], "ks": 0.5, "attenuation": {"a": 1, "b": 0.5, "c": 0}}},
    "lights": [{"type": "ambient", "intensity": 0.1}, {"type": "spot", "position": [0, 2, 0], "direction": [0, -1, 0]}],
    "objects": [
        {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]], "material": "a/b",
         "groups": {"g": [0, 1]}, "transform": [{"type": "rotate", "axis": [0, 0, 1], "angle_deg": 90}]},
        {"type": "sphere", "center": [0, 1, 0], "radius": 1},
    ],
    "background": [0.1, 0.2, 0.3],
}  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, item in items for place in places(item, (*path, key)))]


PLACES = [place for place in places(VALID) if place]

texts = st.text(max_size=12) | st.text(string.printable, max_size=5)
# Nothing here can be right at any place: a type no member has, a number out of every range, a reference to nothing.
wrong = st.one_of(
    st.just(-1e31), st.just(1e999), st.just(float("nan")), st.just({"no": "thing"}), st.just([[[]]]), st.just([None]),
    st.just("\ud800"), texts.map(lambda text: "?" + text), st.dictionaries(texts.map(lambda text: "?" + text), st.none(), min_size=1),
)  # fmt: skip


def spoil(document: Any, path: tuple[Any, ...], value: Any) -> None:
    for key in path[:-1]:
        try:
            document = document[key]
        except (KeyError, IndexError, TypeError):
            return  # an earlier fault has replaced what was here
    fits = isinstance(document, dict if isinstance(path[-1], str) else list)
    if fits and (isinstance(document, dict) or path[-1] < len(document)):
        document[path[-1]] = value


@settings(
    max_examples=200,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(faults=st.lists(st.tuples(st.sampled_from(PLACES), wrong), min_size=1, max_size=4), how=st.integers(0, 3))
def test_malformed_documents(farm: Farm, faults: list[tuple[Any, Any]], how: int) -> None:
    document = copy.deepcopy(VALID)
    for path, value in faults:
        if path != ("name",) or not isinstance(value, str):  # any text may be the name
            spoil(document, path, copy.deepcopy(value))
    if how == 0:
        document["?unknown"] = 1
    body = {"scene": document}
    answer = farm.client.post(
        "/v1/jobs",
        content=json.dumps(body),
        headers={"Content-Type": "application/json"},
        params={"validate_only": how == 1},
    )
    if answer.status_code in {200, 202}:
        assert document == VALID
        return
    problem = assert_problem(answer, 422, "scene-invalid")
    assert problem["errors"]
    for fault in problem["errors"]:
        assert fault["pointer"].startswith("/scene")
        assert fault["detail"]
        assert fault["expected"]
        resolve(fault["pointer"], body)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)


@settings(
    max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(values)
def test_any_json_as_body(farm: Farm, value: Any) -> None:
    answer = farm.client.post("/v1/jobs", content=json.dumps(value), headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    for fault in answer.json()["errors"]:
        resolve(fault["pointer"], value)


@settings(
    max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_damaged_texts(farm: Farm, data: st.DataObject) -> None:
    text = bytearray(json.dumps({"scene": VALID}).encode())
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(text) - 1))
        text[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    answer = farm.client.post("/v1/jobs", content=bytes(text), headers={"Content-Type": "application/json"})
    assert answer.status_code in {202, 400, 422}, answer.text


@pytest.mark.parametrize("place", PLACES, ids=lambda place: "/".join(map(str, place)))
def test_leaving_out_any_member(farm: Farm, place: tuple[Any, ...]) -> None:
    document = copy.deepcopy(VALID)
    parent: Any = document
    for key in place[:-1]:
        parent = parent[key]
    del parent[place[-1]]
    answer = farm.post(document)
    assert answer.status_code in {202, 422}
    for fault in answer.json().get("errors", []):
        resolve(fault["pointer"], {"scene": document})


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
