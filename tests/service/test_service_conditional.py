"""Ranges, validators and preferences: pure functions."""

import pytest

from service.conditional import ByteRange, RangeError, matches_none, parse_range, parse_wait, repr_digest


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("bytes=0-0", ByteRange(0, 1)),
        ("bytes=10-19", ByteRange(10, 10)),
        ("bytes=90-", ByteRange(90, 10)),
        ("bytes=90-1000", ByteRange(90, 10)),
        ("bytes=-5", ByteRange(95, 5)),
        ("bytes=-500", ByteRange(0, 100)),
        ("bytes= 1-2 ", ByteRange(1, 2)),
        (None, None),
        ("bytes=", None),
        ("bytes=-", None),
        ("bytes=5-3", None),
        ("bytes=a-b", None),
        ("bytes=0-1,5-6", None),
        ("lines=0-1", None),
        ("bytes=٣-٤", None),
    ],
)
def test_ranges(header: str | None, expected: ByteRange | None) -> None:
    assert parse_range(header, None, '"e"', 100) == expected


@pytest.mark.parametrize("header", ["bytes=100-", "bytes=100-200", "bytes=-0", "bytes=999999999999999999-"])
def test_ranges_outside_the_file(header: str) -> None:
    with pytest.raises(RangeError):
        parse_range(header, None, '"e"', 100)


def test_every_range_of_an_empty_file_is_outside() -> None:
    with pytest.raises(RangeError):
        parse_range("bytes=0-", None, '"e"', 0)
    with pytest.raises(RangeError):
        parse_range("bytes=-0", None, '"e"', 0)


@pytest.mark.parametrize(
    ("if_range", "used"), [('"e"', True), ('"f"', False), ('W/"e"', False), ("Sat, 01 Jan", False)]
)
def test_if_range(if_range: str, used: bool) -> None:
    assert (parse_range("bytes=0-0", if_range, '"e"', 100) is not None) is used


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (None, False),
        ("*", True),
        ('"e"', True),
        ('W/"e"', True),
        ('"a", "e"', True),
        ('"a"', False),
        ("e", False),
        ("", False),
    ],
)
def test_if_none_match(header: str | None, expected: bool) -> None:
    assert matches_none(header, '"e"') is expected


def test_repr_digest_of_nothing() -> None:
    # RFC 9530 writes the SHA-256 of empty content so.
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert repr_digest(empty) == "sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        (["wait=10"], 10),
        (["WAIT=10"], 10),
        (['wait="7"'], 7),
        (["respond-async, wait=5; foo=bar"], 5),
        (["respond-async", "wait=5"], 5),
        (["wait=1000"], 60),
        (["wait=2, wait=9"], 2),
        (["wait=0"], None),
        (["wait=٣"], None),
        (["waiting=3"], None),
        ([], None),
    ],
)
def test_wait(headers: list[str], expected: int | None) -> None:
    assert parse_wait(headers) == expected
