"""The RQ worker: hints become calls of our two tasks and of nothing else, and RQ keeps nothing."""

import pytest
from rq.job import Job
from rq.serializers import JSONSerializer
from worker_farm import SmallFarm

from worker import contract, tasks
from worker.context import WorkerContext
from worker.errors import QueueUnavailableError, StoreFullError
from worker.records import new_job_id
from worker.worker import FarmWorker


@pytest.mark.parametrize(
    ("task", "arguments"),
    [
        ("os.system", ["true"]),
        ("os.system", [new_job_id()]),
        ("worker.tasks.probe", [new_job_id()]),
        (contract.TASK_PREPARE, ["../../etc"]),
        (contract.TASK_PREPARE, [new_job_id(), 1]),
        (contract.TASK_PREPARE, []),
    ],
)
def test_foreign_hints_are_refused_and_removed(
    farm: SmallFarm, monkeypatch: pytest.MonkeyPatch, task: str, arguments: list[object]
):
    from rq import Queue as RqQueue

    called = []
    for name in ("prepare", "render_run", "probe", "system"):
        monkeypatch.setattr(tasks, name, lambda *a: called.append(a), raising=False)
    worker = FarmWorker(farm.worker())
    hints = RqQueue("smalti-normal", connection=farm.queue.redis, serializer=JSONSerializer)
    hints.enqueue_call(task, args=tuple(arguments))
    assert worker.work(burst=True, logging_level="ERROR")
    assert called == []
    assert farm.queue.redis.keys("rq:job:*") == []


def test_pickled_hint_is_refused(farm: SmallFarm):
    from rq import Queue as RqQueue

    worker = FarmWorker(farm.worker())
    RqQueue("smalti-normal", connection=farm.queue.redis).enqueue_call("os.system", args=("true",))
    worker.work(burst=True, logging_level="ERROR")
    assert farm.queue.redis.keys("rq:job:*") == []


def test_rq_keeps_nothing(farm: SmallFarm):
    job_id = farm.submit(width=64, height=64)
    worker = FarmWorker(farm.worker())
    assert worker.work(burst=True, logging_level="ERROR")
    assert farm.queue.progress(job_id).done == 16
    assert {key.decode() for key in farm.queue.redis.keys("rq:*")} <= {"rq:queues"}


def test_hint_is_run_from_its_record(farm: SmallFarm):
    job_id = farm.submit(width=16, height=16)
    hint = farm.queue.redis.lrange("rq:queue:smalti-normal", 0, -1)[0].decode()
    worker = FarmWorker(farm.worker())
    worker.execute_job(Job.fetch(hint, farm.queue.redis, serializer=JSONSerializer), worker.queues[1])
    assert farm.queue.progress(job_id).done == 1


@pytest.mark.parametrize("error", [QueueUnavailableError(), StoreFullError(), RuntimeError()])
def test_task_that_ends_by_an_exception_leaves_no_lease(
    farm: SmallFarm, monkeypatch: pytest.MonkeyPatch, error: Exception
):
    def stumble(context: WorkerContext, job_id: str) -> None:
        assert context.lease_preparation(job_id)
        raise error

    job_id = farm.submit()
    hint = farm.queue.redis.lrange("rq:queue:smalti-normal", 0, -1)[0].decode()
    monkeypatch.setattr(tasks, "prepare", stumble)
    worker = FarmWorker(farm.worker())
    worker.execute_job(Job.fetch(hint, farm.queue.redis, serializer=JSONSerializer), worker.queues[1])
    assert farm.queue.leases() == {}
    assert farm.worker("w1").lease_preparation(job_id)
