"""Each error has its exit code, and problem documents find their class."""

import pytest

from client import errors
from client.errors import EXIT_CODE_MEANINGS, ExitCode, Fault, SmaltiError, error_from_problem


def test_every_exit_code_is_documented() -> None:
    assert set(EXIT_CODE_MEANINGS) == set(ExitCode)
    assert [int(code) for code in ExitCode] == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 130]


@pytest.mark.parametrize(
    ("status", "slug", "kind", "code"),
    [
        (404, "job-not-found", errors.NotFoundError, 7),
        (410, "job-deleted", errors.NotFoundError, 7),
        (409, "result-not-ready", errors.ConflictError, 8),
        (422, "idempotency-mismatch", errors.ConflictError, 8),
        (410, "idempotency-spent", errors.ConflictError, 8),
        (422, "scene-invalid", errors.SceneInvalidError, 3),
        (422, "hash-mismatch", errors.AssetError, 3),
        (422, "request-invalid", errors.UsageError, 2),
        (413, "too-large", errors.SceneInvalidError, 3),
        (503, "queue-unavailable", errors.NotReachableError, 6),
        (500, "internal-error", errors.ApiError, 1),
        (418, "teapot", errors.ApiError, 1),
    ],
)
def test_class_and_exit_code_by_problem(status: int, slug: str, kind: type[SmaltiError], code: int) -> None:
    problem = {"type": f"urn:smalti:problem:{slug}", "title": "Title", "detail": "Detail."}
    error = error_from_problem(problem, status)
    assert type(error) is kind
    assert error.exit_code == code
    assert error.status == status
    assert error.problem == {**problem, "status": status}
    assert error.message == "Title: Detail."


def test_faults_come_with_pointer_and_expectation() -> None:
    entry = {"pointer": "/scene/camera/fov_deg", "detail": "is 400", "expected": "below 180"}
    error = error_from_problem({"type": "x:scene-invalid", "title": "T", "errors": [entry, 5]}, 422)
    assert error.faults == (Fault("/scene/camera/fov_deg", "is 400", "below 180"),)


def test_allowed_transitions_become_a_hint() -> None:
    error = error_from_problem({"title": "T", "allowed": ["canceling", "failed"]}, 409)
    assert error.hint == "allowed now: canceling, failed"


def test_an_error_without_text_says_what_its_class_is_for() -> None:
    assert str(errors.NotFoundError()) == "There is no such job or result."
