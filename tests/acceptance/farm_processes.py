"""A real farm for tests of faults: real processes, a real Valkey, the fake renderer (or the real one by name)."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tracer.scene import parse_scene
from worker import jobs
from worker.audit import audit
from worker.records import JobEvent
from worker.settings import FarmSettings
from worker.states import TERMINAL
from worker.supervisor import Supervisor


class RealFarm:
    """A supervisor and what tests do to its children."""

    def __init__(self, supervisor: Supervisor) -> None:
        self.supervisor = supervisor
        self.store, self.queue = supervisor.store, supervisor.queue

    def submit(self, title: str, width: int = 256, height: int = 192, *, tile_size: int = 32, **options: Any) -> str:
        scene = parse_scene(
            {
                "version": 1,
                "name": title,
                "camera": {"type": "perspective", "fov_deg": 40},
                "image": {"width": width, "height": height},
                "sampling": {"samples": 2, "seed": 7},
            }
        )
        output = {"tile_size": tile_size}
        return jobs.submit(self.store, self.queue, scene, owner="me", output=output, **options).job_id

    def wait(self, job_id: str, timeout_s: float = 40.0) -> JobEvent:
        """Return the event that ends a job."""
        return self.until(lambda: self._end(job_id), timeout_s, lambda: self.history(job_id))

    def _end(self, job_id: str) -> JobEvent | None:
        event = self.store.last_event(job_id)
        return event if event.state in TERMINAL else None

    def history(self, job_id: str) -> list[str]:
        return [f"{e.at[14:23]} {e.type} {e.state} {e.by} {e.detail}" for e in self.store.events(job_id)]

    def until(self, look: Callable[[], Any], timeout_s: float = 20.0, explain: Callable[[], Any] = lambda: "") -> Any:
        """Return what `look` returns once it is true."""
        deadline = time.monotonic() + timeout_s
        while True:
            found = look()
            if found:
                return found
            assert time.monotonic() < deadline, explain()
            time.sleep(0.005)

    def until_done(self, job_id: str, n_tiles: int) -> None:
        """Wait until some tiles are on disk."""
        self.until(lambda: len(self.store.done_tiles(job_id)) >= n_tiles, explain=lambda: self.history(job_id))

    def kill(self, name: str, number: int = signal.SIGKILL) -> int:
        """Send a signal to a child and return its process id."""
        pid = self.supervisor.pid(name)
        os.kill(pid, number)
        return pid

    def assert_sound(self) -> None:
        """The audit finds nothing, once the last hands are off."""
        findings: list[str] = []

        def look() -> bool:
            findings[:] = audit(self.store, self.queue)
            return not findings

        self.until(look, 8.0, lambda: findings)


@contextmanager
def running_farm(folder: Path, **settings: Any) -> Iterator[RealFarm]:
    """Start a farm and end it."""
    options: dict[str, Any] = {"workers": 2, "api": False, "backend": "fake", "nice": 0, **settings}
    if options["backend"] == "fake":
        options["cache"] = folder / "cache"  # the real one keeps this host's: its kernels are compiled there
    configured = FarmSettings(store=folder / "store", log_file=folder / "farm.log", **options)
    with Supervisor(configured) as supervisor:
        yield RealFarm(supervisor)
