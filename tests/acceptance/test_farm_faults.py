"""Whatever is killed or wiped, at any moment: the job ends as it would have, with the same picture.

Each test renders the same scene and compares its hash with an undisturbed render; each ends with the audit.
"""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from farm_processes import RealFarm, running_farm

from worker import jobs
from worker.contract import DRAIN_S
from worker.states import JobState

pytestmark = [pytest.mark.farm, pytest.mark.xdist_group("farm")]

# 48 tiles of 40 ms on two workers: about a second, long enough to be hit in the middle.
SLOW = "fake tile_s=0.04"
N_TILES = 48


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealFarm]:
    with running_farm(tmp_path_factory.mktemp("farm")) as one:
        yield one


@pytest.fixture(scope="module")
def undisturbed(farm: RealFarm) -> str:
    """Hash of the picture without faults."""
    return film_of(farm, farm.submit("fake"))


@pytest.fixture(autouse=True)
def end_with_an_audit(farm: RealFarm, undisturbed: str) -> Iterator[None]:
    yield
    farm.assert_sound()


def film_of(farm: RealFarm, job_id: str) -> str:
    event = farm.wait(job_id)
    assert event.state is JobState.SUCCEEDED, farm.history(job_id)
    return str(event.detail["film_sha256"])


def leased_to(farm: RealFarm, name: str) -> tuple[str, int | None] | None:
    lease_name = farm.supervisor.children[name].lease_name
    return farm.queue.leases().get(lease_name)


