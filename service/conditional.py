"""Conditional requests, byte ranges and digests: small pure functions over header values.

Job: decide from headers alone; no file is touched here.
Invariant: what cannot be understood is ignored, as HTTP asks, so that an odd header never breaks a download.
Source: RFC 9110 sections 8.8 (validators), 13 (conditional requests), 14 (ranges); RFC 9530 (Repr-Digest).
"""

import base64
import re
from typing import NamedTuple

_ENTITY_TAG = re.compile(r'(?:W/)?"[\x21\x23-\x7e\x80-\xff]*"')
# One range only: a server may ignore a set of ranges, and several parts are asked for by nobody who wants an image.
_SINGLE_RANGE = re.compile(r"bytes=[ \t]*(\d{0,18})-(\d{0,18})[ \t]*", re.ASCII)


class ByteRange(NamedTuple):
    """A slice of a file: the first byte and how many."""

    start: int
    length: int


class RangeError(ValueError):
    """The range lies outside the file: 416."""


def strong_etag(sha256_hex: str) -> str:
    """Return the strong entity tag of content with this hash: the hash in quotes."""
    return f'"{sha256_hex}"'


def repr_digest(sha256_hex: str) -> str:
    """Return the value of ``Repr-Digest`` for content with this hash."""
    return f"sha-256=:{base64.b64encode(bytes.fromhex(sha256_hex)).decode('ascii')}:"


def matches_none(if_none_match: str | None, etag: str) -> bool:
    """Tell whether ``If-None-Match`` names this tag (or ``*``), so that the answer is 304.

    The comparison is weak, as RFC 9110 asks for this header.
    """
    if if_none_match is None:
        return False
    if if_none_match.strip() == "*":
        return True
    return etag in (tag.removeprefix("W/") for tag in _ENTITY_TAG.findall(if_none_match))


def parse_range(range_header: str | None, if_range: str | None, etag: str, size: int) -> ByteRange | None:
    """Read ``Range`` for a file of ``size`` bytes.

    Parameters
    ----------
    range_header, if_range
        The values of ``Range`` and ``If-Range``, or None.
    etag
        The file's strong entity tag; an ``If-Range`` that is not exactly this one asks for the whole file.
    size
        Bytes of the file.

    Returns
    -------
    ByteRange or None
        None: send the whole file.

    Raises
    ------
    RangeError
        The range is well-formed and selects nothing.
    """
    if range_header is None or (if_range is not None and if_range.strip() != etag):
        return None
    match = _SINGLE_RANGE.fullmatch(range_header.strip())
    if match is None or (not match[1] and not match[2]):
        return None
    if not match[1]:  # "-500": the last 500 bytes
        length = min(int(match[2]), size)
        if length == 0:
            raise RangeError
        return ByteRange(size - length, length)
    start = int(match[1])
    if match[2] and int(match[2]) < start:  # "9-3" is no range at all
        return None
    if start >= size:
        raise RangeError
    end = min(int(match[2]), size - 1) if match[2] else size - 1
    return ByteRange(start, end - start + 1)


def parse_wait(prefer_headers: list[str], longest_s: int = 60) -> int | None:
    """Read ``wait`` out of ``Prefer`` headers [RFC 7240].

    Returns
    -------
    int or None
        Seconds from 1 to ``longest_s``; None when there is no usable preference, which is no error.
    """
    for header in prefer_headers:
        for preference in header.split(","):
            name, _, value = preference.partition(";")[0].partition("=")
            if name.strip().lower() == "wait":
                text = value.strip().strip('"')
                if re.fullmatch(r"\d{1,9}", text, re.ASCII) and int(text) > 0:
                    return min(int(text), longest_s)
                return None  # the first one counts [RFC 7240 section 2]
    return None
