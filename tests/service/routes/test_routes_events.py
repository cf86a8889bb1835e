"""The event stream: replay, resume, progress, keep-alive, end."""

import threading
import time

import fastapi.routing
import httpx
import pytest
from service_farm import FLOW, Farm, assert_problem, events_of, scene

import service.routes.events
import service.wakeups
from worker.states import JobState


def read(farm: Farm, job_id: str, **headers: str) -> httpx.Response:
    return farm.client.get(f"/v1/jobs/{job_id}/events", headers=headers)


def test_an_ended_job_is_told_from_the_start(farm: Farm) -> None:
    job_id = farm.finished()
    answer = read(farm, job_id)
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].startswith("text/event-stream")
    events = events_of(answer.text)
    assert [event["id"] for event in events] == ["1", "2", "3", "4", "5"]
    assert [event["event"] for event in events] == ["created", "state", "state", "state", "state"]
    assert [event["data"]["state"] for event in events] == ["queued", *FLOW]
    assert events[-1]["data"]["previous"] == "assembling"
    assert "retry: 1000" in answer.text


@pytest.mark.parametrize(("last", "ids"), [("0", "12345"), ("3", "45"), ("x", "12345"), ("-1", "12345"), ("", "12345")])
def test_resume_after_the_last_event_seen(farm: Farm, last: str, ids: str) -> None:
    job_id = farm.finished()
    events = events_of(read(farm, job_id, **{"Last-Event-ID": last}).text)
    assert [event["id"] for event in events] == list(ids)


@pytest.mark.parametrize("last", ["5", "6", "9" * 40])
def test_after_the_terminal_event_there_is_nothing(farm: Farm, last: str) -> None:
    answer = read(farm, farm.finished(), **{"Last-Event-ID": last})
    assert answer.status_code == 204
    assert answer.content == b""


def test_a_running_job_is_followed_to_its_end(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    # Only messages can tell in time: looking by itself would take ten seconds.
    monkeypatch.setattr(service.wakeups, "POLL_S", 10.0)
    monkeypatch.setattr(service.routes.events, "_PROGRESS_S", 10.0)
    job_id = farm.submit()
    seen: list[tuple[float, str]] = []
    moved: dict[str, float] = {}

    def work() -> None:
        for state in (*FLOW[:2], JobState.CANCELING, JobState.CANCELED):
            time.sleep(0.15)
            moved[state] = time.monotonic()
            farm.move(job_id, state)

    worker = threading.Thread(target=work)
    with farm.client.stream("GET", f"/v1/jobs/{job_id}/events") as answer:
        worker.start()
        lines = (line for line in answer.iter_lines() if line.startswith("data: ") and '"seq"' in line)
        seen += [(time.monotonic(), events_of(line + "\n\n")[0]["data"]["state"]) for line in lines]
    worker.join()
    assert [state for _, state in seen] == ["queued", *FLOW[:2], "canceling", "canceled"]
    assert max(at - moved[state] for at, state in seen[1:]) < 5


def test_progress_comes_in_between_without_an_id(farm: Farm) -> None:
    job_id = farm.post(body={"scene": scene(image={"width": 32, "height": 32}), "output": {"tile_size": 16}}).json()[
        "id"
    ]
    farm.move(job_id, *FLOW[:2])
    epoch = farm.context.queue.epoch() or farm.context.queue.set_epoch("test")
    farm.context.queue.init_job(job_id, 4, 2, [0])

    def work() -> None:
        time.sleep(0.8)
        lease = farm.context.queue.lease_next(epoch, job_id, "w", finished=None)
        farm.context.queue.lease_next(epoch, job_id, "w", finished=lease.tile, rays=500)
        time.sleep(0.8)
        farm.move(job_id, JobState.FAILED)

    worker = threading.Thread(target=work)
    worker.start()
    events = events_of(read(farm, job_id, **{"Last-Event-ID": "2"}).text)
    worker.join()
    farm.context.queue.forget_job(job_id)
    progress = [event for event in events if event["event"] == "progress"]
    assert all("id" not in event for event in progress)
    done = [event["data"]["progress"]["tiles_done"] for event in progress]
    assert done[0] == 1
    assert done[-1] == 2
    assert progress[-1]["data"]["progress"]["rays"] == 500
    assert events[-1]["data"]["state"] == "failed"
    assert [event["id"] for event in events if "id" in event] == ["3", "4"]


def test_keep_alive(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fastapi.routing, "_PING_INTERVAL", 0.1)
    job_id = farm.submit()
    farm.later(0.5, farm.move, job_id, JobState.FAILED)
    text = read(farm, job_id).text
    assert text.count(": ping") >= 2
    assert events_of(text)[-1]["data"]["state"] == "failed"


def test_a_job_deleted_under_the_reader_ends_the_stream(farm: Farm) -> None:
    job_id = farm.submit()
    farm.later(0.3, farm.store.delete_job, job_id)
    assert [event["id"] for event in events_of(read(farm, job_id).text)] == ["1"]


def test_head_of_a_stream_does_not_hang(farm: Farm) -> None:
    answer = farm.client.head(f"/v1/jobs/{farm.submit()}/events")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].startswith("text/event-stream")


def test_a_client_that_leaves_frees_its_place(farm: Farm) -> None:
    job_id = farm.submit()
    with farm.client.stream("GET", f"/v1/jobs/{job_id}/events") as answer:
        next(answer.iter_lines())
    deadline = time.monotonic() + 5
    while job_id in farm.context.wakeups._waiters:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_unknown_job(farm: Farm) -> None:
    assert_problem(read(farm, "01jd9zk3v0w8m6x4q2r7t5y1ba"), 404, "job-not-found")
