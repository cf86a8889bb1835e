"""``make bench-error``: error against seconds, by sampler.

Job: three scenes (edges, mirrors, textures) at 1, 2, 4, ... 256 samples by each sampler and several seeds, against a
reference of 4,096 samples; write ``benchmarks/results/error.csv``, ``error.png``, ``error.svg`` and ``error.md``.

Measure: RMSE of linear, unclamped radiance over all pixels and channels; seconds are CPU seconds of one core in the
kernel, compilation excluded. Invariant: the reference has seeds that no measured picture has; its own error is
estimated from its two halves and stated. It is cached in ``out/`` by the hash of what it depends on.
"""

import argparse
import csv
import hashlib
import json
import statistics
import sys
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.data import REPOSITORY

SCENES = {
    "edges": "seed/box-16xAA-directional-phong-shadows.json",
    "mirrors": "seed/box-16xAA-3xML-phong-shadows-reflections.json",
    "textures": "textures.json",
}
SAMPLERS = ("independent", "stratified", "sobol")
SIZE = (168, 96)  # 0.4 of the scenes' own size in each direction
COUNTS = tuple(2**k for k in range(9))
SEEDS = (1, 2, 3, 4, 5)
REFERENCE_SAMPLES = 4096
REFERENCE_SEED = 987654321
FIT_FROM = 8  # samples; below, the slope is not yet that of many samples
RESULTS = REPOSITORY / "benchmarks" / "results"


class Run(NamedTuple):
    """One picture's error."""

    scene: str
    sampler: str
    samples: int
    seed: int
    rmse: float
    cpu_s: float


def load(scene: str, samples: int, sampler: str, seed: int) -> dict[str, Any]:
    """Return a scene document with the size and sampling of a measurement."""
    doc: dict[str, Any] = json.loads((REPOSITORY / "scenes" / SCENES[scene]).read_text())
    doc["image"] = {"width": SIZE[0], "height": SIZE[1]}
    doc["sampling"] = {"samples": samples, "sampler": sampler, "seed": seed}
    return doc


def render(scene: str, samples: int, sampler: str, seed: int) -> tuple[NDArray[np.float64], float]:
    """Return a picture and its CPU seconds."""
    from benchmarks.local import compile_document, render_sums

    compiled = compile_document(load(scene, samples, sampler, seed), REPOSITORY / "scenes")
    return render_sums(compiled, *SIZE, samples)


