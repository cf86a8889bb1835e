"""Submitting, looking at, listing, canceling and deleting jobs over HTTP."""

import threading
import time
from types import SimpleNamespace

import pytest
from service_farm import FLOW, Farm, assert_problem, scene

import service.wakeups
from service.routes import jobs
from worker.states import JobState


def test_a_job_is_accepted_after_it_is_on_disk(farm: Farm) -> None:
    answer = farm.post(body={"scene": scene(), "name": "first", "priority": 80, "output": {"tile_size": 16}})
    assert answer.status_code == 202
    view = answer.json()
    assert answer.headers["Location"] == f"/v1/jobs/{view['id']}"
    assert view["state"] == "queued"
    assert view["name"] == "first"
    assert view["image"] == {"width": 64, "height": 48}
    assert view["samples"] == 16
    assert view["progress"] == {
        "tiles_done": 0, "tiles_total": 12, "fraction": 0.0, "rays": 0, "rays_per_s": None, "eta_s": None,
    }  # fmt: skip
    assert view["problem"] is None
    assert view["links"]["result_png"] is None
    record = farm.store.read_job(view["id"])
    assert (record.priority, record.n_tiles, record.name) == (80, 12, "first")
    assert farm.store.last_event(view["id"]).seq == 1


def test_the_scene_gives_the_name_when_the_request_does_not(farm: Farm) -> None:
    assert farm.post(scene(name="of the scene")).json()["name"] == "of the scene"


def test_the_job_is_put_into_the_queue(farm: Farm) -> None:
    before = sum(farm.context.queue.queue_lengths().values())
    farm.submit()
    assert sum(farm.context.queue.queue_lengths().values()) == before + 1


def test_etag_of_a_job_changes_with_its_state_only(farm: Farm) -> None:
    job_id = farm.submit()
    first = farm.client.get(f"/v1/jobs/{job_id}")
    etag = first.headers["ETag"]
    assert etag.startswith('"')
    again = farm.client.get(f"/v1/jobs/{job_id}", headers={"If-None-Match": etag})
    assert again.status_code == 304
    assert again.content == b""
    assert again.headers["ETag"] == etag
    farm.move(job_id, JobState.PREPARING)
    changed = farm.client.get(f"/v1/jobs/{job_id}", headers={"If-None-Match": etag})
    assert changed.status_code == 200
    assert changed.json()["state"] == "preparing"
    assert changed.headers["ETag"] != etag


def test_a_failed_job_tells_its_problem(farm: Farm) -> None:
    job_id = farm.submit()
    problem = {"type": "urn:smalti:problem:asset-invalid", "title": "A file cannot be read", "file": "car.obj"}
    farm.move(job_id, JobState.FAILED, detail=problem)
    view = farm.client.get(f"/v1/jobs/{job_id}").json()
    assert view["state"] == "failed"
    assert view["problem"] == {**problem, "detail": None}
    assert view["links"]["cancel"] is None


@pytest.mark.parametrize("job_id", ["01jd9zk3v0w8m6x4q2r7t5y1ba", "x", "..", "%2e%2e%2fjobs", "a" * 5000, "%00", "ä"])
@pytest.mark.parametrize("rest", ["", "/events", "/scene", "/report", "/result.png"])
def test_unknown_ids_are_not_found(farm: Farm, job_id: str, rest: str) -> None:
    if job_id == "..":  # the client resolves it; the next one is the same, hidden
        return
    answer = farm.client.get(f"/v1/jobs/{job_id}{rest}")
    assert answer.status_code == 404
    assert answer.headers["Content-Type"] == "application/problem+json"


# ---- Prefer: wait ----------------------------------------------------------------------------------------------------


def test_prefer_wait_answers_200_as_soon_as_the_job_has_ended(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service.wakeups, "POLL_S", 10.0)  # only the message can tell in time

    def work() -> None:
        while True:
            for job_id in farm.store.job_ids():
                if farm.store.read_job(job_id).name == "waited":
                    time.sleep(0.2)
                    farm.finish(job_id)
                    return
            time.sleep(0.01)

    worker = threading.Thread(target=work)
    worker.start()
    start = time.monotonic()
    answer = farm.post(scene(name="waited"), headers={"Prefer": "respond-async, wait=20"})
    took_s = time.monotonic() - start
    worker.join()
    assert answer.status_code == 200
    assert answer.headers["Preference-Applied"] == "wait=20"
    assert answer.json()["state"] == "succeeded"
    assert answer.json()["links"]["result_png"].endswith("/result.png")
    assert took_s < 5


