"""The verbs of the Python client."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from client import Client, SmaltiError
from client.assets import prepare_scene, sha256_file
from client.errors import AssetError, ConflictError, Fault, JobCanceledError, JobFailedError, NotFoundError, UsageError

SCENE = {"version": 1, "camera": {"type": "perspective", "fov_deg": 40}, "image": {"width": 4, "height": 3}}


def body_of(fake: Any) -> dict[str, Any]:
    posts = [one for one in fake.requests if (one.method, one.url.path) == ("POST", "/v1/jobs")]
    return dict(json.loads(posts[-1].content))


def test_submit_sends_the_scene_and_only_the_options_given(fake: Any) -> None:
    job = fake.client().submit(SCENE)
    assert (job.id, job.state) == ("job1", "queued")
    assert body_of(fake) == {"scene": SCENE}
    fake.client().submit(SCENE, output={"tile_size": 32}, priority=0, name="a")
    assert body_of(fake) == {"scene": SCENE, "output": {"tile_size": 32}, "priority": 0, "name": "a"}


def test_a_post_whose_answer_was_lost_makes_one_job(fake: Any) -> None:
    def accept_and_break(request: httpx.Request) -> Exception:
        fake.post_job(request)
        return httpx.ReadError("connection reset")

    fake.next("POST", "/v1/jobs", accept_and_break)
    assert fake.client().submit(SCENE).id == "job1"
    assert len(fake.jobs) == 1
    keys = {one.headers["Idempotency-Key"] for one in fake.requests if one.url.path == "/v1/jobs"}
    assert len(keys) == 1


def test_two_submits_have_two_keys_unless_one_is_given(fake: Any) -> None:
    client = fake.client()
    assert client.submit(SCENE).id != client.submit(SCENE).id
    assert client.submit(SCENE, idempotency_key="k").id == client.submit(SCENE, idempotency_key="k").id


def test_a_key_in_flight_is_tried_again(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.next("POST", "/v1/jobs", make_problem(409, "idempotency-in-flight", retry_after=1))
    assert fake.client().submit(SCENE).id == "job1"
    assert fake.sleeps == [1.0]


def test_a_key_used_for_another_scene_is_a_conflict(fake: Any, make_problem: Callable[..., httpx.Response]) -> None:
    fake.next("POST", "/v1/jobs", make_problem(422, "idempotency-mismatch"))
    with pytest.raises(ConflictError):
        fake.client().submit(SCENE, idempotency_key="k")


@pytest.mark.parametrize(("asked", "sent"), [(1, "wait=1"), (0, "wait=1"), (600, "wait=60")])
def test_prefer_wait_is_kept_in_the_limits(fake: Any, asked: int, sent: str) -> None:
    fake.client().submit(SCENE, prefer_wait_s=asked)
    assert fake.requests[-1].headers["Prefer"] == sent


def test_only_missing_files_are_uploaded(fake: Any, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"a" * 3_000_000)
    (tmp_path / "b.ply").write_bytes(b"b")
    fake.assets[sha256_file(tmp_path / "b.ply")] = b"b"
    (tmp_path / "s.json").write_text(json.dumps({**SCENE, "assets": {"a": {"file": "a.ply"}, "b": {"file": "b.ply"}}}))
    fake.client().submit(tmp_path / "s.json")
    assert [one.method for one in fake.requests] == ["POST", "PUT", "POST"]
    assert fake.assets[sha256_file(tmp_path / "a.ply")] == b"a" * 3_000_000
    assert body_of(fake)["scene"]["assets"]["a"] == {"file": "a.ply", "sha256": sha256_file(tmp_path / "a.ply")}


def test_an_upload_that_broke_is_sent_again_whole(fake: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(b"abc")
    fake.next("PUT", f"/v1/assets/{sha256_file(path)}", httpx.WriteError("broken"), httpx.Response(503))
    assert fake.client().put_asset(path, sha256_file(path)) is True
    assert fake.client().put_asset(path, sha256_file(path)) is False
    assert list(fake.assets.values()) == [b"abc"]


def test_assets_that_vanished_meanwhile_are_uploaded_again(
    fake: Any, tmp_path: Path, make_problem: Callable[..., httpx.Response]
) -> None:
    (tmp_path / "a.ply").write_bytes(b"abc")
    fake.next("POST", "/v1/jobs", lambda _: fake.assets.clear() or make_problem(409, "assets-missing"))
    fake.client().submit(prepare_scene({**SCENE, "assets": {"a": {"file": "a.ply"}}}, tmp_path))
    assert list(fake.assets.values()) == [b"abc"]


def test_a_file_known_by_its_hash_alone_may_be_at_the_service(fake: Any, tmp_path: Path) -> None:
    prepared = prepare_scene({**SCENE, "assets": {"a": {"file": "gone.ply", "sha256": "a" * 64}}}, tmp_path)
    with pytest.raises(AssetError, match="neither here nor at the service"):
        fake.client().submit(prepared)
    fake.assets["a" * 64] = b""
    assert fake.client().submit(prepared).id == "job1"


def test_validate_returns_the_estimate_and_makes_no_job(fake: Any) -> None:
    assert fake.client().validate(SCENE)["tiles"] == 1
    assert fake.jobs == {}


def test_list_pages_newest_first(fake: Any) -> None:
    for number in range(5):
        fake.add_job(f"job{number}", "failed" if number == 2 else "succeeded")
    page = fake.client().list(limit=2)
    assert [job.id for job in page.jobs] == ["job4", "job3"]
    page = fake.client().list(limit=2, cursor=page.next_cursor)
    assert [job.id for job in page.jobs] == ["job2", "job1"]
    assert [job.id for job in fake.client().list(state="failed").jobs] == ["job2"]


def test_cancel_delete_scene_schema_report_ready(fake: Any) -> None:
    client = fake.client()
    fake.add_job("job1", "rendering")
    with pytest.raises(ConflictError):
        client.delete("job1")
    assert client.cancel("job1").state == "canceling"
    fake.jobs["job1"]["state"] = "canceled"
    client.delete("job1")
    with pytest.raises(NotFoundError):
        client.status("job1")
    fake.add_job("job2")
    assert client.scene("job2") == SCENE
    assert client.report("job2") == {"tiles": 4}
    assert client.schema() == {"title": "scene"}
    assert client.ready()
    assert client.readiness() == {"store": "ok", "queue": "ok"}


def test_a_delete_whose_answer_was_lost_is_done(fake: Any) -> None:
    fake.add_job()

    def delete_and_break(_: httpx.Request) -> Exception:
        fake.jobs.clear()
        return httpx.ReadError("broken")

    fake.next("DELETE", "/v1/jobs/job1", delete_and_break)
    fake.client().delete("job1")
    with pytest.raises(NotFoundError):
        fake.client().delete("job1")


def test_not_ready_is_false_at_once(fake: Any) -> None:
    fake.next("GET", "/readyz", httpx.Response(503), httpx.ConnectError("refused"))
    assert not fake.client().ready()
    assert not fake.client().ready()
    assert fake.sleeps == []


def test_ids_never_change_the_path(fake: Any) -> None:
    with pytest.raises(NotFoundError):
        fake.client().status("../../healthz?x=#y")
    assert fake.requests[-1].url.raw_path == b"/v1/jobs/..%2F..%2Fhealthz%3Fx%3D%23y"


def test_wait_raises_what_the_job_ended_with(fake: Any) -> None:
    fake.add_job("ok", "succeeded")
    fault = {"pointer": "/scene/objects/0/asset", "detail": "mesh.obj: bad", "expected": "export it again"}
    problem = {"type": "x", "title": "Bad mesh", "detail": "mesh.obj: face index out of range", "errors": [fault]}
    fake.add_job("bad", "failed", problem=problem)
    fake.add_job("off", "canceled")
    client = fake.client()
    assert client.wait("ok").state == "succeeded"
    with pytest.raises(JobFailedError, match=r"mesh\.obj: face index") as caught:
        client.wait("bad")
    assert caught.value.problem is not None
    assert caught.value.problem["title"] == "Bad mesh"
    assert caught.value.faults == (Fault("/scene/objects/0/asset", "mesh.obj: bad", "export it again"),)
    with pytest.raises(JobCanceledError):
        client.wait("off")
    assert client.wait("off", check=False).state == "canceled"


@pytest.mark.parametrize("kind", ["result.png", "../x", ""])
def test_unknown_kinds_are_wrong_usage(fake: Any, tmp_path: Path, kind: str) -> None:
    with pytest.raises(UsageError):
        fake.client().get("job1", tmp_path / "x.tiff", kind=kind or None)


def test_the_address_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Client().url == "http://127.0.0.1:8000"
    monkeypatch.setenv("SMALTI_URL", "http://127.0.0.1:77/")
    assert Client().url == "http://127.0.0.1:77"


def test_the_package_names_its_errors() -> None:
    assert issubclass(NotFoundError, SmaltiError)
