"""What a worker does with a hint, without processes: the fake backend, one turn at a time."""

import threading
import time
from pathlib import Path

import pytest
from worker_farm import SmallFarm

from tracer.film.tile import decode_tile
from worker import contract, jobs, tasks
from worker.errors import StoreFullError
from worker.records import new_job_id
from worker.states import JobState


def events_of(farm: SmallFarm, job_id: str) -> list[str]:
    return [str(e.state) if e.type == "state" else e.type for e in farm.store.events(job_id)]


def test_prepare_goes_on_to_render_all(farm: SmallFarm):
    job_id = farm.submit(width=40, height=20, samples=3)
    tasks.prepare(farm.worker(), job_id)
    assert events_of(farm, job_id) == ["created", "preparing", "rendering"]
    assert farm.store.done_tiles(job_id) == list(range(6))
    header, pixels = decode_tile(farm.store.read_tile(job_id, 5))
    assert (header.rect, header.sample_range, header.worker) == ((32, 16, 8, 4), (0, 3), "w0")
    assert (header.payload, pixels.shape) == ("pixels", (4, 8, 3))
    assert 0.0 < header.kernel_cpu_s < header.kernel_s + 0.1
    progress = farm.queue.progress(job_id)
    assert (progress.done, progress.n_tiles, progress.rays) == (6, 6, 3 * 3 * 256 * 6)
    assert farm.queue.leases() == {}
    plan = farm.store.read_plan(job_id)
    assert (plan["backend"], plan["arithmetic"], plan["seed"], plan["tile_size"]) == ("fake", "fake-v1", 7, 16)


def test_tiles_on_disk_are_not_rendered_again(farm: SmallFarm):
    job_id = farm.submit(width=32, height=16)
    farm.store.write_tile(job_id, 1, b"kept")
    tasks.prepare(farm.worker(), job_id)
    assert farm.store.read_tile(job_id, 1) == b"kept"
    progress = farm.queue.progress(job_id)
    assert (progress.done, progress.rays) == (2, 3 * 2 * 256)  # the rays of one tile


def test_task_for_a_job_that_has_ended_or_never_was(farm: SmallFarm):
    job_id = farm.submit()
    jobs.cancel(farm.store, farm.queue, job_id)
    for one in (job_id, new_job_id()):
        tasks.prepare(farm.worker(), one)
        if one == job_id:
            tasks.render_run(farm.worker(), one)
    assert events_of(farm, job_id) == ["created", "canceling", "canceled"]


def test_hint_of_a_job_being_canceled_ends_it(farm: SmallFarm):
    job_id = farm.submit()
    farm.store.transition(job_id, JobState.CANCELING, by="api")  # and the API died here
    farm.steward.reconcile()  # leaves a job alone that has its hint
    assert farm.state(job_id) == "canceling"
    tasks.prepare(farm.worker(), job_id)
    assert farm.state(job_id) == "canceled"


def test_scene_error_fails_the_job_with_a_pointer(farm: SmallFarm):
    job_id = farm.submit("fake fail_prepare=scene")
    tasks.prepare(farm.worker(), job_id)
    view = jobs.view(farm.store, farm.queue, job_id)
    assert view.problem == {
        "type": "urn:smalti:problem:scene-invalid",
        "title": "The scene cannot be rendered",
        "detail": "it asked for it",
        "pointer": "/scene",
        "tiles_done": 0,
        "rays": 0,
    }
    assert events_of(farm, job_id) == ["created", "preparing", "failed"]
    assert farm.queue.active_jobs() == set()


def test_missing_asset_names_the_file(farm: SmallFarm):
    job_id = farm.submit(assets={"car": {"file": "car.json", "sha256": "0" * 64}})
    tasks.prepare(farm.worker(), job_id)
    problem = jobs.view(farm.store, farm.queue, job_id).problem
    assert problem["type"] == "urn:smalti:problem:asset-missing"
    assert problem["file"] == "car.json"
    assert problem["expected"] == "an uploaded file: PUT /v1/assets/{sha256}, then send the job again"


def test_asset_lies_beside_its_companions(farm: SmallFarm):
    import hashlib

    names = {"car.obj": b"mtllib a/car.mtl", "a/car.mtl": b"newmtl x"}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in names.items()}
    for name, data in names.items():
        farm.store.put_asset(hashes[name], [data], 100)
    companions = {"a/car.mtl": hashes["a/car.mtl"]}
    assets = {"car": {"file": "car.obj", "sha256": hashes["car.obj"], "companions": companions}}
    job_id = farm.submit(width=16, height=16, assets=assets)
    tasks.prepare(farm.worker(), job_id)
    assert farm.state(job_id) == "rendering"
    (folder,) = (farm.settings.cache / "assets").iterdir()
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert found == names


def test_preparation_that_raises_is_tried_three_times(farm: SmallFarm):
    job_id = farm.submit("fake fail_prepare=error")
    for attempt in range(3):
        assert farm.state(job_id) in {"queued", "preparing"}
        assert (contract.TASK_PREPARE, job_id) in farm.queue.hints(), attempt
        tasks.prepare(farm.worker(), job_id)
    problem = jobs.view(farm.store, farm.queue, job_id).problem
    assert problem["type"] == "urn:smalti:problem:preparation-failed"
    assert "it asked for it" in problem["detail"]
    assert problem["reproduce"] == f"python -m worker.main tile {job_id}"


