"""The report of a finished job: where the time went, how many rays, what was skipped.

Job: pure arithmetic over events, plan and tile headers; all of these are in the store, so a report survives any fault.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from importlib import metadata
from typing import Any

from tracer.film.tile import TileHeader
from worker.records import JobEvent, JobRecord, now, seconds_between
from worker.states import JobState


@dataclass(slots=True)
class TileTotals:
    """Sums over the headers of tiles as they are read."""

    n_tiles: int = 0
    kernel_s: float = 0.0
    kernel_cpu_s: float = 0.0
    first_lease: float = float("inf")
    last_finish: float = 0.0
    counters: Counter[str] = field(default_factory=Counter)
    workers: Counter[str] = field(default_factory=Counter)

    def add(self, header: TileHeader) -> None:
        """Take in one tile's header."""
        self.n_tiles += 1
        self.kernel_s += header.kernel_s
        self.kernel_cpu_s += header.kernel_cpu_s
        self.first_lease = min(self.first_lease, header.leased_at)
        self.last_finish = max(self.last_finish, header.finished_at)
        self.counters.update(header.counters)
        self.workers[header.worker] += 1

    @property
    def rays(self) -> int:
        """Rays of all kinds."""
        return sum(count for name, count in self.counters.items() if name.endswith("_rays"))

    @property
    def rendering_s(self) -> float:
        """Seconds from the first lease to the last tile."""
        return max(0.0, self.last_finish - self.first_lease)


@lru_cache(maxsize=1)
def _version() -> str:
    return metadata.version("smalti")  # reads files: 5 ms


def summarize(totals: TileTotals, film_sha256: str) -> dict[str, Any]:
    """Return what the event "succeeded" carries: enough for a view of the job without its report."""
    seconds = totals.rendering_s
    return {
        "film_sha256": film_sha256,
        "rays": totals.rays,
        "rays_per_s": totals.rays / seconds if seconds > 0.0 else None,
        "rendering_s": round(seconds, 6),
        "kernel_s": round(totals.kernel_s, 6),
    }


def build_report(
    record: JobRecord,
    plan: Mapping[str, Any],
    events: Iterable[JobEvent],
    totals: TileTotals,
    *,
    film_sha256: str,
    assembling_s: float,
    sizes: Mapping[str, int],
) -> bytes:
    """Return ``report.json``.

    Parameters
    ----------
    record, plan, events
        Of the job.
    totals
        Sums over its tiles.
    film_sha256
        Hash of the picture.
    assembling_s
        Seconds that the assembler worked on it, while tiles were still being rendered or after the last.
    sizes
        File name -> bytes of the results.
    """
    began: dict[JobState, str] = {}
    faults: Counter[str] = Counter()
    for event in events:
        if event.type in {"state", "created"}:
            began.setdefault(event.state, event.at)
        else:
            faults[event.type] += 1
    preparing = began.get(JobState.PREPARING, record.created_at)
    rendering = began.get(JobState.RENDERING, preparing)
    assembling = began.get(JobState.ASSEMBLING, now())
    figures = dict(plan.get("figures", {}))
    samples = totals.counters.get("samples", 0)
    rays = {name: totals.counters[name] for name in totals.counters if name.endswith("_rays")}
    skipped = {name: value for name, value in totals.counters.items() if "_skipped_" in name}
    seconds = totals.rendering_s
    report = {
        "job": record.id,
        "film_sha256": film_sha256,
        "scene_sha256": record.scene_sha256,
        "version": _version(),
        "backend": plan.get("backend"),
        "arithmetic": plan.get("arithmetic"),
        "seed": plan.get("seed"),
        "samples": record.samples,
        "image": {"width": record.width, "height": record.height},
        "crop": {"x": record.x, "y": record.y, "width": record.crop_width, "height": record.crop_height},
        "seconds": {
            "queued": round(seconds_between(record.created_at, preparing), 6),
            "preparing": {
                "load": figures.get("load_s"),
                "build": figures.get("build_s"),
                "total": round(seconds_between(preparing, rendering), 6),
            },
            "first_lease_to_last_tile": round(seconds, 6),
            "assembling": round(assembling_s, 6),
            "after_last_tile": round(seconds_between(assembling, now()), 6),
            "total": round(seconds_between(record.created_at, now()), 6),
        },
        "first_lease_at": _time_of(totals.first_lease),
        "last_tile_at": _time_of(totals.last_finish),
        "kernels_compile_s": figures.get("kernels_compile_s"),
        "kernel_s": round(totals.kernel_s, 6),
        "kernel_cpu_s": round(totals.kernel_cpu_s, 6),
        "rays": {
            **rays,
            "total": totals.rays,
            "per_sample": totals.rays / samples if samples else None,
            "per_s": totals.rays / seconds if seconds > 0.0 else None,
        },
        "samples_traced": samples,
        "skipped": skipped,
        "adaptive": {
            "blocks_audited": totals.counters.get("adaptive_blocks_audited", 0),
            "blocks_missed": totals.counters.get("adaptive_blocks_missed", 0),
        },
        "tiles": {"n": totals.n_tiles, "size": record.output["tile_size"], "workers": dict(totals.workers)},
        "triangles": figures.get("triangles"),
        "trees": figures.get("n_trees"),
        "placements": figures.get("n_placements"),
        "bytes": {
            "compiled_scene": figures.get("bytes"),
            "saved_by_sharing": figures.get("n_bytes_saved"),
            **sizes,
        },
        "warnings": list(figures.get("warnings", ())),
        "faults": dict(faults),
    }
    return json.dumps(report, indent=1).encode()


def _time_of(seconds: float) -> str:
    """Return a time in seconds since the epoch as `records.now` writes it."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
