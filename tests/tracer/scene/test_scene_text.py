"""Strict JSON text: what is refused before a model sees it."""

import json
import time
from typing import Any

import pytest
from scene_documents import MINIMAL, faults_of

from tracer.scene import parse_scene
from tracer.scene.limits import MAX_TEXT_BYTES


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b'{"version": 1, "version": 1}', "/version"),
        (b'{"camera": {"type": "perspective", "fov_deg": 1, "fov_deg": 2}}', "/camera/fov_deg"),
        (b'{"camera": {"fov_deg": NaN}}', "/camera/fov_deg"),
        (b'{"camera": {"fov_deg": -Infinity}}', "/camera/fov_deg"),
        (b'{"camera": {"fov_deg": 1e999}}', "/camera/fov_deg"),
        (b'{"camera": {"fov_deg": 1' + b"0" * 400 + b"}}", "/camera/fov_deg"),
        (b'{"camera": {"fov_deg": -1' + b"0" * 9000 + b"}}", "/camera/fov_deg"),
        (b'{"image": {"width": 1' + b"0" * 309 + b"}}", "/image/width"),
        (b'{"background": [0, Infinity, 0]}', "/background/1"),
        (b'{"name": "\\ud800"}', "/name"),
        (b'{"materials": {"\\udfff": {}}}', "/materials"),
        (b'{"objects": ' + b"[" * 70 + b"]" * 70 + b"}", "/objects" + "/0" * 63),
        (b'{"a": ' * 100_000, ""),
        (b"[" * 100_000 + b"]" * 100_000, ""),
        (b'{"name": "\xff"}', ""),
        (b"\xff\xfe{\x00}\x00", ""),
        (b"", ""),
        (b"{", ""),
        (b"{'a': 1}", ""),
        (b"{} {}", ""),
        (b"[]", ""),
        (b"null", ""),
        (b"3", ""),
        (b'"text"', ""),
        (b"true", ""),
        (b"NaN", ""),
        (b"9" * 5000, ""),
    ],
    ids=range(27),
)
def test_text_that_is_no_document(text: bytes, told: str) -> None:
    faults = faults_of(text)
    assert told in faults, faults
    for fault in faults.values():  # every text can be sent on
        "".join(fault).encode()


def test_lone_surrogates_and_marks_in_text() -> None:
    assert "/name" in faults_of(json.dumps({**MINIMAL, "name": "x"}).replace("x", "\ud800"))
    assert parse_scene("\ufeff" + json.dumps(MINIMAL)) == parse_scene(MINIMAL)
    assert parse_scene(b"\xef\xbb\xbf" + json.dumps(MINIMAL).encode()) == parse_scene(MINIMAL)


def test_mappings_with_what_json_cannot_say() -> None:
    loop: dict[str, Any] = dict(MINIMAL)
    loop["objects"] = [loop]
    assert any("nests deeper" in message for message, _ in faults_of(loop).values())
    assert "" in faults_of({**MINIMAL, 3: 4})
    assert "/name" in faults_of({**MINIMAL, "name": object()})
    assert "/image" in faults_of({**MINIMAL, "image": {1, 2}})
    assert "/camera/fov_deg" in faults_of({**MINIMAL, "camera": {"type": "perspective", "fov_deg": 10**400}})


def test_floods_of_text_are_refused_before_parsing() -> None:
    start = time.process_time()
    assert "" in faults_of(b'{"objects": [' + b"[]," * 5_000_000 + b"[]]}")
    assert "" in faults_of(b'{"objects": [' + b"1," * 17_000_000 + b"1]}")
    assert "" in faults_of(b" " * (MAX_TEXT_BYTES + 1))
    assert time.process_time() - start < 2.0
