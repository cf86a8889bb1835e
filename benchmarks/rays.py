"""``make bench-rays``: rays per second of `RayCaster` beside Embree (the ``embreex`` wheel, its default robust mode).

    python -m benchmarks.rays [--meshes cornell,sphere-80k,...] [--kinds primary,...] [--rays 1000000] [--repeats 5]
        [--small]

Five meshes in boxes; primary rays in scan order, cosine-distributed bounces from where they hit, and shadow rays to a
point light. t, primitive, u and v are returned by both. Both take turns in one process, each run is measured in CPU
time of the process, and the median of the runs counts. Turns in which others use the same core are taken again
(`taking_turns`).

Builds are timed in a fresh process each (`benchmarks.rays_build`), in turn, in CPU time, against Embree's commit alone:
so both pay for fresh memory. The seconds spent in the program alone stand beside the sum, because what the system takes
for a page varies more between runs than all else. Memory is what the process grows by; for us also the tree's size.

Two threads, of a build and of rays, are timed by the clock against one, in turn, in memory that the process has touched
before (whether fresh pages come large or small decides more than the second thread does), and the least of each counts.
The processor time of both stands beside it: what the second thread costs.

Writes ``benchmarks/results/rays.json``, ``.md``, ``.png``, ``.svg`` where all is measured at full size, else into
``out/``. Needs ``embreex``: ``pip install smalti[bench]``, or SMALTI_EMBREE names a folder of packages that has it.
"""

import argparse
import contextlib
import ctypes
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import metadata
from typing import Any

import numpy as np

from benchmarks.data import REPOSITORY
from benchmarks.machine import describe_machine
from benchmarks.rays_build import EMBREE, build_embree, find_embree
from benchmarks.rays_meshes import MESHES, Mesh, primary_rays, secondary_rays
from benchmarks.rays_page import KINDS, write_page
from tracer.rays import RayCaster

_QUIET = 1.2  # times the least yardstick


def cpu_seconds(work: Callable[[], Any]) -> float:
    """Time one call in this process's CPU time."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _yardstick() -> float:
    """Time a loop that is always the same: how much of a core there is, beside its other tenants."""
    return cpu_seconds(lambda: sum(range(200_000)))


def taking_turns(first: Callable[[], Any], second: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Return the medians of both, run in turn; the first turn does not count.

    Others who use the same core, as they do on rented machines, slow the two by different factors. So a turn is taken
    again where a yardstick beside it took much longer than at best, up to three times as many in all, and those count
    where it was shortest.
    """
    first()
    second()
    best = min(_yardstick() for _ in range(20))
    turns: list[tuple[float, float, float]] = []
    while len(turns) < 3 * repeats and sum(turn[0] <= _QUIET * best for turn in turns) < repeats:
        before, one, between, other = _yardstick(), cpu_seconds(first), _yardstick(), cpu_seconds(second)
        turns.append((max(before, between, _yardstick()), one, other))
    _, ones, others = zip(*sorted(turns)[:repeats], strict=True)
    return statistics.median(ones), statistics.median(others)


@contextlib.contextmanager
def memory_kept() -> Iterator[None]:
    """Have freed memory used again, not handed back to the system, where the C library is glibc."""
    try:
        option = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library: the figures are less steady
        yield
        return
    mmap_max, trim_threshold = -4, -1
    option(mmap_max, 0)
    option(trim_threshold, 2**31 - 1)
    try:
        yield
    finally:
        option(mmap_max, 65536)
        option(trim_threshold, 128 * 1024)


def one_and_two_threads(work: Callable[[int], Any], repeats: int) -> dict[str, float]:
    """Time work(threads) with one and with two: the least times by the clock, and the processor's medians."""
    clock: dict[int, list[float]] = {1: [], 2: []}
    processor: dict[int, list[float]] = {1: [], 2: []}
    with memory_kept():
        work(2)
        for _ in range(repeats):
            for threads in (1, 2):
                start, start_cpu = time.perf_counter(), time.process_time()
                work(threads)
                clock[threads].append(time.perf_counter() - start)
                processor[threads].append(time.process_time() - start_cpu)
    return {
        "one_thread_clock_s": min(clock[1]),
        "two_threads_clock_s": min(clock[2]),
        "one_thread_cpu_s": statistics.median(processor[1]),
        "two_threads_cpu_s": statistics.median(processor[2]),
        "two_threads": min(clock[1]) / min(clock[2]),
    }


def build_once(who: str, mesh: str) -> dict[str, float]:
    """Build in a fresh process; what `benchmarks.rays_build` prints."""
    command = [sys.executable, "-m", "benchmarks.rays_build", who, mesh]
    done = subprocess.run(command, cwd=REPOSITORY, check=True, stdout=subprocess.PIPE, text=True)
    told: dict[str, float] = json.loads(done.stdout)
    return told


