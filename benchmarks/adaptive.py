"""``python -m benchmarks.adaptive``: what antialiasing that adapts by 16 x 16 blocks would gain.

Job: a trial through the backend seam, without a change of the kernels. Every block gets FIRST samples; a share of them,
those of the greatest estimated error, is finished to FULL; the others keep what they have. Seconds and RMSE are held
against the same number of samples everywhere. Writes ``benchmarks/results/adaptive.json`` and ``adaptive.md``.

Measure: RMSE of linear, unclamped radiance over all pixels and channels against a reference of other seeds; seconds are
CPU seconds of the kernel's thread, medians over seeds, all settings of a seed one after the other. Large pictures are
sampled: one block of a square of them. Estimates of a block's error:

* ``halves``: RMS over its pixels of half the difference of even and odd samples' means: its standard error.
* ``contrast``: RMS difference of neighbouring pixels of the block: edges and texture, whether samples straddle them or
  not. By shares, and above fixed thresholds, as a renderer would have to ask.
* ``oracle``: the true gain, squared error of FIRST less that of FULL, which no picture can know: it bounds the others.
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
from tracer.types import CompiledScene

FIRST = 4
FULL = (16, 64)
PLAIN = (4, 6, 8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64)
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the blocks that are finished
THRESHOLDS = (0.01, 0.02, 0.04, 0.08)  # of the contrast, the same for all scenes
SEEDS = (1, 2, 3, 4, 5)
REFERENCE_SAMPLES = 1024
REFERENCE_SEEDS = (987654321, 987654322)
ONE = THRESHOLDS[0]  # which the summary is about
VERDICT = (
    "**It pays where few blocks hold an edge, which is where pictures are large; and the more, the more samples",
    "are asked for.** The contrast of neighbouring pixels is as good a guide as the two halves' difference, and",
    "close to the oracle's. A block that is finished costs more than others, for of those without an edge four",
    "corner rays speak already. What the figures do not show: what the first samples of all of a block's pixels",
    "miss stays missed, so a share of the blocks would have to be finished without being asked about.",
)
RESULTS = REPOSITORY / "benchmarks" / "results"
Blocks = NDArray[np.float64]  # (n, 16, 16, 3) means


class Point(NamedTuple):
    """A setting's cost and error."""

    method: str
    setting: float  # samples, or share of the blocks that were finished, or threshold
    share: float  # of the blocks that have all of their samples
    samples: float  # a pixel, on the average
    cpu_s: float
    rmse: float


def mini(width: int, height: int, samples: int, seed: int) -> dict[str, Any]:
    """Return the MINI in the Cornell box."""
    document: dict[str, Any] = json.loads((REPOSITORY / "scenes" / "mini-cornell.json").read_text())
    document["image"] = {"width": width, "height": height}
    return {**document, "sampling": {"samples": samples, "sampler": "sobol", "seed": seed}}


def box(size: int, samples: int, seed: int) -> dict[str, Any]:
    """Return the mirror box of 32 triangles."""
    document = mirrorbox.document(mirrorbox.parts(), size, samples)
    return {**document, "sampling": {"samples": samples, "sampler": "sobol", "seed": seed}}


SCENES = {  # document, and of how many blocks in a row and in a column one is rendered
    "mini-cornell, 3840 x 2160": (partial(mini, 3840, 2160), 8),
    "mini-cornell, 480 x 272": (partial(mini, 480, 272), 1),
    "mirror box, 1536 x 1536": (partial(box, 1536), 4),
    "mirror box, 384 x 384": (partial(box, 384), 1),
}


def render(compiled: CompiledScene, blocks: NDArray[np.int32], first: int, end: int) -> tuple[Blocks, float]:
    """Return the halves' sums of some blocks, (n, 2, 16, 16, 3), and CPU seconds."""
    start = time.thread_time()
    film = get_backend().render(compiled, blocks, (first, end), np.zeros(1, np.int64))
    return film.sums, time.thread_time() - start