def test_prefer_wait_ends_with_202_when_the_time_is_over(farm: Farm) -> None:
    start = time.monotonic()
    answer = farm.post(headers={"Prefer": "wait=1"})
    assert answer.status_code == 202
    assert answer.headers["Preference-Applied"] == "wait=1"
    assert 0.9 < time.monotonic() - start < 5
    assert answer.json()["state"] == "queued"


@pytest.mark.parametrize("prefer", ["wait=x", "wait=0", "wait=-1", "wait", "return=minimal"])
def test_useless_preferences_are_ignored(farm: Farm, prefer: str) -> None:
    answer = farm.post(headers={"Prefer": prefer})
    assert answer.status_code == 202
    assert "Preference-Applied" not in answer.headers


# ---- list ------------------------------------------------------------------------------------------------------------


def test_list_is_newest_first_in_pages(farm: Farm) -> None:
    ids = [farm.submit() for _ in range(5)][::-1]
    first = farm.client.get("/v1/jobs", params={"limit": 3}).json()
    assert [job["id"] for job in first["jobs"]] == ids[:3]
    second = farm.client.get("/v1/jobs", params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [job["id"] for job in second["jobs"]] == ids[3:]


def test_list_ends_without_a_cursor_and_filters_by_state(farm: Farm) -> None:
    job_id = farm.submit()
    farm.move(job_id, JobState.FAILED)
    found, cursor = [], None
    while True:
        params = {"state": "failed", "limit": 1} | ({"cursor": cursor} if cursor else {})
        page = farm.client.get("/v1/jobs", params=params).json()
        found += page["jobs"]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert job_id in [job["id"] for job in found]
    assert {job["state"] for job in found} == {"failed"}


def test_list_has_an_etag(farm: Farm) -> None:
    first = farm.client.get("/v1/jobs")
    assert farm.client.get("/v1/jobs", headers={"If-None-Match": first.headers["ETag"]}).status_code == 304


def test_a_damaged_job_does_not_hide_the_others(farm: Farm) -> None:
    good, bad = farm.submit(), farm.submit()
    path = farm.store.job_dir(bad) / "job.json"
    content = path.read_bytes()
    path.write_bytes(b"{")
    ids = [job["id"] for job in farm.client.get("/v1/jobs").json()["jobs"]]
    assert good in ids
    assert bad not in ids
    assert_problem(farm.client.get(f"/v1/jobs/{bad}"), 500, "record-damaged")
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("limit=0", "a whole number >= 1 and <= 200"),
        ("limit=201", "a whole number >= 1 and <= 200"),
        ("limit=x", "a whole number >= 1 and <= 200"),
        ("state=lost", 'one of "queued", "preparing"'),
        ("cursor=zzz", "text like ^[0-7]"),
        ("cursor=" + "x" * 65, "text like ^[0-7]"),
    ],
)
def test_bad_parameters_are_named(farm: Farm, query: str, expected: str) -> None:
    body = assert_problem(farm.client.get(f"/v1/jobs?{query}"), 422, "parameters-invalid")
    name, _, value = query.partition("=")
    (fault,) = body["errors"]
    assert fault["pointer"] == f"/query/{name}"
    assert value[:9] in fault["detail"]
    assert fault["expected"].startswith(expected)


# ---- cancel, delete --------------------------------------------------------------------------------------------------


def test_cancel_of_a_queued_job_ends_it(farm: Farm) -> None:
    job_id = farm.submit()
    answer = farm.client.post(f"/v1/jobs/{job_id}/cancel")
    assert answer.status_code == 202
    assert answer.json()["state"] in {"canceling", "canceled"}
    assert farm.store.last_event(job_id).state is JobState.CANCELED


