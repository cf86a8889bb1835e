"""``python -m benchmarks.adaptive``: what adaptive sampling gains, and what it would gain by other estimates.

Measure: RMSE of linear, unclamped radiance over all pixels and channels against a reference of other seeds; seconds are
CPU seconds of the kernel's thread, medians over seeds, all settings of a seed one after the other. Large pictures are
sampled: some blocks at random. Writes ``benchmarks/results/adaptive.json`` and ``adaptive.md``.

The feature is measured as it is (`sampling.adaptive` of the document). Beside it, estimates of a block's error from its
first samples, each of which has the same share of the blocks finished:

* ``contrast``: RMS difference of neighbouring pixels of the block, which the feature asks for.
* ``halves``: RMS over its pixels of half the difference of even and odd samples' means: its standard error.
* ``oracle``: the true gain, squared error of the first samples less that of all, which no picture can know.
"""

import argparse
import json
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrorbox
from benchmarks.data import REPOSITORY
from benchmarks.local import compile_document
from tracer.render import get_backend, list_blocks
from tracer.types import BLOCK_PX, COUNTERS, CompiledScene, FilmBlocks

FIRST = (2, 4)  # adaptive.min_samples; estimates are compared with the last
THRESHOLDS = (0.01, 0.02, 0.04)  # adaptive.threshold, the same for all scenes
DEFAULT = (2, 0.01)  # which the summary is about
FULL = (16, 64)
PLAIN = (2, 4, 6, 8, 12, 16, 24, 32, 48, 64)
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the blocks that are finished
SEEDS = (1, 2, 3)
REFERENCE_SAMPLES = 1024
REFERENCE_SEEDS = (987654321, 987654322)
VERDICT = (
    "**It pays where few blocks hold an edge, which is where pictures are large; and the more, the more samples",
    "are asked for.** Where half of the blocks hold one, fixed sampling is as fast. Contrast is as good a guide as",
    "the two halves' difference, and close to the oracle's. A block that is finished costs more than others, for of",
    "those without an edge four corner rays speak already; and it takes its first samples twice, so that it has the",
    "bits of fixed sampling.",
)
RESULTS = REPOSITORY / "benchmarks" / "results"
Blocks = NDArray[np.float64]  # (n, 16, 16, 3) means


class Point(NamedTuple):
    """A setting's cost and error."""

    full: int  # samples asked for
    first: int  # adaptive.min_samples; 0: fixed sampling
    threshold: float
    share: float  # of the samples asked for that pixels are the mean of
    cpu_s: float
    rmse: float


class Guess(NamedTuple):
    """What an estimate's choice of a share of the blocks leaves of the error."""

    full: int
    estimate: str
    share: float
    rmse: float


def mini(width: int, height: int, sampling: dict[str, Any]) -> dict[str, Any]:
    """Return the MINI in the Cornell box."""
    document: dict[str, Any] = json.loads((REPOSITORY / "scenes" / "mini-cornell.json").read_text())
    return {**document, "image": {"width": width, "height": height}, "sampling": sampling}


def box(size: int, sampling: dict[str, Any]) -> dict[str, Any]:
    """Return the mirror box of 32 triangles."""
    return {**mirrorbox.document(mirrorbox.parts(), size, sampling["samples"]), "sampling": sampling}


SCENES = {  # document, and of how many blocks one is rendered
    "mini-cornell, 3840 x 2160": (partial(mini, 3840, 2160), 64),
    "mini-cornell, 480 x 272": (partial(mini, 480, 272), 1),
    "mirror box, 1536 x 1536": (partial(box, 1536), 16),
    "mirror box, 384 x 384": (partial(box, 384), 1),
}


def compiled_of(scene: Any, samples: int, seed: int, **more: Any) -> tuple[CompiledScene, NDArray[np.int32]]:
    """Return a scene's arrays and the blocks that are rendered."""
    document, share = scene
    sampling = {"samples": samples, "sampler": "sobol", "seed": seed, **more}
    compiled = compile_document(document(sampling), REPOSITORY / "scenes")
    blocks = list_blocks(compiled)
    chosen = np.random.default_rng(0).permutation(len(blocks))[::share]  # a lattice would favour the audit's or none
    return compiled, blocks[np.sort(chosen)]