def measure_build(name: str, mesh: Mesh, repeats: int) -> dict[str, Any]:
    """Return the row of a mesh's builds."""
    runs: dict[str, list[dict[str, float]]] = {"ours": [], "embree": []}
    build_once("ours", name)  # whose kernels may have to be compiled
    for _ in range(repeats):
        for who, told in runs.items():
            told.append(build_once(who, name))
    row: dict[str, Any] = {"mesh": name, "work": "build", "count": len(mesh[1])}
    for who, told in runs.items():
        row[f"{who}_s"] = statistics.median(run["user_s"] + run["system_s"] for run in told)
        row[f"{who}_user_s"] = statistics.median(run["user_s"] for run in told)
        row[f"{who}_resident_bytes"] = statistics.median(run["resident_bytes"] for run in told)
    row["tree_bytes"] = RayCaster(*mesh).bvh.n_bytes
    return row | one_and_two_threads(lambda threads: RayCaster(*mesh, threads=threads), repeats)


def measure_rays(name: str, mesh: Mesh, n_rays: int, repeats: int, kinds: list[str]) -> Iterator[dict[str, Any]]:
    """Yield a row a kind of rays."""
    caster, embree = RayCaster(*mesh), build_embree(mesh)()
    eyes, views = primary_rays(n_rays)
    points, bounces, to_light = secondary_rays(mesh, caster, eyes, views)
    ones = np.ones(len(points), np.float32)
    for work in kinds:
        if work == "shadow":
            origins = points
            cast: Callable[..., Any] = partial(caster.any_hit, points, to_light, 0.0, 1.0)
            run = partial(embree.run, points, to_light, ones, query="OCCLUDED")
            agree = float(((run() >= 0) == cast()).mean())
        else:
            origins, directions = (eyes, views) if work == "primary" else (points, bounces)
            cast = partial(caster.closest_hit, origins, directions)
            run = partial(embree.run, origins, directions, query="INTERSECT", output=1)
            agree = float((run()["primID"] == cast().primitive).mean())
        ours, theirs = taking_turns(cast, run, repeats)
        row = {"mesh": name, "work": work, "count": len(origins), "ours_s": ours, "embree_s": theirs, "agree": agree}
        yield row | one_and_two_threads(lambda threads, c=cast: c(threads=threads), repeats)


def line_of(row: dict[str, Any]) -> str:
    """Return a row as a line for the terminal."""
    million = row["count"] / 1e6
    ours, theirs = million / row["ours_s"], million / row["embree_s"]
    said = f"{row['tree_bytes'] / row['count']:.1f} bytes a triangle" if row["work"] == "build" else ""
    said = said or f"same answer {row['agree']:.6f}"
    return (
        f"{row['mesh']:12s} {row['work']:8s} {ours:7.2f} M/s, Embree {theirs:7.2f} M/s: {ours / theirs:5.2f} x, "
        f"2 threads {row['two_threads']:.2f} x by the clock for "
        f"{row['two_threads_cpu_s'] / row['one_thread_cpu_s']:.2f} x the processor time, {said}"
    )


def main() -> int:
    """Measure, print the rows, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", default=",".join(MESHES))
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kinds", default=",".join(("build", *KINDS)))
    parser.add_argument("--small", action="store_true", help="to try the script: two meshes, few rays, pages into out/")
    options = parser.parse_args()
    meshes = ["cornell", "sphere-80k"] if options.small else options.meshes.split(",")
    kinds = options.kinds.split(",")
    for given, known, what in ((meshes, list(MESHES), "--meshes"), (kinds, ["build", *KINDS], "--kinds")):
        if not set(given) <= set(known):
            parser.error(f"{what} {','.join(given)}: expected some of {','.join(known)}")
    n_rays, repeats = (40_000, 2) if options.small else (options.rays, options.repeats)
    whole = set(meshes) == set(MESHES) and set(kinds) == {"build", *KINDS} and n_rays >= 1_000_000 and repeats >= 5
    find_embree()
    try:
        version = metadata.version("embreex")
    except metadata.PackageNotFoundError:
        parser.error(f"embreex is not here: pip install smalti[bench], or {EMBREE}=FOLDER that has it")
    rows = []
    for name in meshes:
        mesh = MESHES[name]()
        if "build" in kinds:
            rows.append(measure_build(name, mesh, repeats))
            print(line_of(rows[-1]), flush=True)
        for row in measure_rays(name, mesh, n_rays, repeats, [kind for kind in kinds if kind in KINDS]):
            rows.append(row)
            print(line_of(row), flush=True)
    folder = REPOSITORY / ("benchmarks/results" if whole else "out")
    folder.mkdir(parents=True, exist_ok=True)
    result = {"machine": describe_machine(), "embreex": version, "rays": n_rays, "repeats": repeats, "rows": rows}
    (folder / "rays.json").write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")
    write_page(result, folder)
    print((folder / "rays.md").read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
