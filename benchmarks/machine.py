"""What a measurement ran on, and what it cost in CPU time: facts for the result pages.

Invariant: nothing that names a person, a host or a folder.
"""

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, and the versions that matter."""
    return {
        "processor": processor_name(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in ("smalti", "numba", "numpy")},
    }


def processor_name() -> str:
    """Return the processor's name as it tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    except OSError:
        pass
    return platform.machine()


def machine_line(machine: dict[str, Any]) -> str:
    """Return the facts as one line of text."""
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}, "
        f"numba {machine['numba']}, numpy {machine['numpy']}, smalti {machine['smalti']}"
    )


def tree_cpu_s(root: int) -> float:
    """Return the CPU seconds that a process and all below it have used so far (Linux).

    Those that have ended are counted with the parent that reaped them.
    """
    parents: dict[int, int] = {}
    used: dict[int, float] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it ended meanwhile; its parent has its time now, or will have
                continue
            pid = int(folder.name)
            parents[pid] = int(fields[1])
            used[pid] = sum(int(field) for field in fields[11:15]) * TICK_S
    total = 0.0
    for pid, seconds in used.items():
        ancestor = pid
        while ancestor not in {0, root}:
            ancestor = parents.get(ancestor, 0)
        total += seconds if ancestor == root else 0.0
    return total
