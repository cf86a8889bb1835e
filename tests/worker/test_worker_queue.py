"""The index against a random model, and each script's promises one by one."""

import random
import time

import pytest
from rq.job import Job
from rq.serializers import JSONSerializer

from worker import contract
from worker.errors import JobNotFoundError, QueueUnavailableError, StaleIndexError
from worker.queue import Queue, unix_url
from worker.records import new_job_id

JOB = new_job_id()


@pytest.fixture
def epoch(queue: Queue) -> str:
    return queue.set_epoch("0123456789abcdef")


def expire_now(queue: Queue, worker: str) -> None:
    queue.redis.zadd(contract.KEY_DEADLINES, {worker: 0})


def test_tiles_are_handed_out_once_in_order(queue: Queue, epoch: str):
    assert queue.init_job(JOB, 3, 3)
    assert [queue.lease_next(epoch, JOB, f"w{i}").tile for i in range(5)] == [0, 1, 2, None, None]
    assert queue.leases() == {"w0": (JOB, 0), "w1": (JOB, 1), "w2": (JOB, 2)}


def test_commit_and_lease_in_one_step(queue: Queue, epoch: str):
    queue.init_job(JOB, 2, 2)
    assert queue.lease_next(epoch, JOB, "w").tile == 0
    assert queue.lease_next(epoch, JOB, "w", finished=0, rays=10, kernel_s=0.5) == (1, 1, 2)
    assert queue.lease_next(epoch, JOB, "w", finished=1, rays=5, kernel_s=0.25) == (None, 2, 2)
    assert queue.progress(JOB) == (2, 2, 15, 0.75, False)
    assert queue.leases() == {}
    assert queue.redis.zcard(contract.KEY_DEADLINES) == 0


def test_a_tile_committed_twice_counts_once(queue: Queue, epoch: str):
    queue.init_job(JOB, 9, 3)
    queue.lease_next(epoch, JOB, "a", finished=4, rays=7)
    queue.lease_next(epoch, JOB, "b", finished=4, rays=7)
    assert queue.progress(JOB) == (1, 9, 7, 0.0, False)


def test_commit_only_leases_nothing(queue: Queue, epoch: str):
    queue.init_job(JOB, 2, 2)
    queue.lease_next(epoch, JOB, "w")
    assert queue.lease_next(epoch, JOB, "w", finished=0, ttl_ms=0) == (None, 1, 2)
    assert queue.leases() == {}


def test_padding_bits_are_never_handed_out(queue: Queue, epoch: str):
    for n in (1, 7, 8, 9):
        queue.forget_job(JOB)
        queue.init_job(JOB, n, n, range(n))
        assert queue.progress(JOB).done == n
        assert queue.lease_next(epoch, JOB, "w") == (None, n, n)


def test_rebuilt_job_skips_what_is_done(queue: Queue, epoch: str):
    queue.init_job(JOB, 1000, 10, range(990))
    assert queue.lease_next(epoch, JOB, "w").tile == 990


def test_init_adds_and_never_takes_away(queue: Queue, epoch: str):
    queue.init_job(JOB, 8, 4, [0, 1])
    queue.lease_next(epoch, JOB, "w", finished=2)
    assert not queue.init_job(JOB, 8, 4, [5])
    assert queue.progress(JOB).done == 4
    queue.init_job(JOB, 8, 4, stopped=True)
    assert queue.progress(JOB).stopped


def test_wiped_index_refuses(queue: Queue, epoch: str):
    queue.init_job(JOB, 2, 2)
    queue.redis.flushall()
    with pytest.raises(StaleIndexError):
        queue.lease_next(epoch, JOB, "w", finished=0)
    with pytest.raises(StaleIndexError):
        queue.lease_preparation(epoch, JOB, "w")
    assert queue.redis.keys("*") == []  # no ghost keys
    fresh = queue.set_epoch("0123456789abcdef")
    assert fresh != epoch
    with pytest.raises(JobNotFoundError):
        queue.lease_next(fresh, JOB, "w", finished=0)
    assert queue.redis.keys("*") == [contract.KEY_EPOCH.encode()]