def compiled_of(scene: Any, samples: int, seed: int) -> tuple[CompiledScene, NDArray[np.int32]]:
    """Return a scene's arrays and the blocks that are rendered."""
    document, stride = scene
    compiled = compile_document(document(samples, seed), REPOSITORY / "scenes")
    blocks = list_blocks(compiled)
    return compiled, blocks[(blocks % stride == stride // 2).all(axis=1)]


def squared(means: Blocks, truth: Blocks) -> NDArray[np.float64]:
    """Return each block's sum of squared errors."""
    error: NDArray[np.float64] = ((means - truth) ** 2).sum(axis=(1, 2, 3))
    return error


def estimates(sums: Blocks, gain: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return what each estimate says of each block."""
    even, odd = 2.0 * sums[:, 0] / FIRST, 2.0 * sums[:, 1] / FIRST
    means = 0.5 * (even + odd)
    across = (np.diff(means, axis=1) ** 2).mean(axis=(1, 2, 3)) + (np.diff(means, axis=2) ** 2).mean(axis=(1, 2, 3))
    return {"halves": ((0.5 * (even - odd)) ** 2).mean(axis=(1, 2, 3)), "contrast": across, "oracle": gain}


def measure(scene: Any, truth: Blocks, seed: int) -> Iterator[Point]:
    """Yield all points of one seed."""
    n = truth.size
    for samples in PLAIN:
        compiled, blocks = compiled_of(scene, samples, seed)
        sums, seconds = render(compiled, blocks, 0, samples)
        error = squared(sums.sum(axis=1) / samples, truth).sum()
        yield Point("plain", samples, 1.0, samples, seconds, float(np.sqrt(error / n)))
    for full in FULL:
        compiled, blocks = compiled_of(scene, full, seed)
        sums, first_s = render(compiled, blocks, 0, FIRST)
        rest, _ = render(compiled, blocks, FIRST, full)
        coarse = squared(sums.sum(axis=1) / FIRST, truth)
        fine = squared((sums + rest).sum(axis=1) / full, truth)
        for name, setting, chosen in choices(estimates(sums, coarse - fine)):
            _, seconds = render(compiled, blocks[chosen], FIRST, full)
            error = coarse.sum() - coarse[chosen].sum() + fine[chosen].sum()
            share = len(chosen) / len(blocks)
            mean_samples = FIRST + (full - FIRST) * share
            yield Point(
                f"{name}, to {full}", setting, share, mean_samples, first_s + seconds, float(np.sqrt(error / n))
            )


def choices(found: dict[str, NDArray[np.float64]]) -> Iterator[tuple[str, float, NDArray[np.int64]]]:
    """Yield which blocks are finished: by each estimate a share of them, and those above thresholds."""
    for name, values in found.items():
        order = np.argsort(-values)
        for share in SHARES:
            yield name, share, np.sort(order[: round(share * len(values))])
    for threshold in THRESHOLDS:
        yield "contrast above", threshold, np.flatnonzero(found["contrast"] > threshold**2)


def reference(scene: Any) -> tuple[Blocks, float]:
    """Return the reference's blocks, and the estimate of their RMS error."""
    halves = []
    for seed in REFERENCE_SEEDS:
        compiled, blocks = compiled_of(scene, REFERENCE_SAMPLES, seed)
        sums, _ = render(compiled, blocks, 0, REFERENCE_SAMPLES)
        halves.append(sums.sum(axis=1) / REFERENCE_SAMPLES)
    return 0.5 * (halves[0] + halves[1]), float(np.sqrt(((halves[0] - halves[1]) ** 2).mean())) / 2


def medians(points: list[Point]) -> list[Point]:
    """Return each setting's medians over seeds."""
    groups: dict[tuple[str, float], list[Point]] = defaultdict(list)
    for point in points:
        groups[point.method, point.setting].append(point)
    return [
        some[0]._replace(
            share=statistics.median(one.share for one in some),
            samples=statistics.median(one.samples for one in some),
            cpu_s=statistics.median(one.cpu_s for one in some),
            rmse=statistics.median(one.rmse for one in some),
        )
        for some in groups.values()
    ]


def plain_seconds(points: list[Point], rmse: float) -> float:
    """Return the seconds in which samples spread evenly reach an error; interpolated in logarithms, NaN beyond."""
    curve = sorted((point.rmse, point.cpu_s) for point in points if point.method == "plain")
    errors, seconds = np.log(np.array(curve)).T
    inside = errors[0] <= np.log(rmse) <= errors[-1]
    return float(np.exp(np.interp(np.log(rmse), errors, seconds))) if inside else float("nan")


def summary(found: dict[str, dict[str, Any]]) -> list[str]:
    """Return a table of what one threshold for all scenes gains."""
    head = "| | blocks finished | " + " | ".join(f"to {full}: gain, RMSE to that of {full}" for full in FULL) + " |"
    lines = [f"One threshold for all scenes, contrast above {ONE}:", "", head, "| --- | --- |" + " --- |" * len(FULL)]
    for name, one in found.items():
        points = [Point(*row) for row in one["points"]]
        cells = []
        for full in FULL:
            at = next(p for p in points if p.method == f"contrast above, to {full}" and p.setting == ONE)
            even = next(p for p in points if p.method == "plain" and p.setting == full)
            cells.append(f"{plain_seconds(points, at.rmse) / at.cpu_s:.2f} x, {at.rmse / even.rmse:.3f}")
        lines.append(f"| {name} | {at.share:.0%} | " + " | ".join(cells) + " |")
    return lines


def page(found: dict[str, dict[str, Any]]) -> str:
    """Return the page."""
    lines = [
        "# Antialiasing that adapts by blocks",
        "",
        *VERDICT,
        "",
        f"`python -m benchmarks.adaptive`: {FIRST} samples everywhere, then a share of the 16 x 16 blocks is finished.",
        f"CPU seconds of one core, medians of {len(SEEDS)} seeds. *Gain*: seconds of samples spread evenly at the same",
        "RMSE, over these. `halves` and `contrast` are estimates that a renderer could use; `oracle` knows the truth.",
        "Of the large pictures one block in 64 and in 16 is rendered.",
        "",
        *summary(found),
    ]
    for name, one in found.items():
        points = [Point(*row) for row in one["points"]]
        lines += [
            "",
            f"## {name}",
            "",
            f"Reference: {2 * REFERENCE_SAMPLES} samples, its own error about {one['reference_rmse']:.2g}.",
            "",
        ]
        lines += ["| samples everywhere | CPU s | RMSE |", "| --- | --- | --- |"]
        lines += [f"| {p.setting:.0f} | {p.cpu_s:.3f} | {p.rmse:.5f} |" for p in points if p.method == "plain"]
        lines += [
            "",
            "| finished by | share | samples | CPU s | RMSE | gain |",
            "| --- | --- | --- | --- | --- | --- |",
        ]
        for p in points:
            if p.method != "plain":
                gain = plain_seconds(points, p.rmse) / p.cpu_s
                told = "" if np.isnan(gain) else f"{gain:.2f}"
                method = p.method.replace("above", f"above {p.setting}")
                lines.append(f"| {method} | {p.share:.0%} | {p.samples:.1f} | {p.cpu_s:.3f} | {p.rmse:.5f} | {told} |")
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
        points = medians([point for seed in SEEDS[: options.seeds] for point in measure(scene, truth, seed)])
        found[name] = {"reference_rmse": error, "points": points}
        print(name, flush=True)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "adaptive.json").write_text(json.dumps(found) + "\n")
    (RESULTS / "adaptive.md").write_text(page(found))
    print(page(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
