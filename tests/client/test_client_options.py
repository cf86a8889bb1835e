"""Options that several commands share."""

import pytest

from client.errors import UsageError
from client.options import override, parse_size


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
