"""``make mini``: the MINI in the Cornell box, 3840 x 2160, 16 samples, through HTTP and the worker pool.

Job: five times, start a service with two workers, submit ``scenes/mini-cornell.json``, write ``out/mini.png`` and
``out/mini.exr``; of the median run the page ``benchmarks/results/mini.md`` with ``mini.json`` and a reduced picture;
say where the time outside the kernels went, by stage.
Invariant: the page speaks of one fixed document, named by its SHA-256; a run of another size or number of samples
(``--size``, ``--samples``: to try things) writes to ``out/`` alone.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.data import DATA, REPOSITORY, MissingDataError, seed_file
from benchmarks.machine import describe_machine, machine_line
from benchmarks.stages import CpuSampler, split
from client.api import Client, require_success
from client.assets import prepare_scene, read_scene, sha256_file
from client.errors import SmaltiError
from client.formats import format_bytes, format_count, format_duration
from client.launch import service
from client.options import override
from client.progress import show_progress
from client.report import SKIPPED_NAMES, print_report
from client.terminal import Terminal

SCENE = REPOSITORY / "scenes" / "mini-cornell.json"
SCENE_SHA256 = "7e9db5a2e11b48c933d7fb87fabb26085ec5c29fcd7b140acb4868c3c23249cb"
"""Of the file. Later measurements are of this same document; whoever changes it starts a new series."""

RESULTS = REPOSITORY / "benchmarks" / "results"
OUT = REPOSITORY / "out"
LONGEST_S = 120.0
REDUCED_PX = (960, 540)
RUNS = 5

ORIGINAL_MS_A_SAMPLE = 0.6
ORIGINAL_TRIANGLES = 22
"""The original program took 0.6 ms a sample with 22 triangles, each of which it tested for each ray."""


def original_cost_s(samples: int, triangles: int) -> float:
    """Return the seconds that the original program would take, its cost growing with every triangle."""
    return samples * ORIGINAL_MS_A_SAMPLE / 1000.0 * triangles / ORIGINAL_TRIANGLES


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Render the MINI through HTTP and the worker pool.")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=RUNS, help="the page is of the median one (default: %(default)s)")
    parser.add_argument("--size", metavar="WxH", help="another size: no result page")
    parser.add_argument("--samples", type=int, help="another number of samples: no result page")
    return parser.parse_args()


def render(options: argparse.Namespace, terminal: Terminal) -> dict[str, Any]:
    """Render through a service of its own; return what the page needs."""
    document, folder = read_scene(SCENE)
    prepared = prepare_scene(override(document, samples=options.samples, size=options.size), folder)
    for warning in prepared.warnings:
        terminal.warn(warning)
    terminal.note("starting the service")
    with service(workers=options.workers) as running, Client(running.url) as client:
        with CpuSampler(running.pid) as sampler:
            posted = time.time()
            job = client.submit(prepared)
            with show_progress("mini") as view:
                for seen in client.watch(job.id):
                    job = seen
                    view.update(job.state, job.progress)
            require_success(job)
            succeeded = time.time()
            png, exr = OUT / "mini.png", OUT / "mini.exr"
            client.get(job.id, png)
            client.get(job.id, exr)
            fetched = time.time()
        report = client.report(job.id)
    print_report(terminal, report)
    return {
        "scene_file_sha256": sha256_file(SCENE),
        "png_sha256": sha256_file(png),
        "exr_sha256": sha256_file(exr),
        "post_to_files_s": round(fetched - posted, 3),
        "stages": split(sampler, report, posted, succeeded, fetched),
        "report": report,
        "machine": describe_machine(),
    }


def rendering_s(result: dict[str, Any]) -> float:
    """Return the seconds from the first lease to the last tile."""
    return float(result["report"]["seconds"]["first_lease_to_last_tile"])


def render_median(options: argparse.Namespace, terminal: Terminal) -> dict[str, Any]:
    """Render as often as asked for, a service each; return the median run, and how long each took."""
    runs = sorted((render(options, terminal) for _ in range(options.runs)), key=rendering_s)
    return {**runs[(len(runs) - 1) // 2], "runs_s": [rendering_s(run) for run in runs]}


def rows_of(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the page's table."""
    report = result["report"]
    rays, image = report["rays"], report["image"]
    samples = image["width"] * image["height"] * report["samples"]
    triangles, took_s = report["triangles"] or 0, rendering_s(result)
    original_s = original_cost_s(samples, triangles)
    rows = [
        ("scene", f"`scenes/mini-cornell.json`, SHA-256 `{result['scene_file_sha256']}`"),
        (
            "picture",
            f"{image['width']} x {image['height']}, {report['samples']} samples a pixel, {triangles} triangles",
        ),
        (
            "**first lease to last tile**",
            f"**{took_s:.2f} s**, median of {', '.join(f'{s:.2f}' for s in result['runs_s'])}",
        ),
        ("from POST to both files here", f"{result['post_to_files_s']:.2f} s"),
        (
            "kernel seconds",
            f"{report['kernel_s']:.1f} on {len(report['tiles']['workers'])} workers; CPU {report['kernel_cpu_s']:.1f}",
        ),
        *[
            (
                f"{name}: wall, CPU outside kernels",
                f"{stage['wall_s']:.2f} s, {stage['outside_kernels_s']:.2f} s"
                + "".join(f"; {role} {used:.2f}" for role, used in stage["by_process"].items() if used >= 0.005),
            )
            for name, stage in result["stages"].items()
        ],
        ("rays per sample", f"{rays['per_sample']:.3f}"),
        ("rays", ", ".join(f"{format_count(rays[name])} {name[:-5]}" for name in rays if name.endswith("_rays"))),
        (
            "speed",
            f"{format_count(rays['per_s'], 'rays/s')}, {format_count(samples / took_s, 'samples/s')}",
        ),
        ("tiles", f"{report['tiles']['n']} of {report['tiles']['size']} px"),
    ]
    rows += [
        (f"skipped: {SKIPPED_NAMES.get(name, name)}", format_count(value)) for name, value in report["skipped"].items()
    ]
    rows += [
        ("compiled scene", format_bytes(report["bytes"].get("compiled_scene") or 0)),
        ("film_sha256", f"`{report['film_sha256']}`"),
        (
            "original program, computed",
            f"{format_duration(original_s)}: {format_count(samples)} samples x 0.6 ms x {triangles} / 22 triangles",
        ),
        ("times faster", f"{original_s / took_s:,.0f}"),
    ]
    return rows


