"""Server-sent events: bytes of a `text/event-stream` to events.

Invariant: the parsing rules of the WHATWG HTML standard (section 9.2.6): CR, LF or CRLF end a line, `data` lines
are joined by LF, comments (keep-alive) are dropped, an event without data is not dispatched, an id with NUL is ignored.
"""

import codecs
from collections.abc import Iterable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServerEvent:
    """One event: `event` is its name, `data` its text, `id` the last id seen on the stream, if any."""

    event: str = "message"
    data: str = ""
    id: str | None = None
    retry_s: float | None = None


def iter_lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """Split a byte stream into lines at CR, LF or CRLF, also where a chunk ends between the two."""
    decoder = codecs.getincrementaldecoder("utf-8")("replace")
    buffer = ""
    skip_line_feed = False
    for chunk in chunks:
        text = decoder.decode(chunk)
        if skip_line_feed and text:
            text = text.removeprefix("\n")
            skip_line_feed = False
        buffer += text
        while True:
            ends = [index for index in (buffer.find("\n"), buffer.find("\r")) if index >= 0]
            if not ends:
                break
            end = min(ends)
            line, terminator, buffer = buffer[:end], buffer[end], buffer[end + 1 :]
            if terminator == "\r":
                if buffer:
                    buffer = buffer.removeprefix("\n")
                else:
                    skip_line_feed = True
            yield line
    # An unfinished line at the end belongs to an event that was cut off: the standard drops it.


def parse_events(chunks: Iterable[bytes]) -> Iterator[ServerEvent]:
    """Read the events of a stream as they arrive.

    Parameters
    ----------
    chunks : iterable of bytes
        The body, cut anywhere.
    """
    name, last_id, retry_s = "", None, None
    data: list[str] = []
    first = True
    for raw_line in iter_lines(chunks):
        line = raw_line.removeprefix("\ufeff") if first else raw_line
        first = False
        if not line:
            if data:
                yield ServerEvent(event=name or "message", data="\n".join(data), id=last_id, retry_s=retry_s)
            name, data = "", []
            continue
        key, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if key == "event":
            name = value
        elif key == "data":
            data.append(value)
        elif key == "id" and "\0" not in value:
            last_id = value
        elif key == "retry" and value.isdigit():
            retry_s = int(value) / 1000.0