def test_overdue_lease_goes_to_another(queue: Queue, epoch: str):
    queue.init_job(JOB, 5, 5)
    queue.lease_next(epoch, JOB, "dead")
    assert queue.expire().expired == []
    expire_now(queue, "dead")
    assert queue.expire().expired == [("dead", JOB, 0)]
    assert queue.renew(["dead"]) == {"dead"}
    assert queue.lease_next(epoch, JOB, "w").tile == 0  # before tile 1: a lost tile must not wait


def test_lease_ends_by_itself(queue: Queue, epoch: str):
    queue.init_job(JOB, 1, 1)
    queue.lease_next(epoch, JOB, "w", ttl_ms=50)
    assert queue.renew(["w"], ttl_ms=50) == set()
    time.sleep(0.08)
    assert [line[0] for line in queue.expire().expired] == ["w"]


def test_late_commit_of_a_lost_lease_counts(queue: Queue, epoch: str):
    queue.init_job(JOB, 1, 1)
    queue.lease_next(epoch, JOB, "late")
    queue.release("late")
    assert queue.lease_next(epoch, JOB, "late", finished=0) == (None, 1, 1)
    assert queue.lease_next(epoch, JOB, "w").tile is None  # it was in the retry set, and done


def test_reply_that_was_lost_loses_no_tile(queue: Queue, epoch: str):
    queue.init_job(JOB, 3, 3)
    queue.lease_next(epoch, JOB, "w")  # the reply never arrives, and the worker asks again
    assert queue.lease_next(epoch, JOB, "w").tile == 0
    assert queue.leases() == {"w": (JOB, 0)}


def test_lease_of_another_job_is_given_back(queue: Queue, epoch: str):
    other = new_job_id()
    queue.init_job(JOB, 1, 1)
    queue.init_job(other, 1, 1)
    queue.lease_next(epoch, JOB, "w")
    queue.lease_next(epoch, other, "w")
    assert queue.lease_next(epoch, JOB, "v").tile == 0


def test_preparation_has_one_owner_until_it_dies(queue: Queue, epoch: str):
    assert queue.lease_preparation(epoch, JOB, "a")
    assert queue.lease_preparation(epoch, JOB, "a")
    assert not queue.lease_preparation(epoch, JOB, "b")
    expire_now(queue, "a")
    assert queue.expire().expired == [("a", JOB, None)]
    assert queue.lease_preparation(epoch, JOB, "b")
    queue.init_job(JOB, 1, 1)
    assert queue.lease_next(epoch, JOB, "b").tile == 0
    assert queue.redis.hlen(contract.KEY_PREPARING) == 0


def test_stopped_job_gives_nothing_and_takes_what_is_finished(queue: Queue, epoch: str):
    queue.init_job(JOB, 3, 3)
    queue.lease_next(epoch, JOB, "w")
    assert queue.stop_job(JOB) == 1
    assert queue.lease_next(epoch, JOB, "w", finished=0) == (None, 1, 3)
    assert queue.stop_job(JOB) == 0


def test_damaged_tile_is_handed_out_again(queue: Queue, epoch: str):
    queue.init_job(JOB, 2, 2, [0, 1])
    assert queue.redo_tile(JOB, 1)
    assert queue.lease_next(epoch, JOB, "w") == (1, 1, 2)
    assert not queue.redo_tile(new_job_id(), 0)


def test_assembler_hears_of_complete_rows_only(queue: Queue, epoch: str):
    queue.init_job(JOB, 5, 2)  # rows 0 1 | 2 3 | 4 (a short one never occurs, but must do no harm)
    with queue.redis.pubsub(ignore_subscribe_messages=True) as pubsub:
        pubsub.subscribe(contract.CHANNEL_ASSEMBLER)
        pubsub.get_message(timeout=0.2)
        heard = []
        for tile in (1, 2, 0):
            queue.lease_next(epoch, JOB, "w", finished=tile)
            message = pubsub.get_message(timeout=0.05)
            heard.append(message and message["data"])
    assert heard == [None, None, JOB.encode()]


def test_claims(queue: Queue):
    assert queue.claim(JOB, "a", 60)
    assert queue.claim(JOB, "a", 60)
    assert not queue.claim(JOB, "b", 60)
    queue.unclaim(JOB, "b")
    assert not queue.claim(JOB, "b", 60)
    time.sleep(0.08)
    assert queue.claim(JOB, "b", 60)


