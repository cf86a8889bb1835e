"""The client against a real service: API, Valkey and workers, with the backend that only pretends to render."""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from client import Client, cli
from client.errors import ConflictError, JobFailedError, NotFoundError, SceneInvalidError
from client.launch import RunningService, service

pytestmark = pytest.mark.farm
FAKE = {"SMALTI_BACKEND": "fake"}


def scene(name: str = "fake", **changes: Any) -> dict[str, Any]:
    camera = {"type": "perspective", "fov_deg": 40}
    return {"version": 1, "name": name, "camera": camera, "image": {"width": 256, "height": 128}, **changes}


@pytest.fixture(scope="module")
def running() -> Iterator[RunningService]:
    with service(workers=2, environment=FAKE) as started:
        yield started


@pytest.fixture
def client(running: RunningService) -> Iterator[Client]:
    with Client(running.url) as connected:
        yield connected


@pytest.fixture
def smalti(running: RunningService, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("SMALTI_URL", running.url)

    def run(*arguments: Any) -> Result:
        return CliRunner().invoke(cli.app, [str(one) for one in arguments], prog_name="smalti")

    return run


def write(path: Path, document: dict[str, Any]) -> Path:
    path.write_text(json.dumps(document))
    return path


def children_of(pid: int, word: str) -> list[int]:
    """Children of a process whose command line holds a word."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue
            if parent == pid and word in command:
                found.append(int(folder.name))
    return found


def test_from_submit_to_files_and_deletion(smalti: Any, tmp_path: Path) -> None:
    path = write(tmp_path / "s.json", scene())
    outputs = [tmp_path / "o.png", tmp_path / "o.exr", tmp_path / "o.json"]
    result = smalti("submit", path, "--name", "first", *[one for target in outputs for one in ("-o", target)])
    assert result.exit_code == 0, result.output
    job_id = result.stdout.strip()
    assert outputs[0].read_bytes().startswith(b"\x89PNG")
    assert json.loads(outputs[2].read_text())["job"] == job_id
    assert "succeeded" in smalti("status", job_id).stdout
    assert job_id in smalti("list").stdout
    assert smalti("get", job_id, "--kind", "preview", "-o", tmp_path / "p.png").exit_code == 0
    assert smalti("watch", job_id).exit_code == 0
    assert smalti("delete", job_id).exit_code == 0
    assert smalti("status", job_id).exit_code == 7


def test_progress_comes_by_events_while_rendering(client: Client) -> None:
    jobs = list(client.watch(client.submit(scene("fake tile_s=0.3")).id))
    done = [job.progress.tiles_done for job in jobs if job.state == "rendering"]
    assert len(set(done)) >= 2, done
    assert done == sorted(done)
    assert jobs[-1].state == "succeeded"


def test_the_end_is_told_at_once(client: Client) -> None:
    job = client.submit(scene("fake tile_s=0.2"))
    client.wait(job.id)
    seen = time.time()
    report = client.report(job.id)
    created = time.mktime(time.strptime(client.status(job.id).created_at[:19], "%Y-%m-%dT%H:%M:%S")) - time.timezone
    assert seen - (created + 1) - report["seconds"]["total"] < 2.0


def test_prefer_wait_answers_with_the_end(client: Client) -> None:
    assert client.submit(scene(), prefer_wait_s=30).state == "succeeded"


def test_cancel_ends_a_watch_with_its_exit_code(smalti: Any, client: Client) -> None:
    job = client.submit(scene("fake tile_s=20"))
    timer = threading.Timer(0.7, client.cancel, [job.id])
    timer.start()
    assert smalti("watch", job.id, "--timeout", 20).exit_code == 5
    timer.join()
    assert smalti("cancel", job.id).stdout == f"{job.id} canceled\n"
    assert smalti("delete", job.id).exit_code == 0


def test_a_job_that_fails_tells_why(smalti: Any, client: Client, tmp_path: Path) -> None:
    result = smalti("submit", write(tmp_path / "s.json", scene("fake fail_prepare=scene")), "--wait")
    assert result.exit_code == 4
    assert "it asked for it" in result.stderr
    with pytest.raises(JobFailedError) as caught:
        client.wait(client.submit(scene("fake fail_prepare=scene")).id)
    assert caught.value.problem is not None
    assert caught.value.problem["type"] == "urn:smalti:problem:scene-invalid"


def test_what_a_running_job_does_not_allow(client: Client, tmp_path: Path) -> None:
    job = client.submit(scene("fake tile_s=20"))
    with pytest.raises(ConflictError):
        client.delete(job.id)
    with pytest.raises(ConflictError):
        client.get(job.id, tmp_path / "a.png")
    client.cancel(job.id)
    client.wait(job.id, check=False, timeout_s=20)
    with pytest.raises(ConflictError):
        client.get(job.id, tmp_path / "a.png")
    client.delete(job.id)
    with pytest.raises(NotFoundError):
        client.status(job.id)


def test_a_bad_scene_is_told_by_pointer(smalti: Any, client: Client, tmp_path: Path) -> None:
    bad = scene(camera={"type": "perspective", "fov_deg": 400})
    result = smalti("submit", write(tmp_path / "s.json", bad))
    assert result.exit_code == 3
    assert "/scene/camera/fov_deg" in result.stderr
    with pytest.raises(SceneInvalidError):
        client.validate(bad)
    assert smalti("submit", write(tmp_path / "s.json", scene()), "--tile-size", 16, "--name", "x" * 300).exit_code == 2


def test_validate_estimates(client: Client) -> None:
    assert client.validate(scene())["tiles"] == 8


def test_schema_is_the_same_here_and_there(smalti: Any, running: RunningService) -> None:
    assert json.loads(smalti("schema").stdout) == json.loads(smalti("schema", "--url", running.url).stdout)


def test_files_are_uploaded_once_and_by_hash(client: Client, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/m.obj").write_text(f"# {tmp_path}\nmtllib my lib.mtl\n")
    (tmp_path / "sub/my lib.mtl").write_text("map_Kd gone.png\n")
    document = scene(assets={"m": {"file": "sub/m.obj"}}, objects=[{"type": "mesh_asset", "asset": "m"}])
    job = client.submit(write(tmp_path / "s.json", document))
    assert client.wait(job.id).state == "succeeded"
    accepted = client.scene(job.id)["assets"]["m"]
    assert accepted["file"] == "m.obj"
    assert set(accepted["companions"]) == {"my lib.mtl"}
    assert client.missing_assets([accepted["sha256"], "0" * 64]) == ("0" * 64,)


def test_the_same_key_gives_the_same_job(client: Client) -> None:
    first = client.submit(scene(), idempotency_key="test-key")
    assert client.submit(scene(), idempotency_key="test-key").id == first.id
    with pytest.raises(ConflictError):
        client.submit(scene("fake other"), idempotency_key="test-key")


def test_pages_of_the_list(client: Client) -> None:
    made = [client.submit(scene(), prefer_wait_s=30).id for _ in range(3)]
    page = client.list(limit=2)
    assert [job.id for job in page.jobs] == made[:0:-1]
    assert client.list(limit=2, cursor=page.next_cursor).jobs[0].id == made[0]
    assert {job.state for job in client.list(state="succeeded", limit=5).jobs} == {"succeeded"}


def test_doctor_sees_the_service(smalti: Any) -> None:
    found = json.loads(smalti("doctor", "--json").stdout)
    assert [one["level"] for one in found if one["what"] == "service"] == ["ok"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_a_killed_api_is_no_reason_to_stop(running: RunningService, client: Client) -> None:
    job = client.submit(scene("fake tile_s=0.6"))
    jobs = client.watch(job.id)
    seen = [next(jobs), next(jobs)]
    (api,) = children_of(running.pid, "uvicorn")
    os.kill(api, signal.SIGKILL)
    assert client.submit(scene("fake after")).state in {"queued", "preparing", "rendering", "assembling", "succeeded"}
    seen += list(jobs)
    assert seen[-1].state == "succeeded"


# Start and end
