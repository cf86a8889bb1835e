"""Following a job by events, and without them."""

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from client import watch as watch_module
from client.errors import NotFoundError, NotReachableError, TimedOutError


@pytest.fixture(autouse=True)
def slow_polling(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a state that is seen soon was seen by an event."""
    monkeypatch.setattr(watch_module.watch, "__kwdefaults__", {"timeout_s": None, "poll_s": 20.0, "quiet_s": 20.0})


def events(*steps: Any) -> Callable[[httpx.Request], Iterator[bytes]]:
    waiting = list(steps)

    def stream(_: httpx.Request) -> Iterator[bytes]:
        while waiting:
            step = waiting.pop(0)
            if callable(step):
                step()
            elif isinstance(step, Exception):
                raise step
            else:
                yield step

    return stream


def states(jobs: Iterator[Any]) -> list[str]:
    return [state for state, _ in itertools.groupby(job.state for job in jobs)]


def set_state(fake: Any, state: str) -> Callable[[], None]:
    return lambda: fake.jobs["job1"].update(state=state)


def test_events_tell_changes_at_once(fake: Any) -> None:
    fake.add_job(state="queued")
    fake.events = events(
        set_state(fake, "rendering"),
        b"id: 2\ndata: {}\n\n",
        lambda: time.sleep(0.1),
        set_state(fake, "succeeded"),
        b"id: 3\ndata: {}\n\n",
    )
    started = time.monotonic()
    assert states(fake.client().watch("job1")) == ["queued", "rendering", "succeeded"]
    assert time.monotonic() - started < 5


def test_progress_comes_without_a_question(fake: Any) -> None:
    fake.add_job(state="rendering")
    fake.events = events(
        b'event: progress\ndata: {"state": "rendering", "progress": {"tiles_done": 3, "tiles_total": 4, "rays": 5}}\n\n',
        lambda: time.sleep(0.1),
        b"event: progress\ndata: [nonsense\n\n",
        lambda: time.sleep(0.1),
        set_state(fake, "succeeded"),
        b"id: 3\ndata: {}\n\n",
    )
    jobs = list(fake.client().watch("job1"))
    assert [job.progress.tiles_done for job in jobs] == [1, 3, 1, 1]
    assert jobs[1].progress.fraction == 0.75
    assert fake.count("GET", "/v1/jobs/job1") == 3


def test_silence_is_worth_a_look(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(watch_module.watch.__kwdefaults__, "quiet_s", 0.05)
    fake.add_job(state="rendering")
    fake.events = events(set_state(fake, "succeeded"), lambda: fake.stop.wait(5))
    started = time.monotonic()
    assert states(fake.client().watch("job1"))[-1] == "succeeded"
    assert time.monotonic() - started < 3


def test_a_broken_stream_is_resumed_where_it_was(fake: Any) -> None:
    fake.add_job(state="rendering")
    first = events(b"id: 7\ndata: {}\n\n", httpx.ReadError("broken"))
    second = events(set_state(fake, "succeeded"), b"id: 8\ndata: {}\n\n")
    streams = iter([first, second])
    fake.events = lambda request: next(streams, events())(request)  # noqa: PLW0108 - another one each time
    assert states(fake.client().watch("job1"))[-1] == "succeeded"
    asked = [one.headers.get("Last-Event-ID") for one in fake.requests if one.url.path.endswith("/events")]
    assert asked[:2] == [None, "7"]


def test_polling_is_enough_without_streams(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(watch_module.watch.__kwdefaults__, "poll_s", 0.01)
    fake.add_job(state="rendering")
    threading.Timer(0.2, set_state(fake, "succeeded")).start()
    assert states(fake.client().watch("job1")) == ["rendering", "succeeded"]
    assert fake.count("GET", "/v1/jobs/job1/events") == 1, "a refused stream is not asked for again"


def test_streams_that_bring_nothing_are_given_up(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(watch_module.watch.__kwdefaults__, "poll_s", 0.01)
    fake.add_job(state="rendering")
    fake.events = events()
    threading.Timer(0.5, set_state(fake, "succeeded")).start()
    assert states(fake.client().watch("job1")) == ["rendering", "succeeded"]
    assert fake.count("GET", "/v1/jobs/job1/events") == watch_module.STREAM_FAILURES


def test_a_job_that_has_ended_needs_no_stream(fake: Any) -> None:
    fake.add_job(state="failed")
    assert states(fake.client().watch("job1")) == ["failed"]
    assert len(fake.requests) == 1


def test_time_runs_out(fake: Any) -> None:
    fake.add_job(state="rendering")
    fake.events = events(lambda: fake.stop.wait(5))
    started = time.monotonic()
    with pytest.raises(TimedOutError, match="rendering"):
        fake.client().wait("job1", timeout_s=0.2)
    assert time.monotonic() - started < 3


def test_a_job_that_is_deleted_meanwhile_ends_the_watch(fake: Any) -> None:
    fake.add_job(state="rendering")
    fake.events = events(fake.jobs.clear, b"data: {}\n\n")
    with pytest.raises(NotFoundError):
        list(fake.client().watch("job1"))


def test_a_service_that_stays_away_ends_the_watch(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(watch_module.watch.__kwdefaults__, "poll_s", 0.01)
    fake.add_job(state="rendering")
    jobs = fake.client(retries=1).watch("job1")
    next(jobs)
    fake.next("GET", "/v1/jobs/job1", *[httpx.ConnectError("away")] * 99)
    with pytest.raises(NotReachableError):
        list(jobs)


def test_a_short_absence_is_bridged(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(watch_module.watch.__kwdefaults__, "poll_s", 0.01)
    fake.add_job(state="rendering")
    jobs = fake.client(retries=1).watch("job1")
    next(jobs)
    fake.next("GET", "/v1/jobs/job1", *[httpx.ConnectError("away")] * 6)
    threading.Timer(0.3, set_state(fake, "succeeded")).start()
    assert states(jobs)[-1] == "succeeded"


def test_leaving_a_watch_stops_its_thread(fake: Any) -> None:
    fake.add_job(state="rendering")

    def one_event(_: httpx.Request) -> Iterator[bytes]:
        yield b"data: {}\n\n"
        fake.stop.wait(0.05)

    fake.events = one_event  # the stream ends again and again, and would be resumed for ever
    jobs = fake.client().watch("job1")
    next(jobs), next(jobs)
    jobs.close()
    time.sleep(0.2)
    count = len(fake.requests)
    time.sleep(0.3)
    assert len(fake.requests) == count