def test_forgotten_job_leaves_no_key(queue: Queue, epoch: str):
    queue.init_job(JOB, 4, 2)
    queue.lease_next(epoch, JOB, "w")
    queue.count_fault(JOB, 0, "error")
    queue.release("w")
    queue.forget_job(JOB)
    assert queue.redis.keys("*") == [contract.KEY_EPOCH.encode()]


def test_memory_of_a_pending_tile(queue: Queue, epoch: str):
    before = queue.redis.info("memory")["used_memory"]
    for _ in range(100):
        queue.init_job(new_job_id(), 10_000, 100)
    assert (queue.redis.info("memory")["used_memory"] - before) / 1e6 <= 4.0  # bytes a tile


def test_hints_carry_names_and_ids_only(queue: Queue):
    queue.enqueue_prepare(JOB, 90)
    queue.enqueue_runs(JOB, 10, 2)
    assert queue.hints() == {(contract.TASK_PREPARE, JOB), (contract.TASK_RENDER_RUN, JOB)}
    assert queue.queue_lengths() == {"smalti-high": 1, "smalti-normal": 0, "smalti-low": 2}
    hint = queue.redis.lrange("rq:queue:smalti-high", 0, -1)[0].decode()
    job = Job.fetch(hint, queue.redis, serializer=JSONSerializer)
    assert (job.func_name, job.args, job.kwargs, job.timeout) == (contract.TASK_PREPARE, [JOB], {}, -1)


def test_orphaned_hints_are_swept(queue: Queue):
    queue.enqueue_runs(JOB, 50, 2)
    queue.redis.lpop("rq:queue:smalti-normal")
    assert queue.sweep_hints() == 1
    assert queue.sweep_hints() == 0
    assert len(queue.redis.keys("rq:job:*")) == 1


def test_registry_judges_life_when_read(queue: Queue):
    queue.report_worker("w", {"host": "h", "pid": 1, "state": "idle", "started_at": 0.0})
    (worker,) = queue.workers()
    assert worker.alive
    assert (worker.name, worker.host, worker.pid, worker.state, worker.job) == ("w", "h", 1, "idle", None)
    assert not worker._replace(seen_s=6.0).alive
    queue.forget_worker("w")
    assert queue.workers() == []


def test_absent_server_is_told(tmp_path):
    queue = Queue(unix_url(tmp_path / "none"))
    assert not queue.ping()
    for call in (queue.epoch, queue.expire, queue.workers, queue.active_jobs, queue.hints):
        with pytest.raises(QueueUnavailableError):
            call()


@pytest.mark.parametrize("seed", range(40))
def test_random_model(queue: Queue, seed: int):
    """Workers lease, finish, stall, die and come late; the index is wiped and rebuilt; in the end all agree."""
    rnd = random.Random(seed)
    n = rnd.choice((1, 7, 8, 9, 63, 100))
    on_disk: set[int] = set()

    def rebuild() -> str:
        queue.init_job(JOB, n, max(1, n // 3), sorted(on_disk))
        return queue.set_epoch(f"{rnd.randrange(16**12):012x}")

    epoch = rebuild()
    known = dict.fromkeys(("a", "b", "c"), epoch)
    held: dict[str, int | None] = dict.fromkeys(known)
    for _ in range(5000):
        if rnd.random() < 0.01:
            queue.redis.flushall()
            epoch = rebuild()
        worker = rnd.choice(sorted(known))
        if held[worker] is not None:
            on_disk.add(held[worker])
        try:
            lease = queue.lease_next(known[worker], JOB, worker, finished=held[worker])
        except StaleIndexError:
            known[worker] = epoch  # commit the same tile again
            continue
        held[worker] = lease.tile
        owned = [tile for _, tile in queue.leases().values()]
        assert len(owned) == len(set(owned))
        assert lease.done == queue.redis.bitcount(contract.KEY_DONE + JOB) <= len(on_disk)
        if rnd.random() < 0.1:
            expire_now(queue, rnd.choice(sorted(known)))
            queue.expire()
        if rnd.random() < 0.05:
            held[rnd.choice(sorted(known))] = None  # dies without a word; its lease ends some time
        if lease.done == n:
            break
        if all(tile is None for tile in held.values()):
            for name in known:
                expire_now(queue, name)
            queue.expire()
    assert lease.done == n == len(on_disk) == queue.progress(JOB).done
