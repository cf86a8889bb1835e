"""A lease that ended without its tile: counted, noted, hinted at again, and the end of the job after too many."""

import pytest
from worker_farm import SmallFarm

from worker import contract, jobs
from worker.leases import count_fault, lease_lost, reproduce_line
from worker.states import JobState


def rendering(farm: SmallFarm) -> str:
    job_id = farm.submit(width=32, height=32)
    farm.drop_hints()
    for state in (JobState.PREPARING, JobState.RENDERING):
        farm.store.transition(job_id, state, by="w")
    farm.queue.init_job(job_id, 4, 2)
    return job_id


def test_line_to_reproduce():
    assert reproduce_line("01j", 7) == "python -m worker.main tile 01j 7"
    assert reproduce_line("01j", None) == "python -m worker.main tile 01j"


def test_faults_are_counted_by_kind_and_tile(farm: SmallFarm):
    job_id = rendering(farm)
    count = [count_fault(farm.store, farm.queue, job_id, *what, by="w") for what in ((1, "error"), (1, "error"))]
    assert count == [1, 2]
    assert count_fault(farm.store, farm.queue, job_id, 1, "loss", by="w") == 1
    assert count_fault(farm.store, farm.queue, job_id, None, "error", by="w", error="bad") == 1
    last = farm.store.last_event(job_id)
    assert (last.type, last.state, last.detail) == (
        "tile_error",
        JobState.RENDERING,
        {"tile": None, "error": "bad", "errors": 1},
    )


def test_fault_of_a_job_that_has_ended_is_not_counted(farm: SmallFarm):
    job_id = rendering(farm)
    jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")
    assert count_fault(farm.store, farm.queue, job_id, 0, "error", by="w") is None
    assert farm.queue.redis.keys(contract.KEY_FAULTS + "*") == []


def test_lost_tile_is_hinted_at_again(farm: SmallFarm):
    job_id = rendering(farm)
    lease_lost(farm.store, farm.queue, "w", job_id, 2, by="supervisor")
    last = farm.store.last_event(job_id)
    assert (last.type, last.by, last.detail) == ("tile_lost", "supervisor", {"tile": 2, "worker": "w", "losses": 1})
    assert farm.queue.hints() == {(contract.TASK_RENDER_RUN, job_id)}


def test_lost_preparation_is_hinted_at_again(farm: SmallFarm):
    job_id = farm.submit()
    farm.drop_hints()
    lease_lost(farm.store, farm.queue, "w", job_id, None, by="steward")
    assert farm.queue.hints() == {(contract.TASK_PREPARE, job_id)}


@pytest.mark.parametrize(("tile", "what"), [(2, "tile 2"), (None, "the preparation")])
def test_job_fails_after_too_many_losses(farm: SmallFarm, tile: int | None, what: str):
    job_id = rendering(farm)
    for _ in range(contract.MAX_TILE_LOSSES):
        assert farm.state(job_id) == "rendering"
        lease_lost(farm.store, farm.queue, "w", job_id, tile, by="steward")
    problem = jobs.view(farm.store, farm.queue, job_id).problem
    assert problem is not None
    assert problem["detail"] == f"{contract.MAX_TILE_LOSSES} workers were lost with {what}"
    assert problem["reproduce"] == reproduce_line(job_id, tile)
    assert problem.get("tile") == tile


def test_loss_ends_a_cancel_that_waited_for_it(farm: SmallFarm):
    job_id = rendering(farm)
    farm.queue.lease_next(farm.queue.epoch(), job_id, "w")
    assert jobs.cancel(farm.store, farm.queue, job_id).state is JobState.CANCELING
    farm.queue.release("w")
    lease_lost(farm.store, farm.queue, "w", job_id, 0, by="supervisor")
    assert farm.state(job_id) == "canceled"


def test_loss_after_the_end_changes_nothing(farm: SmallFarm):
    job_id = rendering(farm)
    jobs.fail(farm.store, farm.queue, job_id, {"type": "x"}, by="w")
    n_events = len(farm.store.events(job_id))
    lease_lost(farm.store, farm.queue, "w", job_id, 0, by="steward")
    jobs.delete(farm.store, farm.queue, job_id)
    lease_lost(farm.store, farm.queue, "w", job_id, 0, by="steward")
    assert n_events == 4
    assert farm.queue.hints() == set()