def write_page(result: dict[str, Any], folder: Path) -> None:
    """Write mini.md, mini.json and the reduced picture (beside the picture itself when trying)."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "# The MINI in the Cornell box",
        "",
        "`make mini` renders it through HTTP and a pool of two workers. The original program would have taken about",
        "half a year for this picture; its report says that it never finished.",
        "",
        "| | |",
        "|---|---|",
        *[f"| {name} | {value} |" for name, value in rows_of(result)],
        "",
        f"Machine: {machine_line(result['machine'])}.",
        "",
        "![the MINI in the Cornell box, reduced](mini-960x540.png)",
    ]
    (folder / "mini.md").write_text("\n".join(lines) + "\n")
    (folder / "mini.json").write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")
    with Image.open(OUT / "mini.png") as picture:
        picture.resize(REDUCED_PX, Image.Resampling.BOX).save(folder / "mini-960x540.png", optimize=True)


def main() -> int:
    """Render, write the page, judge."""
    options = parse_arguments()
    terminal = Terminal()
    os.environ.setdefault("SMALTI_DATA", str(DATA))
    is_whole = options.size is None and options.samples is None
    try:
        seed_file("mini_geometry.json")
        if is_whole and sha256_file(SCENE) != SCENE_SHA256:
            terminal.warn(f"{SCENE.name} has SHA-256 {sha256_file(SCENE)}; this page is of {SCENE_SHA256}")
            return 3
        result = render_median(options, terminal)
    except MissingDataError as error:
        print(error, file=sys.stderr)
        return 3
    except SmaltiError as error:
        terminal.error(error)
        return int(error.exit_code)
    report = result["report"]
    seconds = rendering_s(result)
    terminal.out(f"first lease to last tile: {seconds:.2f} s; rays per sample: {report['rays']['per_sample']:.3f}")
    for name, stage in result["stages"].items():
        terminal.out(f"{name}: {stage['wall_s']:.2f} s, CPU outside kernels {stage['outside_kernels_s']:.2f} s")
    terminal.out(f"POST to both files: {result['post_to_files_s']:.2f} s")
    write_page(result, RESULTS if is_whole else OUT)
    if is_whole and seconds > LONGEST_S:
        terminal.warn(f"slower than {LONGEST_S:.0f} s")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
