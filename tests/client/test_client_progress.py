"""Progress: a live bar on a terminal, now and then a line elsewhere."""

import io
import sys

import pytest

from client import progress as progress_module
from client.models import Progress
from client.progress import Lines, Speedometer, describe, show_progress


class FakeTerminal(io.StringIO):
    def isatty(self) -> bool:
        return True


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