def parent_of(stat: Path) -> int:
    """Return the parent of a process from its /proc/PID/stat; 0 if it is gone."""
    try:
        return int(stat.read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def test_worker_is_killed_in_mid_tile(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 5)
    lease = farm.until(lambda: leased_to(farm, "worker-0"))
    killed_at = time.monotonic()
    farm.kill("worker-0")

    def is_elsewhere() -> bool:
        others = [held for name, held in farm.queue.leases().items() if name.endswith("worker-1.1")]
        return lease in others or lease[1] in farm.store.done_tiles(job_id)

    farm.until(lambda: is_elsewhere() or farm.store.last_event(job_id).state is JobState.SUCCEEDED)
    seconds = time.monotonic() - killed_at
    assert seconds < 5.0
    assert film_of(farm, job_id) == undisturbed
    print(f"tile restarted after {seconds:.3f} s")


def test_silent_worker_loses_its_lease_and_does_no_harm(farm: RealFarm, undisturbed: str):
    """Stopped beyond its lease, then awake again: its tile was rendered elsewhere, its late commit is harmless."""
    job_id = farm.submit("fake tile_s=0.12")
    farm.until_done(job_id, 4)
    farm.until(lambda: leased_to(farm, "worker-1"))
    stopped_at = time.monotonic()
    pid = farm.kill("worker-1", signal.SIGSTOP)
    try:
        lost = farm.until(lambda: [e for e in farm.store.events(job_id) if e.type == "tile_lost"], 10.0)
        assert time.monotonic() - stopped_at < 5.0
    finally:
        os.kill(pid, signal.SIGCONT)
    assert film_of(farm, job_id) == undisturbed
    assert lost[0].detail["losses"] == 1


def test_tile_that_kills_its_worker_once(farm: RealFarm, undisturbed: str, tmp_path):
    job_id = farm.submit(f"{SLOW} crash_block=6,6 crash_once={tmp_path / 'flag'}")
    assert film_of(farm, job_id) == undisturbed
    assert [e.type for e in farm.store.events(job_id)].count("tile_lost") == 1


def test_flushall_in_mid_render(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 8)
    farm.queue.redis.flushall()
    assert film_of(farm, job_id) == undisturbed


def test_flushall_again_and_again(farm: RealFarm, undisturbed: str):
    job_id = farm.submit("fake tile_s=0.08")
    for n_tiles in (0, 6, 18, 30):
        farm.until_done(job_id, n_tiles)
        farm.queue.redis.flushall()
    assert film_of(farm, job_id) == undisturbed


def test_assembler_is_killed(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 20)
    farm.kill("assembler")
    assert film_of(farm, job_id) == undisturbed


def test_assembler_is_killed_with_all_tiles_there(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 8)
    farm.kill("assembler", signal.SIGSTOP)
    farm.until_done(job_id, N_TILES)
    killed_at = time.monotonic()
    farm.kill("assembler")
    assert film_of(farm, job_id) == undisturbed
    assert time.monotonic() - killed_at < 5.0


def test_steward_is_killed_and_then_the_index_wiped(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 8)
    farm.kill("steward")
    farm.queue.redis.flushall()
    assert film_of(farm, job_id) == undisturbed


def test_valkey_is_killed(farm: RealFarm, undisturbed: str):
    job_id = farm.submit(SLOW)
    farm.until_done(job_id, 8)
    farm.kill("valkey")
    killed_at = time.monotonic()
    assert film_of(farm, job_id) == undisturbed
    print(f"ended {time.monotonic() - killed_at:.2f} s after the kill")


def test_everything_is_killed_at_once(farm: RealFarm, undisturbed: str):
    job_id = farm.submit("fake tile_s=0.08")
    farm.until_done(job_id, 10)
    for name in ("worker-0", "worker-1", "assembler", "steward", "valkey"):
        farm.kill(name)
    assert film_of(farm, job_id) == undisturbed


def test_cancel_frees_the_cores_and_stays(farm: RealFarm):
    job_id = farm.submit("fake tile_s=30")
    farm.until(lambda: len(farm.queue.leases()) == 2)
    began = time.monotonic()
    jobs.cancel(farm.store, farm.queue, job_id)
    assert farm.wait(job_id).state is JobState.CANCELED
    seconds = time.monotonic() - began
    assert seconds < 1.0
    assert farm.queue.leases() == {}
    farm.queue.redis.flushall()
    farm.until(lambda: farm.queue.epoch() is not None)
    time.sleep(0.5)
    assert farm.wait(job_id).state is JobState.CANCELED
    print(f"canceled after {seconds:.3f} s")


def test_cancel_and_flushall_at_once(farm: RealFarm):
    job_id = farm.submit("fake tile_s=30")
    farm.until(lambda: len(farm.queue.leases()) == 2)
    farm.store.transition(job_id, JobState.CANCELING, by="api")  # and the API dies here
    farm.queue.redis.flushall()
    assert farm.wait(job_id).state is JobState.CANCELED
    workers = {f"worker-{index}" for index in range(2)}
    farm.until(lambda: not farm.queue.leases() and all(leased_to(farm, name) is None for name in workers))
    # The cores are free again, too: another job goes through at once.
    assert farm.wait(farm.submit("fake"), 5.0).state is JobState.SUCCEEDED


def test_retried_submit_does_not_duplicate(farm: RealFarm, undisturbed: str):
    first = farm.submit(SLOW, idempotency_key="once", request_sha256="a")
    farm.queue.redis.flushall()
    again = farm.submit(SLOW, idempotency_key="once", request_sha256="a")
    assert first == again
    assert film_of(farm, first) == undisturbed
    assert list(farm.store.job_ids()).count(first) == 1


def test_bad_scene_and_bad_tile_fail_beside_a_good_job(farm: RealFarm, undisturbed: str):
    good = farm.submit(SLOW)
    scene, tile = farm.submit("fake fail_prepare=scene"), farm.submit("fake fail_tile=4")
    assert farm.wait(scene).detail["type"] == "urn:smalti:problem:scene-invalid"
    assert (farm.wait(tile).detail["type"], farm.wait(tile).detail["tile"]) == ("urn:smalti:problem:tile-failed", 2)
    assert film_of(farm, good) == undisturbed


def test_tile_that_kills_every_worker_fails_the_job(farm: RealFarm):
    job_id = farm.submit("fake crash_block=0,0", 64, 32)
    event = farm.wait(job_id)
    assert (event.state, event.detail["type"]) == (JobState.FAILED, "urn:smalti:problem:worker-lost")
    assert event.detail["tile"] == 0
    assert film_of(farm, farm.submit("fake", 64, 32))  # and the farm goes on


def test_worker_drains_on_sigterm(farm: RealFarm, undisturbed: str):
    job_id = farm.submit("fake tile_s=5", 64, 32, tile_size=32)
    farm.until(lambda: leased_to(farm, "worker-0"))
    began = time.monotonic()
    process = farm.supervisor.children["worker-0"].process
    farm.kill("worker-0", signal.SIGTERM)
    assert process.wait(DRAIN_S) == 0
    assert time.monotonic() - began < 4.0  # and not the 5 s of the tile
    assert film_of(farm, job_id)
    assert [e.type for e in farm.store.events(job_id)].count("tile_lost") == 0


def test_supervisor_ends_in_time_and_the_next_goes_on(tmp_path, undisturbed: str):
    with running_farm(tmp_path) as farm:
        job_id = farm.submit(SLOW)
        farm.until_done(job_id, 5)
        children = [farm.supervisor.pid(name) for name in ("valkey", *farm.supervisor.children)]
        began = time.monotonic()
    assert time.monotonic() - began < DRAIN_S + 1.0
    for pid in children:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    with running_farm(tmp_path) as farm:
        assert film_of(farm, job_id) == undisturbed
        farm.assert_sound()


def test_api_is_killed_after_202(tmp_path):
    """The job is there and ends; the same POST again does not make another one; the address stays."""
    import httpx

    with running_farm(tmp_path, api=True, port=0, workers=1) as farm:
        scene = {"version": 1, "name": SLOW, "camera": {"type": "perspective", "fov_deg": 40}}
        scene |= {"image": {"width": 64, "height": 64}, "sampling": {"samples": 2}}
        headers = {"Idempotency-Key": "once"}
        url = f"{farm.supervisor.url}/v1/jobs"
        answer = httpx.post(url, json={"scene": scene}, headers=headers)
        assert answer.status_code == 202
        farm.kill("api")
        # The supervisor holds the listening socket: this waits in its backlog until the next API is up.
        again = httpx.post(url, json={"scene": scene}, headers=headers, timeout=30.0)
        assert again.status_code == 202
        assert again.json()["id"] == answer.json()["id"]
        assert len(httpx.get(url, timeout=30.0).json()["jobs"]) == 1
        assert farm.wait(answer.json()["id"]).state is JobState.SUCCEEDED
        farm.assert_sound()


def test_real_kernels_same_bytes_with_a_killed_worker_and_in_process(tmp_path):
    """The same film hash from `render_scene` and from the farm, a worker of which is killed in the middle."""
    from real_scene import BOX

    from tracer.film.writer import film_sha256
    from tracer.render import render_scene
    from tracer.scene import parse_scene

    def no_assets(asset: object) -> Path:
        raise AssertionError(asset)

    scene = parse_scene(BOX)
    in_process = film_sha256(render_scene(scene, no_assets).pixels)
    with running_farm(tmp_path, backend="cpu") as farm:
        job_id = jobs.submit(farm.store, farm.queue, scene, owner="me", output={"tile_size": 16}).job_id
        farm.until_done(job_id, 5)
        farm.until(lambda: leased_to(farm, "worker-0"))
        farm.kill("worker-0")
        assert film_of(farm, job_id) == in_process
        assert [e.type for e in farm.store.events(job_id)].count("tile_lost") == 1
        canceled = jobs.submit(
            farm.store, farm.queue, parse_scene({**BOX, "sampling": {"samples": 65536}}), owner="me"
        ).job_id
        farm.until(farm.queue.leases)
        time.sleep(0.2)
        began = time.monotonic()
        jobs.cancel(farm.store, farm.queue, canceled)
        assert farm.wait(canceled).state is JobState.CANCELED
        assert time.monotonic() - began < 1.0
        farm.assert_sound()


def test_killed_supervisor_leaves_no_orphans(tmp_path):
    import json
    import subprocess
    import sys

    from worker.settings import FarmSettings

    ready = tmp_path / "ready.json"
    settings = FarmSettings(
        store=tmp_path / "store",
        cache=tmp_path / "c",
        api=False,
        workers=1,
        backend="fake",
        ready_file=ready,
        log_file=tmp_path / "log",
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "worker.main", "supervisor"], env=settings.child_environment(), stdin=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 30
    while not ready.exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert json.loads(ready.read_text())["pid"] == process.pid
    children = [int(path.parent.name) for path in Path("/proc").glob("[0-9]*/stat") if parent_of(path) == process.pid]
    assert len(children) == 4  # Valkey, worker, steward, assembler
    process.kill()
    process.wait()
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in children):
        assert time.monotonic() < deadline
        time.sleep(0.02)
