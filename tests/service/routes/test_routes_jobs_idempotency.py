"""Idempotency-Key, durability before 202, and what happens when something breaks in between."""

import threading
import traceback
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from service_farm import Farm, assert_problem, scene, serve

import service.middleware
from worker.errors import StoreFullError
from worker.store import Store

KEY = "Idempotency-Key"


def test_the_same_request_again_gives_the_same_job(farm: Farm) -> None:
    first = farm.post(headers={KEY: "again"})
    second = farm.post(headers={KEY: "again"})
    assert first.status_code == second.status_code == 202
    assert "Idempotency-Replayed" not in first.headers
    assert second.headers["Idempotency-Replayed"] == "true"
    assert first.json() == second.json()
    assert first.headers["Location"] == second.headers["Location"]


def test_layout_and_order_of_members_do_not_make_another_request(farm: Farm) -> None:
    first = farm.post(body={"scene": scene(), "priority": 50}, headers={KEY: "layout"})
    reordered = dict(reversed(scene().items()))
    second = farm.post(body={"scene": reordered}, headers={KEY: "layout"})
    assert first.json()["id"] == second.json()["id"]


def test_another_body_under_the_same_key_is_refused(farm: Farm) -> None:
    farm.post(headers={KEY: "other"})
    assert_problem(farm.post(scene(name="x"), headers={KEY: "other"}), 422, "idempotency-mismatch")
    assert_problem(
        farm.post(body={"scene": scene(), "priority": 1}, headers={KEY: "other"}), 422, "idempotency-mismatch"
    )


def test_a_refused_request_does_not_use_up_its_key(farm: Farm) -> None:
    assert_problem(farm.post({"version": 1}, headers={KEY: "corrected"}), 422, "scene-invalid")
    assert farm.post(headers={KEY: "corrected"}).status_code == 202


def test_a_key_outlives_its_deleted_job(farm: Farm) -> None:
    job_id = farm.post(headers={KEY: "deleted"}).json()["id"]
    farm.finish(job_id)
    assert farm.client.delete(f"/v1/jobs/{job_id}").status_code == 204
    before = set(farm.store.job_ids())
    body = assert_problem(farm.post(headers={KEY: "deleted"}), 410, "idempotency-spent")
    assert "use a new Idempotency-Key" in body["detail"]
    assert_problem(farm.post(scene(name="other"), headers={KEY: "deleted"}), 422, "idempotency-mismatch")
    assert set(farm.store.job_ids()) == before


@pytest.mark.parametrize("key", ["", "k" * 256])
def test_keys_of_unfit_length(farm: Farm, key: str) -> None:
    body = assert_problem(farm.post(headers={KEY: key}), 422, "parameters-invalid")
    assert body["errors"][0]["pointer"] == "/header/idempotency-key"
    assert body["errors"][0]["expected"].startswith("a text, not empty, of at most 255 characters")


def test_a_key_in_flight_is_refused_until_its_request_is_answered(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, leave = threading.Event(), threading.Event()
    original = farm.store.create_job

    def slow(*arguments: Any, **named: Any) -> bool:
        entered.set()
        assert leave.wait(10)
        return original(*arguments, **named)

    monkeypatch.setattr(farm.store, "create_job", slow)
    answers: list[httpx.Response] = []
    first = threading.Thread(target=lambda: answers.append(farm.post(headers={KEY: "flight"})))
    first.start()
    assert entered.wait(10)
    second = farm.post(headers={KEY: "flight"})
    leave.set()
    first.join()
    assert_problem(second, 409, "idempotency-in-flight")
    assert second.headers["Retry-After"] == "1"
    assert answers[0].status_code == 202
    assert farm.post(headers={KEY: "flight"}).json()["id"] == answers[0].json()["id"]


def test_many_at_once_make_one_job(farm: Farm) -> None:
    answers: list[httpx.Response] = []

    def post() -> None:
        with httpx.Client(base_url=farm.url, timeout=20) as client:
            answers.append(client.post("/v1/jobs", json={"scene": scene(name="once")}, headers={KEY: "many"}))

    threads = [threading.Thread(target=post) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} <= {202, 409}
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 202}) == 1
    named = [job_id for job_id in farm.store.job_ids() if farm.store.read_job(job_id).name == "once"]
    assert len(named) == 1


# ---- faults between the writes ---------------------------------------------------------------------------------------


class FaultyStore(Store):
    """A store that breaks where it is told to."""

    fault: BaseException | None = None
    step = ""

    def _break(self, step: str) -> None:
        if self.step == step and self.fault is not None:
            fault, self.fault = self.fault, None
            raise fault

    def put_idempotency(self, *arguments: Any) -> tuple[str, str]:
        self._break("before key")
        outcome = super().put_idempotency(*arguments)
        self._break("after key")
        return outcome

    def create_job(self, *arguments: Any, **named: Any) -> bool:
        outcome = super().create_job(*arguments, **named)
        self._break("after job")
        return outcome


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory, redis_url: str) -> Iterator[Farm]:
    with serve(tmp_path_factory.mktemp("faulty"), redis_url) as farm:
        farm.context.store = FaultyStore(farm.store.root)
        yield farm


FAULTS = [OSError(5, "Input/output error"), StoreFullError(), RuntimeError("a bug")]
STATUS = {
    OSError: (503, "store-unavailable"),
    StoreFullError: (507, "store-full"),
    RuntimeError: (500, "internal-error"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("step", ["before key", "after key", "after job"])
def test_a_fault_in_between_is_not_acknowledged_and_the_retry_heals_it(
    faulty: Farm, step: str, fault: BaseException
) -> None:
    store = faulty.store
    assert isinstance(store, FaultyStore)
    before = set(store.job_ids())
    store.step, store.fault = step, fault
    key = f"{step}-{type(fault).__name__}"
    assert_problem(faulty.post(headers={KEY: key}), *STATUS[type(fault)])
    assert store.fault is None
    assert len(set(store.job_ids()) - before) == (1 if step == "after job" else 0)
    retry = faulty.post(headers={KEY: key})
    assert retry.status_code == 202, retry.text
    assert set(store.job_ids()) - before == {retry.json()["id"]}
    assert faulty.post(headers={KEY: key}).json()["id"] == retry.json()["id"]


def test_a_full_disk_is_told_as_such(faulty: Farm) -> None:
    store = faulty.store
    assert isinstance(store, FaultyStore)
    store.step, store.fault = "after key", OSError(28, "No space left on device")
    answer = faulty.post(headers={KEY: "full"})
    assert_problem(answer, 507, "store-full")
    assert answer.headers["Retry-After"]


def test_an_unexpected_error_is_logged_and_told_without_its_text(faulty: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    logged: list[tuple[str, str]] = []

    class Log:
        def exception(self, _event: str, **fields: Any) -> None:
            logged.append((fields["request_id"], traceback.format_exc()))

        def info(self, *_: Any, **__: Any) -> None: ...

    monkeypatch.setattr(service.middleware, "log", Log())
    store = faulty.store
    assert isinstance(store, FaultyStore)
    store.step, store.fault = "before key", RuntimeError("secret-text-of-the-bug")
    answer = faulty.post(headers={KEY: "bug"})
    problem = assert_problem(answer, 500, "internal-error")
    assert "secret" not in answer.text
    assert problem["request_id"] == answer.headers["X-Request-ID"]
    assert [request_id for request_id, _ in logged] == [problem["request_id"]]
    assert "secret-text-of-the-bug" in logged[0][1]
