"""From the farm's values to the API's bodies."""

import pytest
from service_farm import Farm

from service import views
from service.views import progress_view, read_page
from worker import jobs
from worker.states import JobState


def test_digits_that_mean_nothing_are_cut() -> None:
    shown = progress_view(jobs.Progress(1, 3, 1 / 3, 7, 123.456789, 9.87654))
    assert (shown.fraction, shown.rays_per_s, shown.eta_s) == (0.333333, 123.5, 9.88)
    unknown = progress_view(jobs.Progress(0, 3, 0.0, 0, None, None))
    assert (unknown.rays_per_s, unknown.eta_s) == (None, None)


def test_links_lead_to_what_exists(farm: Farm) -> None:
    def links(job_id: str) -> set[str]:
        job = views.read_snapshot(farm.context, job_id).view
        return {name for name, link in job.links.model_dump().items() if link is not None}

    always = {"self", "events", "scene"}
    job_id = farm.submit()
    assert links(job_id) == always | {"cancel"}
    farm.move(job_id, JobState.PREPARING, JobState.RENDERING)
    farm.store.result_path(job_id, "preview.png").write_bytes(b"png")
    assert links(job_id) == always | {"cancel", "preview_png"}
    farm.finish(job_id)
    assert links(job_id) == always | {"result_png", "result_exr", "preview_png", "report"}


@pytest.mark.parametrize("detail", [None, {}, {"title": "Bad mesh", "file": "a.obj"}])
def test_the_problem_of_a_failed_job_is_complete(farm: Farm, detail: dict[str, str] | None) -> None:
    job_id = farm.submit()
    farm.move(job_id, JobState.FAILED, detail=detail)
    problem = views.read_snapshot(farm.context, job_id).view.problem
    if detail is None:
        assert problem is None
        return
    assert problem is not None
    assert problem.type == "urn:smalti:problem:job-failed"
    assert problem.title == detail.get("title", "The job failed")
    assert (problem.model_extra or {}).get("file") == detail.get("file")


def test_a_page_ends_after_its_time_and_goes_on_from_there(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    ids = [farm.submit() for _ in range(3)][::-1]
    monkeypatch.setattr(views, "_SCAN_S", -1.0)
    first = read_page(farm.context, None, None, 50)
    assert [job.id for job in first.jobs] == ids[:1]
    assert first.next_cursor == ids[0]
    second = read_page(farm.context, JobState.SUCCEEDED, first.next_cursor, 50)
    assert (second.jobs, second.next_cursor) == ([], ids[1])