def render(compiled: CompiledScene, blocks: NDArray[np.int32], end: int) -> tuple[FilmBlocks, float]:
    """Return some blocks' film of the first samples, and CPU seconds."""
    start = time.thread_time()
    film = get_backend().render(compiled, blocks, (0, end), np.zeros(1, np.int64))
    return film, time.thread_time() - start


def squared(film: FilmBlocks, samples: int, truth: Blocks) -> NDArray[np.float64]:
    """Return each block's sum of squared errors."""
    error: NDArray[np.float64] = ((film.sums.sum(axis=1) / samples - truth) ** 2).sum(axis=(1, 2, 3))
    return error


def estimates(film: FilmBlocks, first: int, gain: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return what each estimate says of each block."""
    even, odd = 2.0 * film.sums[:, 0] / first, 2.0 * film.sums[:, 1] / first
    means = 0.5 * (even + odd)
    across = (np.diff(means, axis=1) ** 2).mean(axis=(1, 2, 3)) + (np.diff(means, axis=2) ** 2).mean(axis=(1, 2, 3))
    return {"contrast": across, "halves": ((0.5 * (even - odd)) ** 2).mean(axis=(1, 2, 3)), "oracle": gain}


def measure(scene: Any, truth: Blocks, seed: int) -> Iterator[Point]:
    """Yield all points of one seed: fixed sampling, and the feature."""
    settings: list[tuple[int, int, float]] = [(samples, 0, 0.0) for samples in PLAIN]
    settings += [(full, first, threshold) for full in FULL for first in FIRST for threshold in THRESHOLDS]
    for full, first, threshold in settings:
        more = {"adaptive": {"min_samples": first, "threshold": threshold}} if first else {}
        compiled, blocks = compiled_of(scene, full, seed, **more)
        film, seconds = render(compiled, blocks, full)
        error = float(np.sqrt(squared(film, full, truth).sum() / truth.size))
        share = film.counters[COUNTERS.index("samples")] / (len(blocks) * BLOCK_PX**2 * full)
        yield Point(full, first, threshold, float(share), seconds, error)


def guess(scene: Any, truth: Blocks, seed: int) -> Iterator[Guess]:
    """Yield what each estimate's choice of a share of the blocks leaves of the error."""
    first = FIRST[-1]
    for full in FULL:
        compiled, blocks = compiled_of(scene, full, seed)
        begun, done = render(compiled, blocks, first)[0], render(compiled, blocks, full)[0]
        coarse, fine = squared(begun, first, truth), squared(done, full, truth)
        for name, values in estimates(begun, first, coarse - fine).items():
            order = np.argsort(-values)
            for share in SHARES:
                chosen = order[: round(share * len(values))]
                left = coarse.sum() - coarse[chosen].sum() + fine[chosen].sum()
                yield Guess(full, name, share, float(np.sqrt(left / truth.size)))


def reference(scene: Any) -> tuple[Blocks, float]:
    """Return the reference's blocks, and the estimate of their RMS error."""
    halves = []
    for seed in REFERENCE_SEEDS:
        film, _ = render(*compiled_of(scene, REFERENCE_SAMPLES, seed), REFERENCE_SAMPLES)
        halves.append(film.sums.sum(axis=1) / REFERENCE_SAMPLES)
    return 0.5 * (halves[0] + halves[1]), float(np.sqrt(((halves[0] - halves[1]) ** 2).mean())) / 2


def medians(rows: list[Any], n_keys: int) -> list[Any]:
    """Return the medians over seeds of rows that agree in their first members."""
    groups: dict[tuple[Any, ...], list[Any]] = defaultdict(list)
    for row in rows:
        groups[row[:n_keys]].append(row[n_keys:])
    return [(*key, *(statistics.median(column) for column in zip(*some, strict=True))) for key, some in groups.items()]


def plain_seconds(points: list[Point], rmse: float) -> float:
    """Return the seconds in which fixed sampling reaches an error; interpolated in logarithms, NaN beyond."""
    curve = sorted((point.rmse, point.cpu_s) for point in points if not point.first)
    errors, seconds = np.log(np.array(curve)).T
    inside = errors[0] <= np.log(rmse) <= errors[-1]
    return float(np.exp(np.interp(np.log(rmse), errors, seconds))) if inside else float("nan")


def told(points: list[Point], point: Point) -> str:
    """Say what a setting gains over fixed sampling: at the same error, and as it is."""
    plain = next(p for p in points if p.full == point.full and not p.first)
    gain = plain_seconds(points, point.rmse) / point.cpu_s
    text = "" if np.isnan(gain) else f"{gain:.2f} x"
    return f"{text} | {plain.cpu_s / point.cpu_s:.2f} x | {point.rmse / plain.rmse:.3f}"


def summary(found: dict[str, dict[str, Any]]) -> list[str]:
    """Return a table of what the defaults gain."""
    lines = [
        f"The defaults, `min_samples` {DEFAULT[0]} and `threshold` {DEFAULT[1]}:",
        "",
        "| | samples | of these taken | gain at equal error | gain | RMSE to that of all |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, one in found.items():
        points = [Point(*row) for row in one["points"]]
        chosen = [point for point in points if (point.first, point.threshold) == DEFAULT]
        lines += [f"| {name} | {point.full} | {point.share:.0%} | {told(points, point)} |" for point in chosen]
    return lines


def page(found: dict[str, dict[str, Any]]) -> str:
    """Return the page."""
    lines = [
        "# Adaptive sampling",
        "",
        *VERDICT,
        "",
        f"`python -m benchmarks.adaptive`: CPU seconds of one core, medians of {len(SEEDS)} seeds. *Gain*: seconds of",
        "fixed sampling over these, with as many samples, and *at equal error* where fixed sampling has the same RMSE.",
        "What is *taken* counts one block in 64 that is finished whatever it shows. Of the large pictures one block in",
        "64 and in 16 is rendered.",
        "",
        *summary(found),
    ]
    for name, one in found.items():
        points = [Point(*row) for row in one["points"]]
        lines += ["", f"## {name}", ""]
        lines += [f"Reference: {2 * REFERENCE_SAMPLES} samples, its own error about {one['reference_rmse']:.2g}.", ""]
        lines += ["| samples everywhere | CPU s | RMSE |", "| --- | --- | --- |"]
        lines += [f"| {p.full} | {p.cpu_s:.3f} | {p.rmse:.5f} |" for p in points if not p.first]
        lines += [
            "",
            "| samples | min_samples | threshold | taken | CPU s | RMSE | gain at equal error | gain | RMSE to all |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        for p in points:
            if p.first:
                cells = f"{p.full} | {p.first} | {p.threshold} | {p.share:.0%} | {p.cpu_s:.3f} | {p.rmse:.5f}"
                lines.append(f"| {cells} | {told(points, p)} |")
        guesses = [Guess(*row) for row in one["guesses"]]
        rmse = {(g.full, g.estimate, g.share): g.rmse for g in guesses}
        lines += ["", f"RMSE where an estimate from {FIRST[-1]} samples chooses which blocks are finished:", ""]
        lines += ["| samples | blocks finished | contrast | halves | oracle |", "| --- | --- | --- | --- | --- |"]
        for full in FULL:
            for share in SHARES:
                cells = " | ".join(f"{rmse[full, name, share]:.5f}" for name in ("contrast", "halves", "oracle"))
                lines.append(f"| {full} | {share:.0%} | {cells} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="how many of the seeds")
    parser.add_argument("--page", action="store_true", help="write the page anew from the figures that are there")
    options = parser.parse_args()
    if options.page:
        (RESULTS / "adaptive.md").write_text(page(json.loads((RESULTS / "adaptive.json").read_text())))
        return 0
    found = {}
    for name, scene in SCENES.items():
        truth, error = reference(scene)
        seeds = SEEDS[: options.seeds]
        points = medians([point for seed in seeds for point in measure(scene, truth, seed)], 3)
        guesses = medians([one for seed in seeds for one in guess(scene, truth, seed)], 3)
        found[name] = {"reference_rmse": error, "points": points, "guesses": guesses}
        print(name, flush=True)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "adaptive.json").write_text(json.dumps(found) + "\n")
    (RESULTS / "adaptive.md").write_text(page(found))
    print(page(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
