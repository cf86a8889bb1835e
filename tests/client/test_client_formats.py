"""Numbers for people."""

import pytest

from client.formats import format_bytes, format_count, format_duration, format_percent


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "-"),
        (0, "0.00 s"),
        (0.4249, "0.42 s"),
        (9.99, "9.99 s"),
        (9.996, "10.0 s"),
        (99.94, "99.9 s"),
        (99.96, "1 min 40 s"),
        (3599.6, "1 h 00 min"),
        (7440, "2 h 04 min"),
        (15_768_000, "182.5 days"),
    ],
)
def test_duration(seconds: float | None, text: str) -> None:
    assert format_duration(seconds) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (None, "-"),
        (0, "0"),
        (999, "999"),
        (999.4, "999"),
        (1.5, "1.5"),
        (1000, "1.00 k"),
        (12_345, "12.3 k"),
        (999_600, "1.00 M"),
        (4_560_000, "4.56 M"),
        (123_400_000_000, "123 G"),
    ],
)
def test_count(number: float | None, text: str) -> None:
    assert format_count(number) == text


def test_unit_follows_its_prefix() -> None:
    assert format_count(12_345_678, "rays/s") == "12.3 Mrays/s"
    assert format_count(12, "rays/s") == "12 rays/s"
    assert format_bytes(17_300_000) == "17.3 MB"


def test_percent_never_rounds_something_to_nothing() -> None:
    assert [format_percent(one) for one in (0, 1e-5, 0.123, 1)] == ["0.0 %", "< 0.1 %", "12.3 %", "100.0 %"]
