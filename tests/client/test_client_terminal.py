"""What is printed besides results: errors and notes, without anybody's control characters."""

import pytest

from client.errors import Fault, SceneInvalidError
from client.terminal import Terminal, clean


def test_control_characters_never_reach_the_terminal() -> None:
    assert clean("a\x1b[31m\nb\x9b\u202e") == "a\ufffd[31m\ufffdb\ufffd\ufffd"


def test_errors_tell_place_reason_and_expectation(capsys: pytest.CaptureFixture[str]) -> None:
    error = SceneInvalidError("bad", faults=[Fault("/a", "is 5", "below 3"), Fault("", "no object")], hint="mend it")
    Terminal().error(error)
    expected = "error: bad\n  /a: is 5 (expected: below 3)\n  (whole document): no object\nhint: mend it\n"
    assert capsys.readouterr().err == expected


def test_quiet_and_json_have_no_notes(capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (Terminal(quiet=True), Terminal(as_json=True)):
        terminal.note("x")
    assert capsys.readouterr().err == ""
