"""The rows of `benchmarks.jobs` that are about processes: start, first compilation, two workers against one.

Invariants: wall time, from before the process is started; CPU seconds of the process and its children beside it;
modules come from bytecode, as after an installation, whatever the environment says of writing it.
"""

import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.cornell import cornell_box
from benchmarks.data import REPOSITORY
from benchmarks.machine import describe_machine, machine_line
from client.api import Client, require_success
from client.launch import service
from tracer.native.key import kernel_key

# Prints seconds of each step as JSON; what `smalti render` does, in its order.
_STEPS = """
import json, sys, time
start = time.perf_counter()
from pathlib import Path
import typer
import client.assets, client.cli, client.local
from tracer.film.writer import FilmWriter
from tracer.native.warm import warm
from tracer.render import render_scene
from tracer.scene import parse_scene
import OpenImageIO
imported = time.perf_counter()
warm()
loaded = time.perf_counter()
film = render_scene(parse_scene(open(sys.argv[1], "rb").read()), None, threads=1)
rendered = time.perf_counter()
_, _, width, height = film.window
with FilmWriter(None, Path(sys.argv[2]), width, height) as writer:
    writer.write_rows(film.pixels)
    writer.close()
written = time.perf_counter()
seconds = {"import_s": imported - start, "kernels_s": loaded - imported}
print(json.dumps({**seconds, "render_s": rendered - loaded, "write_s": written - rendered}))
"""
_WAIT_S = 60
_WORKERS = ("one", "two")


def timed(command: list[str], **variables: str) -> tuple[float, float, str]:
    """Run a command of the repository; returns (wall seconds, CPU seconds, what it printed).

    Raises
    ------
    subprocess.CalledProcessError
        It failed.
    """
    environment = {**os.environ, **variables}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True)
    wall_s = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, cpu_s, done.stdout


def measure_start(repeats: int, peer: str | None) -> list[dict[str, Any]]:
    """Measure a 64 x 64 picture from process start, kernels compiled; ours, through the service, and the peer's."""
    steps: dict[str, list[float]] = {"import_s": [], "kernels_s": [], "render_s": [], "write_s": []}
    answers: list[float] = []
    walls: dict[str, list[tuple[float, float]]] = {"render": [], "submit": [], "mitsuba": []}
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "scene.json")
        document = cornell_box(64, 64, 4)
        scene.write_text(json.dumps(document))
        bytecode = {
            "PYTHONPYCACHEPREFIX": str(Path(folder, "bytecode"))
        }  # written in the first turn, which is not told
        smalti = [sys.executable, "-m", "client"]
        with service(workers=1) as running, Client(running.url) as client:
            for turn in range(repeats + 1):
                target = str(Path(folder, f"{turn}.png"))
                runs = {
                    "render": [*smalti, "render", str(scene), "-o", target, "-q"],
                    "submit": [*smalti, "submit", str(scene), "--wait", "-q", "--url", running.url],
                }
                if peer:
                    runs["mitsuba"] = [peer, str(REPOSITORY / "benchmarks" / "peer_mitsuba.py"), "--start"]
                for name, command in runs.items():
                    wall_s, cpu_s, _ = timed(command, **bytecode)
                    if turn:
                        walls[name].append((wall_s, cpu_s))
                told = json.loads(timed([sys.executable, "-c", _STEPS, str(scene), target], **bytecode)[2])
                posted = time.perf_counter()
                require_success(client.submit(document, prefer_wait_s=_WAIT_S))
                if turn:
                    answers.append(time.perf_counter() - posted)
                    for name, seconds in told.items():
                        steps[name].append(seconds)
    labels = {
        "render": "`smalti render`, 64 x 64, from process start",
        "submit": "`smalti submit --wait` to a running service",
        "mitsuba": "Mitsuba `scalar_rgb`, 64 x 64, from process start",
    }
    rows: list[dict[str, Any]] = [
        {
            "what": labels[name],
            "wall_s": statistics.median(wall for wall, _ in found),
            "cpu_s": statistics.median(cpu for _, cpu in found),
        }
        for name, found in walls.items()
        if found
    ]
    rows[0] |= {name: statistics.median(seconds) for name, seconds in steps.items()}
    rows[1]["answer_s"] = statistics.median(answers)
    return rows


def measure_compile() -> list[dict[str, Any]]:
    """Measure the first compilation of all kernels, which is what `make demo` needs, into an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        wall_s, cpu_s, _ = timed([sys.executable, "-m", "client", "warm"], SMALTI_CACHE=cache)
        n_bytes = sum(path.stat().st_size for path in Path(cache).glob("**/*.image"))
        again_s, again_cpu_s, _ = timed([sys.executable, "-m", "client", "warm"], SMALTI_CACHE=cache)
    cold = {"what": "`smalti warm`, empty SMALTI_CACHE", "wall_s": wall_s, "cpu_s": cpu_s}
    return [
        {**cold, "image_bytes": n_bytes},
        {"what": "`smalti warm` again", "wall_s": again_s, "cpu_s": again_cpu_s},
    ]


def rendering_s(client: Client, samples: int, seed: int) -> tuple[float, float]:
    """Render a 512 x 512 Cornell box through a service; (seconds from first lease to last tile, kernel seconds)."""
    job = client.submit(cornell_box(512, 512, samples, seed=seed))
    require_success(client.wait(job.id))
    report = client.report(job.id)
    client.delete(job.id)
    return float(report["seconds"]["first_lease_to_last_tile"]), float(report["kernel_s"])


def turns_so_far(kept: Path, job: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the turns of a run that was interrupted: of this very job and these kernels, else none."""
    found: dict[str, Any] = json.loads(kept.read_text()) if kept.is_file() else {}
    turns: list[dict[str, Any]] = found.get("turns", []) if found.get("job") == job else []
    return turns


def measure_workers(repeats: int, kernel_s: float, kept: Path) -> list[dict[str, Any]]:
    """Measure two workers against one, in turns, on a job of at least ``kernel_s`` seconds in kernels.

    Each turn is printed and kept in a file, so that a run that was interrupted goes on where it was; the file is
    deleted at the end.
    """
    job = {"kernel_s": kernel_s, "kernels": kernel_key(), "machine": machine_line(describe_machine())}
    turns = turns_so_far(kept, job)
    while len(turns) < repeats:
        samples = turns[0]["samples"] if turns else 0
        turn: dict[str, Any] = {}
        for workers, name in enumerate(_WORKERS, start=1):
            with service(workers=workers) as running, Client(running.url, timeout_s=900.0) as client:
                rendering_s(client, 1, 0)  # the workers load their kernels
                if samples == 0:
                    samples = max(1, math.ceil(16 * 1.1 * kernel_s / rendering_s(client, 16, 0)[1]))
                turn[f"{name}_s"], turn[f"kernel_{name}_s"] = rendering_s(client, samples, len(turns) + 1)
        turns.append({**turn, "samples": samples})
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        part.write_text(json.dumps({"job": job, "turns": turns}, indent=1) + "\n")
        part.replace(kept)
        print(f"workers, turn {len(turns)} of {repeats}: {json.dumps(turns[-1])}", flush=True)
    turns = turns[:repeats]
    kept.unlink(missing_ok=True)
    names = [f"{of}{name}_s" for of in ("", "kernel_") for name in _WORKERS]
    columns = {name: [turn[name] for turn in turns] for name in names}
    ratio = statistics.median(turn["one_s"] / turn["two_s"] for turn in turns)
    return [{"what": "two workers against one", "samples": turns[0]["samples"], "ratio": ratio, **columns}]
