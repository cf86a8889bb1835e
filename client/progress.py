"""Progress of a render on standard error: a live bar on a terminal, a line now and then elsewhere.

Invariant: in a pipe no control code is written, and at most one line for each change of state or `LINE_EVERY_S`.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from client.formats import format_count, format_duration
from client.models import Progress
from client.terminal import is_live

LINE_EVERY_S = 5.0
SPEED_WINDOW_S = 3.0  # rays per second over this time, where the service does not tell


class ProgressView(Protocol):
    """Where a command reports how far its job is."""

    def update(self, state: str, progress: Progress) -> None:
        """Show the state and progress as of now."""


class Silent:
    """Shows nothing."""

    def update(self, state: str, progress: Progress) -> None:
        """Ignore it."""


class Speedometer:
    """Rays per second over the last seconds, from counts; a service that tells its own speed is believed.

    Parameters
    ----------
    clock : callable
        Seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._points: list[tuple[float, int]] = []

    def rays_per_s(self, progress: Progress) -> float | None:
        """Return the speed with this progress; None while unknown."""
        now = self._clock()
        self._points.append((now, progress.rays))
        while len(self._points) > 2 and now - self._points[0][0] > SPEED_WINDOW_S:
            self._points.pop(0)
        if progress.rays_per_s is not None:
            return progress.rays_per_s
        (first_s, first_rays), (last_s, last_rays) = self._points[0], self._points[-1]
        if last_s - first_s < 0.2 or last_rays <= first_rays:
            return None
        return (last_rays - first_rays) / (last_s - first_s)


def describe(state: str, progress: Progress, speed: float | None, unit: str = "tiles") -> str:
    """Return one line: state, tiles, speed, time to go."""
    parts = [state]
    if progress.tiles_total:
        parts.append(f"{progress.tiles_done}/{progress.tiles_total} {unit} ({100 * progress.fraction:.0f} %)")
    if speed:
        parts.append(format_count(speed, "rays/s"))
    if progress.eta_s is not None and state == "rendering":
        parts.append(f"{format_duration(progress.eta_s)} to go")
    return ", ".join(parts)


class Lines:
    """Plain lines for logs and pipes."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, unit: str = "tiles") -> None:
        self._clock = clock
        self._unit = unit
        self._speedometer = Speedometer(clock)
        self._state = ""
        self._printed_at = float("-inf")

    def update(self, state: str, progress: Progress) -> None:
        """Print a line when the state is new or the last line is old."""
        speed = self._speedometer.rays_per_s(progress)
        now = self._clock()
        if state == self._state and now - self._printed_at < LINE_EVERY_S:
            return
        self._state, self._printed_at = state, now
        print(describe(state, progress, speed, self._unit), file=sys.stderr, flush=True)  # noqa: T201


@contextmanager
def show_progress(label: str, *, quiet: bool = False, unit: str = "tiles") -> Iterator[ProgressView]:
    """Show progress while the block runs.

    Parameters
    ----------
    label : str
        What is rendered.
    quiet : bool
        Show nothing.
    unit : str
        What is counted.
    """
    if quiet:
        yield Silent()
    elif is_live(sys.stderr):
        with _live_bar(label, unit) as view:
            yield view
    else:
        yield Lines(unit=unit)


@contextmanager
def _live_bar(label: str, unit: str) -> Iterator[ProgressView]:
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bars

    speedometer = Speedometer()
    bars = Bars(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TextColumn("{task.fields[tiles]}", markup=False),
        TextColumn("{task.fields[speed]}", markup=False),
        TextColumn("{task.fields[eta]}", markup=False),
        console=Console(stderr=True),
        refresh_per_second=8,
    )
    task = bars.add_task(label, total=1.0, tiles="", speed="", eta="")

    class Bar:
        def update(self, state: str, progress: Progress) -> None:
            speed = speedometer.rays_per_s(progress)
            tiles = f"{progress.tiles_done}/{progress.tiles_total} {unit}" if progress.tiles_total else ""
            remaining = progress.eta_s if state == "rendering" else None
            bars.update(
                task,
                description=f"{label} {state}".strip(),
                completed=1.0 if state == "succeeded" else progress.fraction,
                tiles=tiles,
                speed=format_count(speed, "rays/s") if speed else "",
                eta=f"{format_duration(remaining)} to go" if remaining is not None else "",
            )

    with bars:
        yield Bar()
