"""The report as tables: where the time went, what was skipped."""

import io
import sys
from typing import Any

import pytest

from client.report import SKIPPED_NAMES, print_report, skipped_rows, time_rows, work_rows
from client.terminal import Terminal
from tracer.types import COUNTERS

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
    assert "kernels" not in rows
    rows = dict(work_rows({**REPORT, "kernels_compile_s": 58.0}))
    assert rows["kernels"].startswith("compiled once, in 58.0 s")


def test_placements_are_told_where_there_are_several() -> None:
    assert "placements" not in dict(work_rows({**REPORT, "trees": 1, "placements": 1}))
    shared = {"trees": 2, "placements": 65, "bytes": {"compiled_scene": 6e5, "saved_by_sharing": 3.77e7}}
    rows = dict(work_rows({**REPORT, **shared}))
    assert rows["placements"] == "65 of 2 trees"
    assert rows["compiled scene"] == "600 kB; shared meshes save 37.7 MB"


def test_all_that_is_skipped_has_a_name() -> None:
    assert set(SKIPPED_NAMES) == {name for name in COUNTERS if "_skipped_" in name}


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


def test_an_audit_of_adaptive_sampling_is_told_where_there_was_one() -> None:
    assert not [row for row in work_rows(REPORT) if row[0] == "adaptive sampling"]
    assert not work_rows({"adaptive": {"blocks_audited": 0, "blocks_missed": 0}})
    [row] = work_rows({"adaptive": {"blocks_audited": 12, "blocks_missed": 3}})
    assert row[0] == "adaptive sampling"
    assert row[1].startswith("3 of 12 blocks")
