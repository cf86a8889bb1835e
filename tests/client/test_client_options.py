"""Options that several commands share."""

from pathlib import Path

import pytest

from client.errors import UsageError
from client.options import check_targets, override, parse_size


def test_targets_must_be_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.png").mkdir()
    check_targets([Path("new.png"), tmp_path / "new.exr"])
    with pytest.raises(UsageError, match="there is no folder none") as caught:
        check_targets([Path("new.png"), Path("none/x.png")])
    assert caught.value.hint == "make it first: mkdir -p none"
    with pytest.raises(UsageError, match="it is a folder"):
        check_targets([Path("a.png")])
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(UsageError, match="cannot be written to"):
        check_targets([Path("new.png")])


def test_sizes() -> None:
    assert parse_size("640x360") == parse_size(" 640 X 360 ") == (640, 360)
    for text in ("640", "640x", "x", "-1x5", "1e3x5", "0x1", "640x360x3", "1234567x1"):
        with pytest.raises(UsageError):
            parse_size(text)


def test_overrides_leave_the_document_as_it_is() -> None:
    document = {"image": {"width": 1, "height": 2}, "sampling": {"seed": 3}}
    assert override(document, samples=4, size="5x6") == {
        "image": {"width": 5, "height": 6},
        "sampling": {"seed": 3, "samples": 4},
    }
    assert document == {"image": {"width": 1, "height": 2}, "sampling": {"seed": 3}}
    assert override({"image": 5}, samples=1, size="5x6") == {
        "image": {"width": 5, "height": 6},
        "sampling": {"samples": 1},
    }
