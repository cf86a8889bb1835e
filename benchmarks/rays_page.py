"""The page and the plots of `benchmarks.rays`.

Invariant: nothing is computed here that is not in the JSON; the plots' bytes depend on it alone.
"""

import statistics
from pathlib import Path
from typing import Any

from benchmarks.machine import machine_line

NEEDED = {"build": 1.0, "primary": 3.3, "bounce": 2.0, "shadow": 1.6}
KINDS = ("primary", "bounce", "shadow")
OURS, THEIRS = "#2f5d9b", "#c9a24b"


def ratios_of(rows: list[dict[str, Any]], work: str) -> list[float]:
    """Return Embree's seconds over ours, a mesh each."""
    return [row["embree_s"] / row["ours_s"] for row in rows if row["work"] == work]


def summary_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of geometric means."""
    lines = ["| work | geometric mean | least | needed |", "|---|---|---|---|"]
    for work in KINDS:
        ratios = ratios_of(rows, work)
        if ratios:
            mean = statistics.geometric_mean(ratios)
            lines.append(f"| {work} | **{mean:.2f}** | {min(ratios):.2f} | {NEEDED[work]:.1f}, none below 1.0 |")
    return lines


def ray_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of rays."""
    lines = ["", "## Rays", "", "Millions of rays a second of CPU time, one thread; two threads by the clock.", ""]
    lines += ["![rays a second](rays.png)", ""]
    lines += ["| mesh | rays | ours M/s | Embree M/s | x | same answers | 2 threads |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        if row["work"] in KINDS:
            million = row["count"] / 1e6
            cells = [row["mesh"], row["work"], f"{million / row['ours_s']:.2f}", f"{million / row['embree_s']:.2f}"]
            cells += [
                f"**{row['embree_s'] / row['ours_s']:.2f}**",
                f"{row['agree']:.6f}",
                f"{row['two_threads']:.2f} x",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def build_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of builds."""
    lines = ["", "## Builds", "", "A fresh process each, one thread's work, against Embree's commit alone.", ""]
    lines += [
        "Bytes a triangle: of our tree, and what the process grows by.",
        "",
        "| mesh | triangles | ours s (in the program) | Embree s | x | 2 threads | tree B | ours B | Embree B |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row["work"] == "build":
            n = row["count"]
            cells = [row["mesh"], f"{n:,}"]
            cells += [f"{row[f'{who}_s']:.4f} ({row[f'{who}_user_s']:.4f})" for who in ("ours", "embree")]
            cells += [f"**{row['embree_s'] / row['ours_s']:.2f}**" if row["ours_s"] > 0 else ""]
            cells += [f"{row['two_threads']:.2f} x", f"{row['tree_bytes'] / n:.1f}"]
            cells += [f"{row[f'{who}_resident_bytes'] / n:.0f}" for who in ("ours", "embree")]
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def plot(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw millions of rays a second, one panel a kind."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "smalti"
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(KINDS), figsize=(15, 4.2), constrained_layout=True)
    for panel, work in zip(panels, KINDS, strict=True):
        chosen = [row for row in rows if row["work"] == work]
        places = range(len(chosen))
        for shift, who, color, label in ((-0.2, "ours", OURS, "RayCaster"), (0.2, "embree", THEIRS, "Embree")):
            heights = [row["count"] / 1e6 / row[f"{who}_s"] for row in chosen]
            panel.bar([place + shift for place in places], heights, 0.4, color=color, label=label)
        panel.set_xticks(list(places), [row["mesh"] for row in chosen], rotation=20)
        panel.set_title(work)
        panel.grid(visible=True, axis="y", alpha=0.25)
    panels[0].set_ylabel("million rays a second, one thread")
    panels[0].legend()
    figure.savefig(folder / "rays.png", dpi=110)
    figure.savefig(folder / "rays.svg", metadata={"Date": None})
    plt.close(figure)


def write_page(result: dict[str, Any], folder: Path) -> None:
    """Write rays.md, and the plots where rays were measured."""
    rows = result["rows"]
    lines = ["# Rays", "", "`make bench-rays`; `benchmarks/rays.py` says what is measured and how.", ""]
    turns = f"medians of the {result['repeats']} quietest turns"
    lines += [f"{result['rays']:,} rays a batch, {turns}; embreex {result['embreex']}.", ""]
    lines += summary_lines(rows)
    if any(row["work"] in KINDS for row in rows):
        lines += ray_lines(rows)
        plot(rows, folder)
    if any(row["work"] == "build" for row in rows):
        lines += build_lines(rows)
    lines += ["", f"Machine: {machine_line(result['machine'])}."]
    (folder / "rays.md").write_text("\n".join(lines) + "\n")
