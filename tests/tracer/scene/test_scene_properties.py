"""Properties over many documents: round trips, stable bytes, and mutated documents that only ever give SceneErrors."""

import contextlib
import copy
import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_documents import FULL

from tracer.scene import SceneError, parse_scene
from tracer.scene.faults import tokens_of

# --- mutations ----------------------------------------------------------------------------------------------------

_DEEP: Any = 0
for _ in range(70):
    _DEEP = [_DEEP]

# Values that are right nowhere in the full document (None is right for optional members, so it is not among them).
_WRONG: list[Any] = [math.nan, math.inf, -math.inf, 10**400, -(10**5000), "\ud800", _DEEP, {"\udfff": 1}]
_WRONG += [object(), b"bytes", 1j, {1: 2}]
_ODD: list[Any] = [None, True, "", "0", -1, 0, 3, 0.5, 1e300, -1e300, [], {}, [[]], [1, 2, 3], {"type": "sphere"}]


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all members and items below a value."""
    items: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    return [found for key, member in items for found in [(*path, key), *places(member, (*path, key))]]


ALL_PLACES = places(FULL)


def parent_of(document: Any, path: tuple[Any, ...]) -> Any:
    for token in path[:-1]:
        document = document[token]
    return document


def assert_pointer_leads_somewhere(pointer: str, document: Any) -> None:
    """The pointer resolves, or its parent does."""
    tokens = tokens_of(pointer)
    for index, token in enumerate(tokens):
        last = index == len(tokens) - 1
        if isinstance(document, dict):
            assert token in document or last, pointer
            document = document.get(token)
        else:
            assert isinstance(document, list | tuple), pointer
            assert token.isdigit(), pointer
            if int(token) >= len(document):
                assert last, pointer
                return
            document = document[int(token)]


def faults_or_none(document: Any, **options: bool) -> SceneError | None:
    """The SceneError of a document, or None when it is valid; any other exception fails the test."""
    try:
        parse_scene(document, **options)
    except SceneError as caught:
        error = caught
    else:
        return None
    assert error.faults
    for fault in error.faults:
        "".join(fault).encode()
        assert_pointer_leads_somewhere(fault.pointer, document)
    return error


@settings(max_examples=400, deadline=None)
@given(st.sampled_from(ALL_PLACES), st.sampled_from(_WRONG))
def test_wrong_values_anywhere_give_scene_errors(path: tuple[Any, ...], value: Any) -> None:
    document = copy.deepcopy(FULL)
    parent_of(document, path)[path[-1]] = value
    error = faults_or_none(document)
    assert error is not None
    around = "".join("/" + str(token).replace("~", "~0").replace("/", "~1") for token in path)
    assert any(fault.pointer.startswith(around) for fault in error.faults), "no fault speaks of the changed place"


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_several_mutations_give_scene_errors_or_valid_documents(data: st.DataObject) -> None:
    document = copy.deepcopy(FULL)
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from(places(document)))
        parent = parent_of(document, path)
        what = data.draw(st.sampled_from(["delete", "rename", "odd", "wrong", "repeat", "other"]))
        if what == "delete":
            del parent[path[-1]]
        elif what == "rename" and isinstance(parent, dict):
            parent[data.draw(st.text(max_size=4))] = parent.pop(path[-1])
        elif what == "odd":
            parent[path[-1]] = copy.deepcopy(data.draw(st.sampled_from(_ODD)))
        elif what == "wrong":
            parent[path[-1]] = copy.deepcopy(data.draw(st.sampled_from(_WRONG[:-4])))
        elif what == "repeat" and isinstance(parent, list):
            parent.append(copy.deepcopy(parent[path[-1]]))
        else:
            parent[path[-1]] = copy.deepcopy(parent_of(FULL, data.draw(st.sampled_from(ALL_PLACES))))
    faults_or_none(document, require_hashes=data.draw(st.booleans()))


def test_deleting_or_renaming_any_member() -> None:
    optional = 0
    for path in ALL_PLACES:
        if isinstance(path[-1], str):
            document = copy.deepcopy(FULL)
            del parent_of(document, path)[path[-1]]
            optional += faults_or_none(document) is None
            document = copy.deepcopy(FULL)
            parent = parent_of(document, path)
            parent["another name"] = parent.pop(path[-1])
            table = path[0] in {"materials", "assets"} and len(path) == 2
            table |= len(path) > 1 and path[-2] in {"materials", "groups", "companions"}
            assert table or faults_or_none(document) is not None, path
    assert optional > 20  # most members have defaults


def test_every_scalar_retyped() -> None:
    n_refused = 0
    for path in ALL_PLACES:
        value = parent_of(FULL, path)[path[-1]]
        others = {str: [3, True, [], {}], bool: [0, "true", []], int: ["1", True, {}, []], float: ["1", False, {}]}
        for other in others.get(type(value), []):
            document = copy.deepcopy(FULL)
            parent_of(document, path)[path[-1]] = other
            error = faults_or_none(document)
            assert error is not None, (path, other)
            n_refused += 1
    assert n_refused > 300


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.text(max_size=60))
def test_any_bytes_and_texts(data: bytes | str) -> None:
    with pytest.raises(SceneError):
        parse_scene(data)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_texts(data: st.DataObject) -> None:
    text = bytearray(json.dumps(FULL).encode())
    for _ in range(data.draw(st.integers(1, 3))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(SceneError):
        parse_scene(bytes(text))


@settings(max_examples=150, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
        max_leaves=20,
    ),
    st.sampled_from(sorted(FULL)),
)
def test_any_json_in_any_table(value: Any, member: str) -> None:
    faults_or_none({**FULL, member: value})
