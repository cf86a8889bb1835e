"""The audit sees each thing that it is there to see, and nothing on a sound farm."""

import json

import pytest
from worker_farm import SmallFarm

from worker import contract, tasks
from worker.audit import assert_sound, audit
from worker.errors import FarmError
from worker.records import JobEvent, now
from worker.states import JobState


@pytest.fixture
def ended(farm: SmallFarm) -> str:
    """A job that succeeded, on a farm at rest."""
    job_id = farm.submit(width=32, height=16)
    tasks.prepare(farm.worker(), job_id)
    farm.assembler.advance(job_id)
    farm.drop_hints()
    farm.queue.sweep_hints()
    assert_sound(farm.store, farm.queue)
    return job_id


def write_event(farm: SmallFarm, job_id: str, seq: int, state: JobState, previous: JobState) -> None:
    event = JobEvent(seq, now(), "state", state, previous, "x", {})
    (farm.store.job_dir(job_id) / "events" / f"{seq:06d}.json").write_bytes(event.to_json())


def damage(farm: SmallFarm, job_id: str, what: str) -> None:
    queue, redis, folder = farm.queue, farm.queue.redis, farm.store.job_dir(job_id)
    match what:
        case "is missing a number":
            write_event(farm, job_id, 7, JobState.SUCCEEDED, JobState.SUCCEEDED)
        case "leads from succeeded to rendering":
            write_event(farm, job_id, 6, JobState.RENDERING, JobState.SUCCEEDED)
        case "still in the index":
            queue.init_job(job_id, 2, 2)
        case "still has 1 tiles":
            (folder / "tiles").mkdir()
            (folder / "tiles" / "0-0").touch()
        case "succeeded without result.png":
            (folder / "result.png").unlink()
        case "name different pictures":
            report = json.loads((folder / "report.json").read_bytes())
            (folder / "report.json").write_text(json.dumps({**report, "film_sha256": "0"}))
        case "report counts":
            report = json.loads((folder / "report.json").read_bytes())
            (folder / "report.json").write_text(json.dumps({**report, "tiles": {"n": 3, "workers": {"w": 3}}}))
        case "has two owners":
            redis.hset(contract.KEY_LEASES, mapping={"a": f"{job_id}/1", "b": f"{job_id}/1"})
        case "but deadlines of":
            redis.zadd(contract.KEY_DEADLINES, {"ghost": 1})
        case "still has ('":
            redis.hset(contract.KEY_LEASES, mapping={"a": f"{job_id}/1"})
        case "key rq:job:x is left":
            redis.set("rq:job:x", 1)
        case "is left in tmp":
            (farm.store.temporary / "x").touch()


@pytest.mark.parametrize(
    "what",
    [
        "is missing a number",
        "leads from succeeded to rendering",
        "still in the index",
        "still has 1 tiles",
        "succeeded without result.png",
        "name different pictures",
        "report counts",
        "has two owners",
        "but deadlines of",
        "still has ('",
        "key rq:job:x is left",
        "is left in tmp",
    ],
)
def test_damage_is_found(farm: SmallFarm, ended: str, what: str):
    damage(farm, ended, what)
    findings = audit(farm.store, farm.queue)
    assert any(what.replace("is missing a number", "events are numbered") in finding for finding in findings), findings
    with pytest.raises(FarmError):
        assert_sound(farm.store, farm.queue)


def test_running_job_is_compared_with_its_tiles(farm: SmallFarm):
    job_id = farm.submit(width=32, height=32)
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    assert audit(farm.store, farm.queue, at_rest=False) == []
    farm.queue.redis.setbit(contract.KEY_DONE + job_id, 2, 1)
    findings = audit(farm.store, farm.queue, at_rest=False)
    assert findings == [
        f"job {job_id}: 0 tiles counted done, 1 marked",
        f"job {job_id}: 1 tiles marked done, 0 on disk",
    ]
    assert f"job {job_id} has not ended" in audit(farm.store, farm.queue)
