"""Faults: pointers that lead there and back, and texts that are short and always UTF-8."""

import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracer.scene import Fault, SceneError
from tracer.scene.faults import closest, merged, one_of, pointer_of, quoted, shown, tokens_of
from tracer.scene.limits import MAX_FAULTS


@given(st.lists(st.text()))
def test_pointers_lead_there_and_back(tokens: list[str]) -> None:
    assert tokens_of(pointer_of(*tokens)) == tokens


def test_a_pointer_escapes_and_goes_below() -> None:
    assert pointer_of("a/b", "m~n", 0) == "/a~1b/m~0n/0"
    assert Fault("/x", "is 1", "2").below("/scene") == Fault("/scene/x", "is 1", "2")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (1.5, "1.5"),
        (math.inf, "not a finite float64 number"),
        (10**30, "a whole number of 31 digits"),
        (10**5000, "a huge whole number"),
        ("x" * 50, 'the text "' + "x" * 37 + '..."'),
        ({"a": 1}, "an object"),
        ([1, 2], "an array of 2 items"),
        (object(), "a object"),
    ],
    ids=lambda value: None if isinstance(value, str) else type(value).__name__,
)
def test_any_value_is_named_shortly(value: object, text: str) -> None:
    assert shown(value) == text


def test_texts_are_always_utf_8() -> None:
    assert quoted("\ud800").encode() == b'"\\ud800"'


def test_what_may_stand_is_listed_and_what_was_meant_is_guessed() -> None:
    assert one_of([]) == "nothing: none is defined"
    assert one_of(["b"]) == '"b"'
    assert one_of(["b", "a"]) == 'one of "a", "b"'
    assert one_of(map(str, range(100, 130))).endswith(" and 6 more")
    assert closest("chrom", ["chrome", "glass"]) == ' (did you mean "chrome"?)'
    assert closest("xyz", ["chrome", "glass"]) == ""


def test_repetitions_are_told_once_and_a_flood_is_cut() -> None:
    fault = Fault("/a", "is 1", "2")
    assert merged([fault], [fault]) == (fault,)
    flood = [Fault(f"/{index}", "is 1", "2") for index in range(2 * MAX_FAULTS)]
    kept = merged(flood)
    assert len(kept) == MAX_FAULTS
    assert kept[-1].message == "has more faults than these"


def test_an_error_tells_all_its_faults_and_travels_between_processes() -> None:
    error = SceneError([Fault("", "is 5", "an object"), Fault("/a", "is 1", "2")])
    assert "(document): is 5; expected an object\n/a: is 1; expected 2" in str(error)
    assert pickle.loads(pickle.dumps(error)).faults == error.faults
