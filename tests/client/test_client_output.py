"""What is printed: tables, errors, progress, the report."""

import io
import sys
from typing import Any

import pytest

from client import progress as progress_module
from client.errors import Fault, SceneInvalidError, UsageError
from client.models import Job, Progress
from client.options import override, parse_size
from client.progress import Lines, Speedometer, describe, show_progress
from client.report import print_report, skipped_rows, time_rows, work_rows
from client.terminal import Terminal, clean

REPORT = {
    "seconds": {
        "queued": 0.5,
        "preparing": {"load": 0.1, "build": 0.2, "total": 0.5},
        "first_lease_to_last_tile": 8.0,
        "after_last_tile": 1.0,
        "total": 10.0,
    },
    "kernel_s": 12.0,
    "rays": {"primary_rays": 1000, "shadow_rays": 500, "total": 1500, "per_sample": 1.5, "per_s": 1.5e6},
    "skipped": {"shadow_rays_skipped_facing": 12345, "bounces_skipped_depth": 0, "something_new": 1},
    "tiles": {"n": 60, "size": 64, "workers": {"a": 30, "b": 30}},
    "triangles": 4511,
    "bytes": {"compiled_scene": 2_000_000},
    "warnings": ["a.mtl: \x1b[31mred"],
}


class FakeTerminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_time_rows_have_shares_of_the_whole() -> None:
    rows = {row[0].strip(): row[1:] for row in time_rows(REPORT)}
    assert rows["rendering, first to last tile"] == ["8.00 s", "80.0 %"]
    assert rows["reading models and textures"] == ["0.10 s", "1.0 %"]
    assert rows["all"] == ["10.0 s", "100.0 %"]


def test_parts_of_an_earlier_compilation_are_left_out() -> None:
    seconds = {"preparing": {"load": 1.0, "build": 2.0, "total": 0.01}, "total": 1.0}
    assert [row[0] for row in time_rows({"seconds": seconds})] == ["preparing the scene", "all"]


def test_work_rows_tell_how_busy_the_workers_were() -> None:
    rows = dict(work_rows(REPORT))
    assert rows["in kernels"] == "12.0 s on 2 workers, 75.0 % of their time"
    assert rows["triangles"] == "4.51 k"
    assert rows["speed"] == "1.50 Mrays/s"


def test_skipped_work_that_never_occurred_is_left_out() -> None:
    assert skipped_rows(REPORT) == [["shadow rays to lights behind the surface", "12.3 k"], ["something new", "1"]]


