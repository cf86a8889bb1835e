"""Where hashes are required, only plain relative names and full hashes pass."""

from typing import Any

import pytest
from scene_documents import HASH, MINIMAL

from tracer.scene import SceneError, parse_scene


def pointers(asset: dict[str, Any], *, require_hashes: bool = True) -> list[str]:
    try:
        parse_scene({**MINIMAL, "assets": {"car": asset}}, require_hashes=require_hashes)
    except SceneError as error:
        return [fault.pointer.removeprefix("/assets/car") for fault in error.faults]
    return []


@pytest.mark.parametrize("name", ["car.obj", "Ein Auto.obj", "...", "a..b", "~", "été.png", "-rf", "x" * 251 + ".obj"])
def test_plain_names_pass(name: str) -> None:
    assert pointers({"file": name, "sha256": HASH}) == []
    assert pointers({"file": "a", "sha256": HASH, "companions": {"sub/" + name: HASH}}) == []


@pytest.mark.parametrize(
    "name",
    [
        "http://example.org/car.obj",
        "file:car.obj",
        "/car.obj",
        "/",
        "..",
        ".",
        "\\car.obj",
        "C:car.obj",
        "C:/car.obj",
        "a\\b",
        "\\\\server\\a",
        "a\x00b",
        "a\nb",
        "x" * 256,
        "é" * 128,
    ],
)
def test_paths_and_schemes_are_refused(name: str) -> None:
    assert pointers({"file": name, "sha256": HASH}) == ["/file"]
    told = pointers({"file": "a", "sha256": HASH, "companions": {name: HASH}})
    assert told == ["/companions/" + name.replace("/", "~1")]


@pytest.mark.parametrize("name", ["a/b.obj", "a//b", "a/", "../a", "a/../b", "./a"])
def test_folders_are_for_companions_only(name: str) -> None:
    assert pointers({"file": name, "sha256": HASH}) == ["/file"]
    expected = [] if name == "a/b.obj" else ["/companions/" + name.replace("/", "~1")]
    assert pointers({"file": "f", "sha256": HASH, "companions": {name: HASH}}) == expected


def test_each_hash_is_needed_where_the_service_asks() -> None:
    asset = {"file": "sub/car.obj", "companions": {"car.mtl": None}}
    assert pointers(asset, require_hashes=False) == []
    assert pointers(asset) == ["/file", "/sha256", "/companions/car.mtl"]


def test_companions_may_not_replace_the_file_or_each_other() -> None:
    assert pointers({"file": "a", "sha256": HASH, "companions": {"a": HASH}}) == ["/companions/a"]
    assert pointers({"file": "f", "sha256": HASH, "companions": {"a": HASH, "a/b": HASH}}) == ["/companions/a"]
    assert pointers({"file": "f", "sha256": HASH, "companions": {"f/b": HASH}}) == ["/file"]
