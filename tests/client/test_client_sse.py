"""Parsing of event streams, by the rules of the WHATWG HTML standard."""

from hypothesis import given
from hypothesis import strategies as st

from client.sse import ServerEvent, iter_lines, parse_events


def read(text: str) -> list[ServerEvent]:
    return list(parse_events([text.encode()]))


def test_event_has_name_data_and_id() -> None:
    assert read("id: 7\nevent: state\ndata: {}\n\n") == [ServerEvent("state", "{}", "7")]


def test_data_lines_are_joined_and_one_space_is_dropped() -> None:
    assert read("data: a\ndata:  b\ndata\n\n")[0].data == "a\n b\n"


def test_comments_keep_alive_and_empty_events_are_dropped() -> None:
    assert read(": ping\n\nevent: x\n\ndata: 1\n\n") == [ServerEvent("message", "1")]


def test_id_stays_for_later_events_and_may_not_hold_nul() -> None:
    assert [one.id for one in read("id: 1\ndata: a\n\ndata: b\n\nid: \0\ndata: c\n\nid\ndata: d\n\n")] == [
        "1",
        "1",
        "1",
        "",
    ]


def test_retry_is_in_milliseconds() -> None:
    assert read("retry: 1500\ndata: a\n\n")[0].retry_s == 1.5
    assert read("retry: soon\ndata: a\n\n")[0].retry_s is None


def test_unfinished_event_is_dropped() -> None:
    assert read("data: a\n\ndata: b") == [ServerEvent("message", "a")]
    assert read("data: b\n") == []


def test_byte_order_mark_is_skipped() -> None:
    assert read("\ufeffdata: a\n\n")[0].data == "a"


@given(st.sampled_from(["\n", "\r", "\r\n"]), st.integers(1, 7))
def test_cuts_and_line_ends_do_not_matter(line_end: str, size: int) -> None:
    text = f"id: 1{line_end}data: grün ☃{line_end}data: b{line_end}{line_end}data: c{line_end}{line_end}".encode()
    chunks = [text[start : start + size] for start in range(0, len(text), size)]
    assert [one.data for one in parse_events(chunks)] == ["grün ☃\nb", "c"]


@given(st.text(alphabet="a\r\n", max_size=12), st.integers(1, 3))
def test_lines_are_those_of_the_whole_text(text: str, size: int) -> None:
    chunks = [text[start : start + size].encode() for start in range(0, len(text), size)]
    whole = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[:-1]
    assert list(iter_lines(chunks)) == whole
