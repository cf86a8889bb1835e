"""The page and the plots of `benchmarks.jobs`.

Invariant: nothing is computed here that is not in the JSON; the plots' bytes depend on it alone.
"""

from pathlib import Path
from typing import Any

from benchmarks.machine import machine_line

PEERS = {
    "Mitsuba": "an integrator of its own for this job (`benchmarks/peer_mitsuba.py`); random samples.",
    "POV-Ray": (
        "`benchmarks/peer_povray.py`; its own count of CPU seconds for tracing. The samples are pixels of a picture of "
        "4 times the edge, averaged when it is read: 16 rays a pixel; its antialiasing without adaptation takes 17.06. "
        "Float64, 16-bit file."
    ),
    "Tachyon": (
        "`benchmarks/peer_tachyon.py`; it prints wall time alone, so CPU seconds of the process less those of a run "
        "with one pixel; the 16-bit file is in them. A pixel's samples are its centre and 15 random places. Float64; "
        "triangles without area are left out."
    ),
}
SERIES = {
    "triangles": "triangles",
    "lights": "point lights",
    "resolution": "pixels along an edge",
    "depth": "bounces at most (four mirror walls)",
}


def whole_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the tables of whole pictures: seconds, then what the pictures have in common."""
    names = [name for name in PEERS if any(name in row["peers"] or name in row["notes"] for row in rows)]
    lines = [
        "## Whole pictures",
        "",
        "The mirror box, a point light, one core, CPU seconds of a picture, medians; the peers take turns with us.",
        "",
        f"| job | triangles | picture | ours s |{''.join(f' {name} s | x |' for name in names)}",
        "|---" * (4 + 2 * len(names)) + "|",
    ]
    for row in rows:
        picture = f"{row['size']} x {row['size']}, {row['samples']} samples"
        cells = [row["job"], f"{row['triangles']:,}", picture, f"{row['ours_s']:.4f}"]
        for name in names:
            peer = row["peers"].get(name)
            cells += [f"{peer['s']:.4f}", f"**{peer['ratio']:.2f}**"] if peer else ["", ""]
        lines.append(f"| {' | '.join(cells)} |")
    measured = [name for name in names if any(name in row["peers"] for row in rows)]
    if measured:
        lines += peer_lines(rows, measured)
    notes = dict.fromkeys(f"{name}: {row['notes'][name]}." for name in names for row in rows if name in row["notes"])
    return lines + [line for note in notes for line in ("", note)]


def peer_lines(rows: list[dict[str, Any]], names: list[str]) -> list[str]:
    """Return how like ours the peers' pictures are, what else their processes did, and what each of them was told."""
    brightest = max(row["brightest"] for row in rows)
    lines = [
        "",
        f"The same picture: its mean, and its distance from ours. The brightest pixel is {brightest:.2f}: no clipping.",
        "Programs that are started for each picture also read text and build, which is not in the seconds above.",
        "",
        "| job | by | mean | of ours | RMSE | reading, building s | whole process s |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(f"| {row['job']} | us | {row['mean']:.5f} | | | | |")
        for name, peer in row["peers"].items():
            cells = [row["job"], name, f"{peer['mean']:.5f}", f"{peer['mean'] / row['mean']:.4f}"]
            cells += [f"{peer['rmse']:.5f}"]
            cells += [f"{peer[key]:.2f}" if key in peer else "" for key in ("reading_s", "process_s")]
            lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "Peers:", ""]
    for name in names:
        versions = sorted({row["peers"][name]["version"] for row in rows if name in row["peers"]})
        lines.append(f"- {name} {', '.join(versions)}: {PEERS[name]}")
    return lines


