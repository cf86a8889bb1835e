"""Where the CPU of a service goes while it renders one job: by stage of the job and by kind of process.

Job: look at the processes of the service twenty times a second, and split what they used at the times that the job's
report names.
Invariant: CPU is that of /proc (all processes below the service's), in ticks of 10 ms; CPU in kernels is what the
threads that render measured of themselves, so other load on the machine does not count as ours.
"""

import threading
import time
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from benchmarks.machine import TICK_S

_EVERY_S = 0.05
_ROLES = {
    "worker.main worker": "workers",
    "worker.main assembler": "assembler",
    "worker.main steward": "steward",
    "uvicorn": "API",
    "valkey": "Valkey",
}

STAGES = ("to the first lease", "first lease to last tile", "last tile to success", "success to both files")


class CpuSampler:
    """Samples the CPU seconds of a service's processes, by role, while the block runs.

    Parameters
    ----------
    root : int
        Process id of the service.
    """

    def __init__(self, root: int) -> None:
        self._roles = _roles_below(root)
        self._samples: list[tuple[float, dict[str, float]]] = []
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cpu-sampler", daemon=True)

    def __enter__(self) -> Self:
        self._samples.append((time.time(), self._look()))
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._thread.join()
        self._samples.append((time.time(), self._look()))

    def _run(self) -> None:
        while not self._stopped.wait(_EVERY_S):
            self._samples.append((time.time(), self._look()))

    def _look(self) -> dict[str, float]:
        used: dict[str, float] = {}
        for pid, role in self._roles.items():
            try:
                fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            used[role] = used.get(role, 0.0) + sum(int(field) for field in fields[11:15]) * TICK_S
        return used

    def between(self, begin: float, end: float) -> dict[str, float]:
        """Return the CPU seconds of each role between two times (seconds since the epoch), interpolated."""
        first, last = self._at(begin), self._at(end)
        return {role: round(last[role] - first.get(role, 0.0), 3) for role in last}

    def _at(self, moment: float) -> dict[str, float]:
        before = self._samples[0]
        for sample in self._samples:
            if sample[0] >= moment:
                share = (moment - before[0]) / (sample[0] - before[0]) if sample[0] > before[0] else 0.0
                share = min(1.0, max(0.0, share))
                return {
                    role: before[1].get(role, used) + share * (used - before[1].get(role, used))
                    for role, used in sample[1].items()
                }
            before = sample
        return self._samples[-1][1]


def split(sampler: CpuSampler, report: dict[str, Any], posted: float, succeeded: float, fetched: float) -> Any:
    """Return the stages of a job: wall seconds, CPU seconds outside kernels, and these by role.

    Parameters
    ----------
    sampler : CpuSampler
        Has run from before the POST.
    report : dict
        Of the job.
    posted, succeeded, fetched : float
        Seconds since the epoch: before the POST, when the client knew of the success, when both files were here.

    Returns
    -------
    dict
        Name of the stage -> {"wall_s", "outside_kernels_s", "by_process"}; in the second stage the workers' kernel time
        is taken off.
    """
    edges = [posted, _epoch(report["first_lease_at"]), _epoch(report["last_tile_at"]), succeeded, fetched]
    stages = {}
    for name, begin, end in zip(STAGES, edges[:-1], edges[1:], strict=True):
        by_process = sampler.between(begin, end)
        if name == STAGES[1]:
            by_process["workers"] = round(by_process.get("workers", 0.0) - float(report["kernel_cpu_s"]), 3)
        stages[name] = {
            "wall_s": round(end - begin, 3),
            "outside_kernels_s": round(sum(by_process.values()), 3),
            "by_process": {role: used for role, used in by_process.items() if used},
        }
    return stages


def _epoch(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def _roles_below(root: int) -> dict[int, str]:
    """Return the role of each process below the service's."""
    parents: dict[int, int] = {}
    commands: dict[int, str] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                commands[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
            except OSError:
                continue
    roles = {}
    for pid, command in commands.items():
        ancestor = pid
        while ancestor not in {0, root}:
            ancestor = parents.get(ancestor, 0)
        if ancestor == root:
            roles[pid] = next((role for text, role in _ROLES.items() if text in command), "supervisor")
    return roles