@pytest.mark.parametrize("end", [JobState.SUCCEEDED, JobState.FAILED])
def test_cancel_of_an_ended_job_is_refused(farm: Farm, end: JobState) -> None:
    job_id = farm.submit()
    if end is JobState.SUCCEEDED:
        farm.move(job_id, *FLOW)
    else:
        farm.move(job_id, end)
    body = assert_problem(farm.client.post(f"/v1/jobs/{job_id}/cancel"), 409, "illegal-transition")
    assert body["current_state"] == end
    assert body["allowed"] == []


def test_cancel_again_is_the_same(farm: Farm) -> None:
    job_id = farm.submit()
    farm.move(job_id, JobState.CANCELING)
    assert farm.client.post(f"/v1/jobs/{job_id}/cancel").status_code == 202
    events = farm.store.events(job_id)
    again = farm.client.post(f"/v1/jobs/{job_id}/cancel")
    assert (again.status_code, again.json()["state"]) == (202, "canceled")
    assert again.json()["id"] == job_id
    assert farm.store.events(job_id) == events


def test_delete_waits_for_the_end(farm: Farm) -> None:
    job_id = farm.submit()
    body = assert_problem(farm.client.delete(f"/v1/jobs/{job_id}"), 409, "job-running")
    assert body["current_state"] == "queued"
    farm.finish(job_id)
    answer = farm.client.delete(f"/v1/jobs/{job_id}")
    assert answer.status_code == 204
    assert answer.content == b""
    assert_problem(farm.client.get(f"/v1/jobs/{job_id}"), 404, "job-not-found")
    assert_problem(farm.client.delete(f"/v1/jobs/{job_id}"), 404, "job-not-found")


def test_a_job_that_would_fill_the_store_is_refused(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs.shutil, "disk_usage", lambda _root: SimpleNamespace(free=100 * 10**9))
    before = list(farm.store.job_ids())
    body = assert_problem(
        farm.post(scene(image={"width": 65536, "height": 65536}, sampling={"samples": 1})), 507, "store-full"
    )
    assert body["needed_bytes"] == 65536 * 65536 * 27 + (64 << 20)
    assert str(65536 * 65536 * 27) in body["detail"]
    assert list(farm.store.job_ids()) == before


def test_a_job_must_leave_some_room(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    need = 64 * 48 * 27 + (64 << 20)
    for free, status in ((need, 202), (need - 1, 507)):
        monkeypatch.setattr(jobs.shutil, "disk_usage", lambda _root, free=free: SimpleNamespace(free=free))
        assert farm.post().status_code == status


# ---- estimate --------------------------------------------------------------------------------------------------------


def test_validate_only_estimates_and_makes_no_job(farm: Farm) -> None:
    before = list(farm.store.job_ids())
    sha256 = "ab" * 32
    document = scene(
        integrator={"max_depth": 2},
        lights=[{"type": "point", "position": [0, 1, 0]}],
        materials={"m": {"kr": 0.5}},
        objects=[{"type": "mesh_asset", "asset": "car"}, {"type": "sphere", "center": [0, 0, 0], "radius": 1}],
        assets={"car": {"file": "car.obj", "sha256": sha256}, "idle": {"file": "b.png", "sha256": sha256}},
    )
    body = {"scene": document, "output": {"tile_size": 32}}
    answer = farm.client.post("/v1/jobs", params={"validate_only": "true"}, json=body)
    assert answer.status_code == 200
    estimate = answer.json()
    assert estimate["tiles"] == 4
    assert estimate["samples_total"] == 64 * 48 * 16
    # one path: the primary point and two mirrored ones, a ray to each and one from each to the light
    assert estimate["rays_at_most"] == 64 * 48 * 16 * 3 * 2
    assert estimate["assets_missing"] == ["car"]
    assert estimate["assets_never_loaded"] == ["idle"]
    assert {"reflection", "light:point", "object:sphere", "object:mesh_asset"} <= set(estimate["features"])
    assert "transmission" in estimate["skipped"]
    assert estimate["memory_bytes"] > 0
    assert estimate["store_bytes"] == 64 * 48 * (12 + 15)  # tiles of three float32, an EXR and a PNG
    assert list(farm.store.job_ids()) == before
