"""Tiles to pictures: any order of arrival, any tile size, restarts, damage."""

import json
import os
import random
import time

import numpy as np
import pytest
from worker_farm import SmallFarm

from tracer.film.writer import film_sha256
from worker import contract, jobs, tasks
from worker import main as entry
from worker.assembler import Assembler, Assembly
from worker.audit import audit
from worker.states import JobState


@pytest.fixture(autouse=True)
def streams(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """These jobs are assembled while they are rendered, however soon they will be done."""
    if "waits" not in request.keywords:
        monkeypatch.setattr("worker.assembler._STREAM_FROM_S", 0.0)


def render(farm: SmallFarm, title: str = "fake", **options: object) -> str:
    job_id = farm.submit(title, **options)
    farm.drop_hints()  # on a busy machine a run of over a second would make way for them
    tasks.prepare(farm.worker(), job_id)
    return job_id


def hash_of(farm: SmallFarm, job_id: str) -> str:
    return str(farm.store.last_event(job_id).detail["film_sha256"])


def test_job_succeeds_with_all_its_results(farm: SmallFarm):
    job_id = render(farm, width=70, height=50, samples=3)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"
    view = jobs.view(farm.store, farm.queue, job_id)
    assert (view.progress.fraction, view.progress.eta_s) == (1.0, 0.0)
    report = json.loads(farm.store.result_path(job_id, "report.json").read_bytes())
    assert report["film_sha256"] == view.summary["film_sha256"]
    assert report["rays"]["total"] == view.progress.rays == 3 * 3 * 256 * 20
    assert report["rays"]["per_sample"] == 3.0
    assert report["tiles"] == {"n": 20, "size": 16, "workers": {"w0": 20}}
    assert report["seconds"]["total"] >= report["seconds"]["first_lease_to_last_tile"] > 0
    assert report["seed"] == 7
    assert report["bytes"]["result.exr"] == farm.store.result_path(job_id, "result.exr").stat().st_size
    assert [finding for finding in audit(farm.store, farm.queue) if "key rq:" not in finding] == []


def test_picture_is_the_pattern(farm: SmallFarm):
    import OpenImageIO

    job_id = render(farm, width=70, height=50)
    farm.assembler.advance(job_id)
    pixels = OpenImageIO.ImageBuf(str(farm.store.result_path(job_id, "result.exr"))).get_pixels(OpenImageIO.FLOAT)
    assert pixels.shape == (50, 70, 3)
    x, y = np.arange(70.0), np.arange(50.0)[:, None]
    expected = np.modf(np.abs(np.sin(x * 12.9 + y * 78.2 + 7)) * 43758.5453)[0].astype(np.float32)
    np.testing.assert_array_equal(pixels[:, :, 0], expected)
    assert film_sha256(np.ascontiguousarray(pixels)) == hash_of(farm, job_id)


@pytest.mark.parametrize("crop", [None, {"x": 5, "y": 18, "width": 61, "height": 40}])
def test_bytes_do_not_depend_on_tile_size_or_order(farm: SmallFarm, crop: dict[str, int] | None):
    image = {} if crop is None else {"crop": crop}
    found = set()
    for tile_size in (16, 32, 48, 256):
        job_id = render(farm, tile_size=tile_size, width=100, height=70, image=image)
        tiles = {tile: farm.store.read_tile(job_id, tile) for tile in farm.store.done_tiles(job_id)}
        for tile in tiles:
            farm.store.tile_path(job_id, tile).unlink()
        order = sorted(tiles)
        random.Random(tile_size).shuffle(order)
        for tile in order:
            assert farm.state(job_id) in {"rendering", "assembling"}
            farm.store.write_tile(job_id, tile, tiles[tile])
            farm.assembler.advance(job_id)
        assert farm.state(job_id) == "succeeded"
        files = [farm.store.result_path(job_id, name).read_bytes() for name in ("result.exr", "result.png")]
        found.add((hash_of(farm, job_id), *files))
    assert len(found) == 1


def test_assembler_begins_anew_after_a_crash(farm: SmallFarm):
    job_id = render(farm, width=64, height=64)
    last = farm.store.read_tile(job_id, 15)
    farm.store.tile_path(job_id, 15).unlink()
    farm.assembler.advance(job_id)  # takes in 15 tiles, then dies
    assert len(list(farm.store.temporary.glob("assembly-*"))) == 1
    farm.store.write_tile(job_id, 15, last)
    successor = Assembler(farm.store, farm.queue, "successor")
    successor.advance(job_id)
    assert farm.state(job_id) == "assembling"  # the dead one's claim has not run out yet
    farm.queue.redis.delete(contract.KEY_CLAIM + job_id)
    successor.advance(job_id)
    assert farm.state(job_id) == "succeeded"
    assert not list(farm.store.temporary.iterdir())
    other = render(farm, width=64, height=64)
    successor.advance(other)
    assert hash_of(farm, other) == hash_of(farm, job_id)


@pytest.mark.parametrize("step", ["writer", "commit_result", "SUCCEEDED", "clean_up"])
def test_crash_at_each_step_of_the_commit(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch, step: str):
    job_id = render(farm, width=48, height=32)

    class Crash(BaseException):
        pass

    def crash(*_: object, **__: object) -> None:
        raise Crash

    with monkeypatch.context() as patch:
        if step == "writer":
            patch.setattr("tracer.film.writer.FilmWriter.close", crash)
        elif step == "commit_result":
            patch.setattr(farm.store, "commit_result", crash)
        elif step == "clean_up":
            patch.setattr(jobs, "clean_up", crash)
        else:
            real = jobs.transition
            patch.setattr(jobs, "transition", lambda *a, **k: crash() if "succeeded" in a else real(*a, **k))
        with pytest.raises(Crash):
            farm.assembler.advance(job_id)
    farm.steward.reconcile(everything=True)
    Assembler(farm.store, farm.queue, "assembler").advance(job_id)
    assert farm.state(job_id) == "succeeded"
    farm.steward.reconcile(everything=True)
    farm.drop_hints()
    farm.queue.sweep_hints()
    farm.queue.unclaim(job_id, "assembler")
    assert audit(farm.store, farm.queue) == []


def test_damaged_tile_is_rendered_again(farm: SmallFarm):
    job_id = render(farm, width=64, height=32)
    path = farm.store.tile_path(job_id, 5)
    data = path.read_bytes()
    path.write_bytes(data[:-9] + b"\0" + data[-8:])
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "assembling"
    assert not path.exists()
    assert farm.queue.progress(job_id).done == 7
    tasks.render_run(farm.worker("w1"), job_id)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"
    other = render(farm, width=64, height=32)
    farm.assembler.advance(other)
    assert hash_of(farm, other) == hash_of(farm, job_id)
    assert json.loads(farm.store.result_path(job_id, "report.json").read_bytes())["faults"] == {"tile_error": 1}


def test_tile_of_another_place_is_damage(farm: SmallFarm):
    job_id = render(farm, width=64, height=32)
    farm.store.tile_path(job_id, 5).write_bytes(farm.store.read_tile(job_id, 4))
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "assembling"
    assert 5 not in farm.store.done_tiles(job_id)


def test_memory_is_one_row_of_tiles(farm: SmallFarm):
    job_id = render(farm, width=32, height=320)
    assembly = Assembly(farm.store, farm.queue, job_id, "a")
    rows = []
    real = assembly._take

    def watch(data: bytes) -> None:
        real(data)
        rows.append(assembly._row)

    assembly._take = watch  # type: ignore[method-assign]
    assert assembly.advance()
    assert len(rows) == 40
    assert {id(row) for row in rows} == {id(assembly._row)}
    assert assembly._row is not None
    assert assembly._row.shape == (16, 32, 3)
    assembly.close()


def test_canceled_job_is_dropped(farm: SmallFarm):
    job_id = render(farm, width=64, height=32)
    farm.store.tile_path(job_id, 7).unlink()
    farm.assembler.advance(job_id)
    jobs.cancel(farm.store, farm.queue, job_id)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "canceled"
    assert not list(farm.store.temporary.iterdir())


def test_another_assembler_keeps_its_claim(farm: SmallFarm):
    job_id = render(farm)
    assert farm.queue.claim(job_id, "somebody else")
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "rendering"


def test_full_disk_fails_the_job_and_says_so(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    from tracer.film.errors import ImageWriteError

    def refuse(*_: object) -> None:
        raise ImageWriteError("cannot write result.exr: no space")

    job_id = render(farm)
    monkeypatch.setattr("tracer.film.writer.FilmWriter.close", refuse)
    farm.assembler.advance(job_id)
    assert jobs.view(farm.store, farm.queue, job_id).problem["type"] == "urn:smalti:problem:store-full"
    assert not list(farm.store.temporary.iterdir())


def test_two_assemblers_of_a_host_leave_each_other_alone(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    mine = render(farm, width=64, height=32)
    last = farm.store.read_tile(mine, 7)
    farm.store.tile_path(mine, 7).unlink()
    farm.assembler.advance(mine)
    owners = []
    monkeypatch.setattr(entry, "_run_until_signal", lambda _, run: owners.append(run.__self__._owner) or 0)
    for _ in range(2):
        entry._run_assembler(farm.settings.model_copy(update={"redis_url": farm.queue.url}))
    assert len(set(owners)) == 2
    assert len(list(farm.store.temporary.glob("assembly-*"))) == 1
    farm.store.write_tile(mine, 7, last)
    Assembler(farm.store, farm.queue, owners[0]).advance(mine)
    assert farm.state(mine) == "assembling"
    farm.assembler.advance(mine)
    assert farm.state(mine) == "succeeded"


def test_working_folder_in_use_is_not_swept(farm: SmallFarm):
    job_id = render(farm, width=64, height=32)
    last = farm.store.read_tile(job_id, 7)
    farm.store.tile_path(job_id, 7).unlink()
    farm.assembler.advance(job_id)
    (folder,) = farm.store.temporary.iterdir()
    os.utime(folder, (0, 0))
    assert job_id in farm.assembler._poll()
    assert farm.store.sweep(60.0) == 0
    os.utime(folder, (0, 0))  # as if the machine had slept
    assert farm.store.sweep(60.0) == 1
    farm.store.write_tile(job_id, 7, last)
    assert job_id in farm.assembler._poll()
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"


def test_error_after_the_claim_was_lost_does_not_fail_the_job(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    job_id = render(farm)

    def lose(*_: object) -> None:
        farm.queue.redis.set(contract.KEY_CLAIM + job_id, "another")
        raise FileNotFoundError("the other one has removed the folder")

    with monkeypatch.context() as patch:
        patch.setattr("tracer.film.writer.FilmWriter.close", lose)
        farm.assembler.advance(job_id)
    assert farm.state(job_id) == "assembling"
    Assembler(farm.store, farm.queue, "another").advance(job_id)
    assert farm.state(job_id) == "succeeded"


def test_stopped_assembler_gives_its_jobs_back(farm: SmallFarm):
    job_id = render(farm, width=64, height=32)
    farm.store.tile_path(job_id, 7).unlink()
    farm.assembler.advance(job_id)
    farm.assembler.stop()
    farm.assembler.run()
    assert farm.queue.claim(job_id, "another")
    assert not list(farm.store.temporary.iterdir())


def test_claim_is_kept_through_a_catch_up(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    """Taking in many tiles at once takes longer than the claim lasts; meanwhile nobody else may begin."""
    monkeypatch.setattr("worker.assembler._CLAIM_MS", 500)
    job_id = render(farm, width=32, height=160)
    real = Assembly._take
    thefts = []

    def take_slowly(assembly: Assembly, data: bytes) -> None:
        time.sleep(0.04)
        real(assembly, data)
        thefts.append(farm.queue.claim(job_id, "another"))

    monkeypatch.setattr(Assembly, "_take", take_slowly)
    while farm.assembler.advance(job_id):
        assert farm.state(job_id) == "assembling"
    assert thefts == [False] * 20
    assert farm.state(job_id) == "succeeded"


def test_assembly_stops_where_the_claim_is_lost(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    job_id = render(farm, width=32, height=64)
    real = Assembly._take
    taken = []

    def lose(assembly: Assembly, data: bytes) -> None:
        real(assembly, data)
        taken.append(assembly.next_tile)
        farm.queue.redis.set(contract.KEY_CLAIM + job_id, "another")

    monkeypatch.setattr(Assembly, "_take", lose)
    farm.assembler.advance(job_id)
    assert taken == [0, 1]  # the row that was begun
    assert farm.state(job_id) == "assembling"
    farm.assembler.advance(job_id)
    assert not list(farm.store.temporary.iterdir())


@pytest.mark.parametrize("state", [JobState.CANCELING, JobState.FAILED])
def test_job_that_is_canceled_as_it_is_completed_is_not_published(
    farm: SmallFarm, monkeypatch: pytest.MonkeyPatch, state: JobState
):
    job_id = render(farm)
    real = Assembly.commit

    def too_late(assembly: Assembly) -> None:
        farm.store.transition(job_id, state, by="api")
        real(assembly)

    monkeypatch.setattr(Assembly, "commit", too_late)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == state
    assert not farm.store.has_result(job_id, "result.png")
    assert not list(farm.store.temporary.iterdir())


@pytest.mark.waits
def test_job_that_is_soon_rendered_is_left_alone_until_its_last_tile(farm: SmallFarm):
    job_id = farm.submit(width=64, height=64)
    worker = farm.worker()
    worker.lease_preparation(job_id)
    tasks._compile(worker, farm.store.read_job(job_id))
    farm.queue.init_job(job_id, 16, 4)
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="test")
    finished = None
    for _ in range(16):
        tile = worker.lease_next(job_id, finished=finished, rays=0, kernel_s=0.0, commit_only=False).tile
        tasks._render_tile(worker, job_id, worker.prepared[job_id], tile)
        assert not farm.assembler.advance(job_id)
        assert farm.state(job_id) == "rendering"
        assert not list(farm.store.temporary.glob("assembly-*"))
        finished = tile
    worker.lease_next(job_id, finished=finished, rays=0, kernel_s=0.0, commit_only=True)
    farm.assembler.advance(job_id)
    assert farm.state(job_id) == "succeeded"


@pytest.mark.waits
@pytest.mark.parametrize(("done", "elapsed_s", "streams"), [(4, 1.0, False), (4, 100.0, True), (0, 100.0, True)])
def test_long_job_is_assembled_meanwhile(
    farm: SmallFarm, monkeypatch: pytest.MonkeyPatch, done: int, elapsed_s: float, streams: bool
):
    job_id = render(farm, width=64, height=64)
    for tile in range(done, 16):
        farm.store.tile_path(job_id, tile).unlink()
        farm.queue.redo_tile(job_id, tile)
    monkeypatch.setattr("worker.assembler.seconds_between", lambda *_: elapsed_s)
    farm.assembler.advance(job_id)
    assert bool(farm.assembler._assemblies) == streams
    assert farm.state(job_id) == "rendering"


def test_large_job_does_not_keep_a_small_one_waiting(farm: SmallFarm, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("worker.assembler._TURN_S", 0.0)
    large, small = render(farm, width=32, height=160), render(farm, width=32, height=16)
    turns = 0
    while farm.assembler.advance(large):
        turns += 1
        farm.assembler.advance(small)
    assert farm.state(small) == farm.state(large) == "succeeded"
    assert turns >= 9
