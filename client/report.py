"""The report of a job for people: where the time went, which rays, what was skipped.

Invariant: members that a report lacks are left out; unknown ones do no harm.
"""

from collections.abc import Mapping
from typing import Any

from client.formats import format_bytes, format_count, format_duration, format_percent
from client.terminal import Terminal

SKIPPED_NAMES: Mapping[str, str] = {
    "primary_rays_skipped_shared": "camera rays that one beam spoke for",
    "reflection_rays_skipped_shared": "mirrored rays that one beam spoke for",
    "shadow_rays_skipped_facing": "shadow rays to lights behind the surface",
    "shadow_rays_skipped_black": "shadow rays that could add nothing",
    "shadow_rays_skipped_solid": "shadow rays through the inside of closed meshes",
    "shadow_rays_skipped_shared": "shadow rays that one beam spoke for",
    "bounces_skipped_depth": "bounces beyond the greatest depth",
    "bounces_skipped_throughput": "bounces too faint to see",
    "pixels_skipped_background": "pixels that see only the background",
    "samples_skipped_adaptive": "samples of blocks without detail",
}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def time_rows(report: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of (step, seconds, share of the whole)."""
    seconds = _mapping(report.get("seconds"))
    preparing = _mapping(seconds.get("preparing"))
    total = _number(seconds.get("total"))
    parts = [_number(preparing.get("load")) or 0.0, _number(preparing.get("build")) or 0.0]
    if sum(parts) > (_number(preparing.get("total")) or 0.0):
        preparing = {"total": preparing.get("total")}  # the parts are of an earlier job that compiled the same scene
    steps = [
        ("waiting for a worker", seconds.get("queued")),
        ("preparing the scene", preparing.get("total")),
        ("   reading models and textures", preparing.get("load")),
        ("   building the search tree", preparing.get("build")),
        ("rendering, first to last tile", seconds.get("first_lease_to_last_tile", seconds.get("rendering"))),
        ("finishing the pictures", seconds.get("after_last_tile")),
        ("all", total),
    ]
    rows = []
    for name, value in steps:
        number = _number(value)
        if number is not None:
            rows.append([name, format_duration(number), format_percent(number / total) if total else ""])
    return rows


def work_rows(report: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of (what, how much) about the work of the kernels."""
    rays, tiles = _mapping(report.get("rays")), _mapping(report.get("tiles"))
    workers = _mapping(tiles.get("workers"))
    rows = []
    kernel_s = _number(report.get("kernel_s"))
    rendering_s = _number(_mapping(report.get("seconds")).get("first_lease_to_last_tile"))
    if kernel_s is not None and workers and rendering_s:
        busy = format_percent(kernel_s / (rendering_s * len(workers)))
        count = f"{len(workers)} worker" + ("" if len(workers) == 1 else "s")
        rows.append(["in kernels", f"{format_duration(kernel_s)} on {count}, {busy} of their time"])
    if compile_s := _number(report.get("kernels_compile_s")):
        rows.append(["kernels", f"compiled once, in {format_duration(compile_s)}; no part of this job's time"])
    if _number(tiles.get("n")) is not None:
        rows.append(["tiles", f"{tiles['n']} of {tiles.get('size', '?')} px"])
    if _number(report.get("triangles")) is not None:
        rows.append(["triangles", format_count(report["triangles"])])
    trees, placements = _number(report.get("trees")), _number(report.get("placements"))
    if trees and placements and placements > 1:
        rows.append(["placements", f"{format_count(placements)} of {format_count(trees)} trees"])
    for name in ("primary_rays", "shadow_rays", "reflection_rays", "transmission_rays"):
        if _number(rays.get(name)) is not None:
            rows.append([name.replace("_", " "), format_count(rays[name])])  # noqa: PERF401 - as the lines around it
    if _number(rays.get("per_sample")) is not None:
        rows.append(["rays per sample", f"{rays['per_sample']:.2f}"])
    if _number(rays.get("per_s")) is not None:
        rows.append(["speed", format_count(rays["per_s"], "rays/s")])
    adaptive = _mapping(report.get("adaptive"))
    blocks, missed = _number(adaptive.get("blocks_audited")), _number(adaptive.get("blocks_missed"))
    if blocks and missed is not None:
        text = f"{missed:.0f} of {blocks:.0f} blocks that seemed to have no detail, and got all samples, had some"
        rows.append(["adaptive sampling", text])
    scene_bytes = _number(_mapping(report.get("bytes")).get("compiled_scene"))
    if scene_bytes:
        saved = _number(_mapping(report.get("bytes")).get("saved_by_sharing"))
        more = f"; shared meshes save {format_bytes(saved)}" if saved else ""
        rows.append(["compiled scene", format_bytes(scene_bytes) + more])
    return rows


def skipped_rows(report: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of (what was not done, how often); what never occurred is left out."""
    return [
        [SKIPPED_NAMES.get(name, name.replace("_", " ")), format_count(number)]
        for name, value in _mapping(report.get("skipped")).items()
        if (number := _number(value))
    ]


def print_report(terminal: Terminal, report: Mapping[str, Any]) -> None:
    """Print where the time of a job went, and what was skipped.

    Parameters
    ----------
    report : Mapping
        The report as the service answers it.
    """
    for title, rows, right in (
        ("Where the time went", time_rows(report), (1, 2)),
        ("Work", work_rows(report), ()),
        ("Skipped", skipped_rows(report) or [["nothing", ""]], (1,)),
    ):
        if rows:
            terminal.table([""] * len(rows[0]), rows, title=title, right=right)
            terminal.out("")
    for warning in report.get("warnings") or ():
        terminal.warn(str(warning))