def process_lines(title: str, rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of what was measured from process start."""
    lines = ["", f"## {title}", "", "| what | wall s | CPU s | of which |", "|---|---|---|---|"]
    for row in rows:
        named = {
            "import_s": "import",
            "kernels_s": "kernels from the cache",
            "render_s": "picture",
            "write_s": "file",
            "answer_s": "POST to the end",
        }
        told = [f"{label} {row[name]:.3f}" for name, label in named.items() if name in row]
        if "image_bytes" in row:
            told.append(f"image of {row['image_bytes'] / 1e3:.0f} kB")
        lines.append(f"| {row['what']} | {row['wall_s']:.2f} | {row['cpu_s']:.2f} | {', '.join(told)} |")
    return lines


def growth_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of growth."""
    lines = ["", "## How cost grows", "", "![nanoseconds a sample](jobs.png)", ""]
    lines += ["| of | value | CPU s | ns a sample |", "|---|---|---|---|"]
    for row in rows:
        cells = [row["series"], f"{row['value']:,}"]
        cells += [f"{row['cpu_s']:.3f}", f"{1e9 * row['s_per_sample']:.1f}"] if "cpu_s" in row else [row["note"], ""]
        lines.append(f"| {' | '.join(cells)} |")
    return lines + fineness_lines(rows)


def fineness_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return what the growth with triangles comes from: two pictures each with the same number of them a pixel."""
    counted = [row for row in rows if "met_by_packet" in row and "cpu_s" in row]
    scenes = {(row["series"], row["value"]): row for row in counted}
    values = [row["value"] for row in counted if row["series"] == "fineness"]
    few, many = min(values, default=0), max(values, default=0)
    order = (("fineness", few), ("triangles", many), ("triangles", few), ("fineness", many))
    told = [scenes[key] for key in order if key in scenes]
    if len(told) < len(order):
        return []
    lines = [
        "",
        "What grows with triangles is what the rays of a packet do not share, not memory. Ten times as many triangles,",
        "and so ten times the memory, cost about the same where as many of them share a pixel:",
        "",
        "| triangles | picture | triangles a pixel | different triangles that 64 camera rays meet | ns a sample |",
        "|---|---|---|---|---|",
    ]
    for row in told:
        cells = [f"{row['value']:,}", f"{row['size']} x {row['size']}", f"{row['value'] / row['size'] ** 2:.1f}"]
        cells += [f"{row['met_by_packet']:.1f}", f"{1e9 * row['s_per_sample']:.1f}"]
        lines.append(f"| {' | '.join(cells)} |")
    triangles = [row for row in counted if row["series"] == "triangles"]
    met = ", ".join(f"{row['met_by_packet']:.1f} of {row['value']:,}" for row in triangles)
    lines += [
        "",
        f"At {triangles[-1]['size']} pixels an edge the 64 rays of 2 x 2 pixels that meet the sphere meet {met}.",
        "As long as these are few, a packet shares nearly all of its work. Where nearly every ray has a triangle of",
        "its own there is nothing left to share, and a packet still goes through all that lies between its outermost",
        "rays: what four pixels hold, of which 64 triangles at most are met. That grows with the triangles, not with",
        "their logarithm.",
    ]
    return lines


def worker_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of workers."""
    lines = ["", "## Two workers against one", "", "| | |", "|---|---|"]
    for row in rows:
        turns = ", ".join(f"{one:.1f} / {two:.1f}" for one, two in zip(row["one_s"], row["two_s"], strict=True))
        lines += [
            f"| 512 x 512, {row['samples']} samples: one worker's seconds over two's | **{row['ratio']:.3f}** |",
            f"| first lease to last tile, one / two | {turns} |",
            f"| kernel seconds with one worker | {', '.join(f'{s:.1f}' for s in row['kernel_one_s'])} |",
        ]
    return lines


def plot(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw nanoseconds a sample, one panel a series."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "smalti"
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(SERIES), figsize=(15, 3.8), constrained_layout=True)
    for panel, (series, label) in zip(panels, SERIES.items(), strict=True):
        points = [
            (row["value"], 1e9 * row["s_per_sample"]) for row in rows if row["series"] == series and "cpu_s" in row
        ]
        if points:
            panel.plot(*zip(*points, strict=True), marker="o", color="#2f5d9b")
        panel.set_xscale("symlog" if series == "depth" else "log")
        panel.set_ylim(bottom=0)
        panel.set_xlabel(label)
        panel.grid(visible=True, alpha=0.25)
    panels[0].set_ylabel("ns a sample")
    figure.savefig(folder / "jobs.png", dpi=110)
    figure.savefig(folder / "jobs.svg", metadata={"Date": None})
    plt.close(figure)


def write_page(result: dict[str, Any], folder: Path) -> None:
    """Write jobs.md, and the plots where growth was measured."""
    lines = ["# Whole jobs", "", "`make bench-jobs`; `benchmarks/jobs.py` says what is measured and how.", ""]
    if "whole" in result:
        lines += whole_lines(result["whole"]["rows"])
    for name, title in (("start", "From process start, kernels compiled"), ("compile", "First compilation")):
        if name in result:
            lines += process_lines(title, result[name]["rows"])
    if "growth" in result:
        lines += growth_lines(result["growth"]["rows"])
        plot(result["growth"]["rows"], folder)
    if "workers" in result:
        lines += worker_lines(result["workers"]["rows"])
    machines = {machine_line(part["machine"]) for part in result.values()}
    lines += ["", *(f"Machine: {line}." for line in sorted(machines))]
    (folder / "jobs.md").write_text("\n".join(lines) + "\n")