def test_tile_that_raises_fails_the_job_and_is_named(farm: SmallFarm):
    job_id = farm.submit("fake fail_tile=2", width=64, height=32)
    tasks.prepare(farm.worker(), job_id)
    problem = jobs.view(farm.store, farm.queue, job_id).problem
    assert (problem["type"], problem["tile"]) == ("urn:smalti:problem:tile-failed", 2)
    assert problem["reproduce"].endswith(f"tile {job_id} 2")
    assert events_of(farm, job_id).count("tile_error") == 3
    assert farm.store.done_tiles(job_id) == []
    assert farm.queue.leases() == {}


def test_fault_that_is_counted_after_the_end_leaves_nothing(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    """Two workers fail the same job: the slower one counts after the faster one has ended it and cleaned up."""
    job_id = farm.submit("fake fail_tile=0", width=16, height=16)
    real = farm.queue.count_fault

    def slow(*arguments: object) -> int:
        if real(*arguments) == 1:
            jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="faster")
        return real(*arguments)

    monkeypatch.setattr(farm.queue, "count_fault", slow)
    tasks.prepare(farm.worker(), job_id)
    assert farm.state(job_id) == "failed"
    assert farm.queue.redis.keys("sm:f:*") == []
    assert farm.queue.leases() == {}


def test_tile_that_raises_once_is_rendered(farm: SmallFarm, tmp_path: Path):
    job_id = farm.submit(f"fake flaky={tmp_path / 'flag'}", width=64, height=32)
    tasks.prepare(farm.worker(), job_id)
    assert events_of(farm, job_id).count("tile_error") == 1
    assert farm.queue.progress(job_id).done == 8


def test_full_store_is_named(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> bool:
        raise StoreFullError

    job_id = farm.submit(width=16, height=16)
    context = farm.worker()
    monkeypatch.setattr(context.store, "write_tile", refuse)
    tasks.prepare(context, job_id)
    assert jobs.view(farm.store, farm.queue, job_id).problem["type"] == "urn:smalti:problem:store-full"


def test_cancel_stops_a_kernel_and_the_job_ends(farm: SmallFarm):
    job_id = farm.submit("fake tile_s=20", width=16, height=16)
    context = farm.worker()
    thread = threading.Thread(target=tasks.prepare, args=(context, job_id))
    thread.start()
    while farm.queue.leases().get("w0") != (job_id, 0):
        time.sleep(0.005)
    assert jobs.cancel(farm.store, farm.queue, job_id).state == "canceling"
    assert not context.cancel_job(new_job_id())
    assert context.cancel_job(job_id)  # the control thread's part
    thread.join(5)
    assert not thread.is_alive()
    assert events_of(farm, job_id)[-2:] == ["canceling", "canceled"]
    with context.working_on(new_job_id()):
        assert context.cancel[0] == 0  # the next job is not hit


def test_drain_gives_the_tile_back_with_a_hint(farm: SmallFarm):
    job_id = farm.submit("fake tile_s=20", width=32, height=16)
    context = farm.worker()
    thread = threading.Thread(target=tasks.prepare, args=(context, job_id))
    thread.start()
    while farm.queue.leases().get("w0") != (job_id, 0):
        time.sleep(0.005)
    context.drain()
    thread.join(5)
    assert farm.queue.leases() == {}
    assert (contract.TASK_RENDER_RUN, job_id) in farm.queue.hints()
    assert farm.state(job_id) == "rendering"
    assert farm.queue.lease_next(farm.queue.epoch(), job_id, "other").tile == 0


def test_worker_makes_room_for_another_job(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(contract, "RUN_S", 0.05)
    farm.drop_hints()
    first = farm.submit("fake tile_s=0.02", width=160, height=16)
    farm.drop_hints()
    second = farm.submit()
    tasks.prepare(farm.worker(), first)
    assert 1 < farm.queue.progress(first).done < 10
    hints = farm.queue.redis.lrange("rq:queue:smalti-normal", 0, -1)
    assert [hint.decode().split("-")[1] for hint in hints][-1] == second or (
        contract.TASK_RENDER_RUN,
        first,
    ) in farm.queue.hints()
    assert (contract.TASK_RENDER_RUN, first) in farm.queue.hints()
    assert farm.queue.leases() == {}


def test_index_wiped_in_mid_run_is_waited_for(farm: SmallFarm):
    job_id = farm.submit("fake tile_s=0.02", width=160, height=16)
    context = farm.worker()
    thread = threading.Thread(target=tasks.prepare, args=(context, job_id))
    thread.start()
    while len(farm.store.done_tiles(job_id)) < 3:
        time.sleep(0.005)
    farm.queue.redis.flushall()
    time.sleep(0.1)
    assert farm.steward.tick()
    thread.join(10)
    assert farm.queue.progress(job_id).done == 10
    assert events_of(farm, job_id) == ["created", "preparing", "rendering"]


def test_render_alone_writes_nothing(farm: SmallFarm):
    job_id = farm.submit(width=32, height=16)
    before = sorted(farm.store.root.rglob("*"))
    assert tasks.render_alone(farm.worker(), job_id, 1)["rect"] == [16, 0, 16, 16]
    assert "triangles" in tasks.render_alone(farm.worker(), job_id, None)
    assert sorted(farm.store.root.rglob("*")) == before