def rmse(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the root-mean-square difference."""
    return float(np.sqrt(np.mean((a - b) ** 2)))


def kernel_hash() -> str:
    """Return a hash of the tracer's sources: a cached reference is of the same code."""
    digest = hashlib.sha256()
    for path in sorted((REPOSITORY / "tracer").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def reference(scene: str) -> tuple[NDArray[np.float64], float]:
    """Return the reference and the estimate of its error, from the cache or rendered by two threads.

    Two pictures of half the samples and different seeds are averaged; half of their RMS difference estimates the error
    of the mean (for independent halves it is its standard deviation).
    """
    half = REFERENCE_SAMPLES // 2
    docs = [load(scene, half, "sobol", REFERENCE_SEED + k) for k in range(2)]
    key = hashlib.sha256((json.dumps(docs) + kernel_hash()).encode()).hexdigest()[:16]
    path = REPOSITORY / "out" / f"reference-{scene}-{key}.npz"
    if path.is_file():
        with np.load(path) as saved:
            halves = saved["halves"]
    else:
        with ThreadPoolExecutor(2) as pool:
            jobs = [pool.submit(render, scene, half, "sobol", REFERENCE_SEED + k) for k in range(2)]
            halves = np.stack([job.result()[0] for job in jobs])
        path.parent.mkdir(exist_ok=True)
        np.savez_compressed(path, halves=halves)
    return halves.mean(axis=0), rmse(halves[0], halves[1]) / 2


def measure(scene: str, truth: NDArray[np.float64], seeds: tuple[int, ...]) -> list[Run]:
    """Return the runs of one scene, two at a time."""

    def one(sampler: str, samples: int, seed: int) -> Run:
        picture, seconds = render(scene, samples, sampler, seed)
        return Run(scene, sampler, samples, seed, rmse(picture, truth), seconds)

    with ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(one, s, n, seed) for n in reversed(COUNTS) for s in SAMPLERS for seed in seeds]
        return [job.result() for job in jobs]


class Curve(NamedTuple):
    """Medians over seeds of one scene and sampler."""

    samples: list[int]
    rmse: list[float]
    cpu_s: list[float]

    def slope(self) -> float:
        """Return the exponent p of RMSE ~ N^p, fitted from FIT_FROM samples on."""
        points = [(n, e) for n, e in zip(self.samples, self.rmse, strict=True) if n >= FIT_FROM]
        return float(np.polyfit(*np.log(np.array(points)).T, 1)[0])

    def seconds_to(self, error: float) -> float:
        """Return the seconds that reach an error, interpolated in logarithms; NaN where the curve does not reach it."""
        if not min(self.rmse) <= error <= max(self.rmse):
            return float("nan")
        order = np.argsort(self.rmse)
        return float(np.exp(np.interp(np.log(error), np.log(self.rmse)[order], np.log(self.cpu_s)[order])))


def medians(runs: list[Run]) -> dict[tuple[str, str], Curve]:
    """Return the curve of each scene and sampler."""
    groups: dict[tuple[str, str], dict[int, list[Run]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        groups[run.scene, run.sampler][run.samples].append(run)
    return {
        key: Curve(
            sorted(by_count),
            [statistics.median(run.rmse for run in by_count[n]) for n in sorted(by_count)],
            [statistics.median(run.cpu_s for run in by_count[n]) for n in sorted(by_count)],
        )
        for key, by_count in groups.items()
    }


def plot(curves: dict[tuple[str, str], Curve], floors: dict[str, float]) -> None:
    """Draw RMSE against seconds, one panel a scene."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "smalti"
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(SCENES), figsize=(14, 4.8), constrained_layout=True)
    styles = {"independent": ("o", "#b5542b"), "stratified": ("s", "#3a7d44"), "sobol": ("^", "#2f5d9b")}
    for panel, scene in zip(panels, SCENES, strict=True):
        for sampler in SAMPLERS:
            curve = curves[scene, sampler]
            marker, color = styles[sampler]
            label = f"{sampler}: N^{curve.slope():.2f}"
            panel.loglog(curve.cpu_s, curve.rmse, marker=marker, color=color, markersize=5, label=label)
        ends = curves[scene, SAMPLERS[0]]
        for k in (0, 4, 8):
            note = f"{ends.samples[k]}"
            panel.annotate(note, (ends.cpu_s[k], ends.rmse[k]), xytext=(4, 6), textcoords="offset points", fontsize=8)
        panel.axhline(floors[scene], color="#999999", linewidth=1, linestyle=":", label="error of the reference")
        panel.set_title(scene)
        panel.set_xlabel("CPU seconds in the kernel")
        panel.grid(visible=True, which="both", alpha=0.25)
        panel.legend(fontsize=9)
    panels[0].set_ylabel("RMSE, linear radiance")
    figure.suptitle(f"Error against seconds, {SIZE[0]} x {SIZE[1]} pixels, median of seeds; numbers: samples a pixel")
    figure.savefig(RESULTS / "error.png", dpi=110)
    figure.savefig(RESULTS / "error.svg", metadata={"Date": None})


def page(curves: dict[tuple[str, str], Curve], floors: dict[str, float], n_seeds: int) -> str:
    """Return the markdown page."""
    scenes = ", ".join(f"{name} = `scenes/{path}`" for name, path in SCENES.items())
    lines = [
        "# Error against seconds, by sampler",
        "",
        f"`make bench-error`: {SIZE[0]} x {SIZE[1]} pixels, {COUNTS[0]} to {COUNTS[-1]} samples a pixel, median of",
        f"{n_seeds} seeds, against {REFERENCE_SAMPLES:,} samples (two Sobol pictures of half as many and other seeds).",
        "RMSE of linear, unclamped radiance over all channels; seconds are CPU seconds of one core in the kernel,",
        "without compilation. All runs are in `error.csv`. Scenes:",
        f"{scenes}.",
        "",
        "![RMSE against seconds](error.png)",
        "",
        f"- *slope*: p of RMSE ~ N^p from {FIT_FROM} samples on; -0.5 is that of independent samples.",
        "- *equal error*: seconds of independent sampling at 256 samples, over the seconds in which this sampler has",
        "  the same RMSE.",
        "- *floor*: estimated error of the reference; numbers below three times the floor are not to be trusted.",
        "",
        "| scene | sampler | RMSE at 1 | at 4 | at 16 | at 64 | at 256 | slope | s at 256 | equal error | floor |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (scene, sampler), curve in sorted(curves.items()):
        base = curves[scene, "independent"]
        gain = base.cpu_s[-1] / curve.seconds_to(base.rmse[-1])
        errors = [f"{curve.rmse[curve.samples.index(n)]:.5f}" for n in (1, 4, 16, 64, 256)]
        cells = [scene, sampler, *errors, f"{curve.slope():.2f}", f"{curve.cpu_s[-1]:.2f}", f"{gain:.1f} x"]
        lines.append(f"| {' | '.join(cells)} | {floors[scene]:.5f} |")
    return "\n".join([*lines, "", verdict(curves)]) + "\n"


def verdict(curves: dict[tuple[str, str], Curve]) -> str:
    """Return which sampler has the smallest error at 16 samples and at most samples, scene by scene."""
    parts = []
    for samples in (16, COUNTS[-1]):
        at = COUNTS.index(samples)
        best = {scene: min(SAMPLERS, key=lambda s, scene=scene: curves[scene, s].rmse[at]) for scene in SCENES}
        parts.append(f"at {samples} samples " + ", ".join(f"{sampler} ({scene})" for scene, sampler in best.items()))
    return "Smallest error: " + "; ".join(parts) + "."


def main() -> int:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description="Error against seconds, by sampler.")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="number of seeds (median)")
    seeds = tuple(range(1, parser.parse_args().seeds + 1))
    start = time.perf_counter()
    render("edges", 1, "sobol", 0)  # compiles the kernels
    print(f"kernels ready: {time.perf_counter() - start:.1f} s", flush=True)
    runs: list[Run] = []
    floors = {}
    for scene in SCENES:
        begin = time.perf_counter()
        truth, floors[scene] = reference(scene)
        middle = time.perf_counter()
        runs += measure(scene, truth, seeds)
        end = time.perf_counter()
        n_pictures = len(SAMPLERS) * len(COUNTS) * len(seeds)
        print(f"{scene}: reference {middle - begin:.1f} s, {n_pictures} pictures {end - middle:.1f} s", flush=True)
    RESULTS.mkdir(exist_ok=True)
    with Path(RESULTS / "error.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Run._fields)
        writer.writerows((*run[:4], f"{run.rmse:.8g}", f"{run.cpu_s:.4f}") for run in sorted(runs))
    curves = medians(runs)
    plot(curves, floors)
    text = page(curves, floors, len(seeds))
    (RESULTS / "error.md").write_text(text)
    print("\n".join(line for line in text.splitlines() if line.startswith("|")))
    cpu_s = sum(run.cpu_s for run in runs)
    print("benchmarks/results/error.md, .csv, .png, .svg")
    print(f"{time.perf_counter() - start:.0f} s, pictures {cpu_s:.0f} CPU s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
