"""Jobs as the service tells them."""

import pytest

from client.models import Job


def test_job_of_a_newer_service_is_read() -> None:
    job = Job.parse(
        {"id": "a", "state": "paused", "progress": {"tiles_done": 1, "tiles_total": 2, "new": 1}, "new": {}}
    )
    assert (job.state, job.is_terminal, job.progress.fraction, job.progress.rays_per_s) == ("paused", False, 0.5, None)
    assert Job.parse({"id": "a", "state": "x", "progress": 5, "problem": "p"}).problem is None
    for data in ({}, {"id": "a"}, [], None):
        with pytest.raises(ValueError, match="not a job"):
            Job.parse(data)  # type: ignore[arg-type]