@pytest.mark.parametrize(
    "report", [{}, {"seconds": 5, "rays": None, "tiles": [], "skipped": "x"}, {"seconds": {"total": "x"}}]
)
def test_reports_of_another_form_do_no_harm(report: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    print_report(Terminal(), report)
    assert "nothing" in capsys.readouterr().out


def test_report_in_a_pipe_is_plain(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(Terminal(), REPORT)
    shown = capsys.readouterr()
    assert "Where the time went\nwaiting for a worker            0.50 s    5.0 %\n" in shown.out
    assert "\x1b" not in shown.out + shown.err


def test_report_on_a_terminal_is_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stdout", FakeTerminal())
    print_report(Terminal(), REPORT)
    text = sys.stdout.getvalue()  # type: ignore[attr-defined]
    assert "rendering, first to last tile" in text
    assert "80.0 %" in text


def test_control_characters_never_reach_the_terminal() -> None:
    assert clean("a\x1b[31m\nb\x9b\u202e") == "a\ufffd[31m\ufffdb\ufffd\ufffd"


def test_errors_tell_place_reason_and_expectation(capsys: pytest.CaptureFixture[str]) -> None:
    error = SceneInvalidError("bad", faults=[Fault("/a", "is 5", "below 3"), Fault("", "no object")], hint="mend it")
    Terminal().error(error)
    expected = "error: bad\n  /a: is 5 (expected: below 3)\n  (whole document): no object\nhint: mend it\n"
    assert capsys.readouterr().err == expected


def test_quiet_and_json_have_no_notes(capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (Terminal(quiet=True), Terminal(as_json=True)):
        terminal.note("x")
    assert capsys.readouterr().err == ""


def test_lines_come_with_states_and_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    lines = Lines(clock=lambda: now[0])
    for now[0], state in ((0, "queued"), (1, "queued"), (2, "rendering"), (4, "rendering"), (8, "rendering")):
        lines.update(state, Progress(tiles_done=1, tiles_total=4, fraction=0.25))
    assert capsys.readouterr().err.splitlines() == [
        f"{state}, 1/4 tiles (25 %)" for state in ("queued", "rendering", "rendering")
    ]


def test_description_has_speed_and_time_to_go_while_rendering() -> None:
    progress = Progress(tiles_done=1, tiles_total=4, fraction=0.25, eta_s=90)
    assert describe("rendering", progress, 2e6) == "rendering, 1/4 tiles (25 %), 2.00 Mrays/s, 90.0 s to go"
    assert describe("canceling", progress, None) == "canceling, 1/4 tiles (25 %)"
    assert describe("queued", Progress(), None) == "queued"


def test_speed_is_measured_where_it_is_not_told() -> None:
    now = [0.0]
    speedometer = Speedometer(clock=lambda: now[0])
    assert speedometer.rays_per_s(Progress(rays=0)) is None
    now[0] = 1.0
    assert speedometer.rays_per_s(Progress(rays=100)) == 100
    now[0] = 10.0
    assert speedometer.rays_per_s(Progress(rays=1000)) == 100, "old points are forgotten"
    assert speedometer.rays_per_s(Progress(rays=1000, rays_per_s=7)) == 7


def test_live_bar_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", FakeTerminal())
    with show_progress("demo") as view:
        view.update("rendering", Progress(tiles_done=1, tiles_total=4, fraction=0.25, rays_per_s=2e6, eta_s=5.0))
    text = sys.stderr.getvalue()  # type: ignore[attr-defined]
    for part in ("demo rendering", "1/4 tiles", "2.00 Mrays/s", "5.00 s to go"):
        assert part in text
    monkeypatch.setenv("TERM", "dumb")
    with show_progress("demo") as view:
        assert isinstance(view, Lines)
    with show_progress("demo", quiet=True) as view:
        assert isinstance(view, progress_module.Silent)


def test_job_of_a_newer_service_is_read() -> None:
    job = Job.parse(
        {"id": "a", "state": "paused", "progress": {"tiles_done": 1, "tiles_total": 2, "new": 1}, "new": {}}
    )
    assert (job.state, job.is_terminal, job.progress.fraction, job.progress.rays_per_s) == ("paused", False, 0.5, None)
    assert Job.parse({"id": "a", "state": "x", "progress": 5, "problem": "p"}).problem is None
    for data in ({}, {"id": "a"}, [], None):
        with pytest.raises(ValueError, match="not a job"):
            Job.parse(data)  # type: ignore[arg-type]


def test_sizes() -> None:
    assert parse_size("640x360") == parse_size(" 640 X 360 ") == (640, 360)
    for text in ("640", "640x", "x", "-1x5", "1e3x5", "0x1", "640x360x3", "1234567x1"):
        with pytest.raises(UsageError):
            parse_size(text)


def test_overrides_leave_the_document_as_it_is() -> None:
    document = {"image": {"width": 1, "height": 2}, "sampling": {"seed": 3}}
    assert override(document, samples=4, size="5x6") == {
        "image": {"width": 5, "height": 6},
        "sampling": {"seed": 3, "samples": 4},
    }
    assert document == {"image": {"width": 1, "height": 2}, "sampling": {"seed": 3}}
    assert override({"image": 5}, samples=1, size="5x6") == {
        "image": {"width": 5, "height": 6},
        "sampling": {"samples": 1},
    }
