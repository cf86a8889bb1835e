"""``make bench-jobs``: whole pictures, beside other renderers in the same run; start, compilation, and how cost grows.

    python -m benchmarks.jobs [--only whole,start,...] [--repeats 5] [--size 512] [--small] [--peer PYTHON]

*whole*: the mirror box (`benchmarks.mirrorbox`), 32 triangles and 1.31 M, dull and a mirror, 16 samples, one core;
*start*: a 64 x 64 picture from process start and through a running service; *compile*: all kernels into an empty cache;
*growth*: with triangles, lights, resolution and depth; *workers*: two workers against one, only when named: about 10
minutes; interrupted, it goes on where it was.
Writes ``benchmarks/results/jobs.json``, ``.md``, ``.png``, ``.svg`` (``--small``: into ``out/``).

Invariant: a picture's seconds are CPU time of the process that renders it, on one thread, film included, compilation
of code and scene not; peers take turns with us, the first two do not count (some compile), medians do.

Peers (`benchmarks.peers`), each where it is installed, and the page says where it is not: Mitsuba under an interpreter
that ``--peer`` or SMALTI_MITSUBA_PYTHON names (``pip install mitsuba``; its ``llvm_ad_rgb`` needs a libLLVM);
``povray`` and ``tachyon`` on the PATH, or as SMALTI_POVRAY and SMALTI_TACHYON name them.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrorbox
from benchmarks.data import REPOSITORY
from benchmarks.jobs_page import write_page
from benchmarks.jobs_processes import measure_compile, measure_start, measure_workers
from benchmarks.local import compile_document
from benchmarks.machine import describe_machine
from benchmarks.peer_povray import PovRay
from benchmarks.peer_tachyon import Tachyon
from benchmarks.peers import MITSUBA_PYTHON, AbsentError, Mitsuba, Peer, Turn
from tracer.rays import RayCaster
from tracer.render import render_compiled
from tracer.types import CompiledScene

SAMPLES = 16
WHOLE = (  # triangles of the sphere, and how much it mirrors
    ("mirror box", 0, 0.0),
    ("mirror box, bumpy sphere", mirrorbox.BIG, 0.0),
    ("mirror box, bumpy mirror", mirrorbox.BIG, 0.9),
)
WARM_TURNS = 2
_PACKETS = 1000


def compile_parts(scene: list[mirrorbox.Part], folder: Path, **settings: Any) -> CompiledScene:
    """Compile a scene of `mirrorbox`."""
    for part in scene:
        if part.name == "sphere":
            mirrorbox.write_ply(folder / mirrorbox.PLY, part)
    return compile_document(mirrorbox.document(scene, **settings), folder)


def render_cpu_s(compiled: CompiledScene) -> tuple[float, NDArray[np.float32]]:
    """Return the CPU seconds of one picture on one thread, and its pixels."""
    start = time.process_time()
    film = render_compiled(compiled, threads=1)
    return time.process_time() - start, film.pixels


def median_cpu_s(compiled: CompiledScene, repeats: int) -> float:
    """Return the median CPU seconds of a picture; the first does not count."""
    return statistics.median([render_cpu_s(compiled)[0] for _ in range(repeats + 1)][1:])


def measure_whole(
    name: str, scene: list[mirrorbox.Part], size: int, repeats: int, python: str | None
) -> dict[str, Any]:
    """Measure one mirror box, in turns with the peers that are there."""
    peers: list[Peer] = []
    notes: dict[str, str] = {}
    ours: list[float] = []
    theirs: dict[str, list[Turn]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        compiled = compile_parts(scene, folder, size=size, samples=SAMPLES)
        for kind, make in (
            (Mitsuba, lambda: Mitsuba(python, scene, folder, size, SAMPLES)),
            (PovRay, lambda: PovRay(scene, folder, size, SAMPLES)),
            (Tachyon, lambda: Tachyon(scene, folder, size, SAMPLES)),
        ):
            try:
                peers.append(make())
            except AbsentError as error:
                notes[kind.name] = f"not here: {error}"
        try:
            for _ in range(repeats + WARM_TURNS):
                for peer in peers:
                    if peer.name not in notes:
                        try:
                            theirs.setdefault(peer.name, []).append(peer.render())
                        except RuntimeError as error:
                            notes[peer.name] = f"gave up: {error}"
                seconds, pixels = render_cpu_s(compiled)
                ours.append(seconds)
        finally:
            for peer in peers:
                peer.close()
        row: dict[str, Any] = {"job": name, "triangles": sum(len(part.faces) for part in scene), "size": size}
        row |= {"samples": SAMPLES, "ours_all_s": ours[WARM_TURNS:], "ours_s": statistics.median(ours[WARM_TURNS:])}
        row |= {"mean": float(pixels.mean()), "brightest": float(pixels.max())}
        row["peers"] = {
            peer.name: compare(peer, theirs[peer.name][WARM_TURNS:], row["ours_s"], pixels)
            for peer in peers
            if peer.name not in notes
        }
        row["notes"] = notes
    return row


def compare(peer: Peer, turns: list[Turn], ours_s: float, pixels: NDArray[np.float32]) -> dict[str, Any]:
    """Return what a peer took, how that compares with us, and how like ours its picture is."""
    picture = peer.picture()
    picture_s = statistics.median(turn.picture_s for turn in turns)
    return {
        "version": peer.version,
        "all_s": [turn.picture_s for turn in turns],
        "s": picture_s,
        "ratio": picture_s / ours_s,
        **{
            name: statistics.median(getattr(turn, name) for turn in turns)
            for name in ("reading_s", "process_s")
            if getattr(turns[0], name) is not None
        },
        "rmse": float(np.sqrt(((picture - pixels) ** 2).mean())),
        "mean": float(picture.mean()),
    }


def triangles_met(scene: list[mirrorbox.Part], size: int) -> float:
    """Return how many different triangles of the sphere a packet of 64 camera rays meets, on the average.

    Packets are 2 x 2 pixels of 16 samples at random places; those count of which nine rays in ten meet the sphere.
    """
    random = np.random.default_rng(1)
    offsets = np.cumsum([0] + [len(part.vertices) for part in scene])
    vertices = np.concatenate([part.vertices for part in scene]).astype(np.float64)
    faces = np.concatenate([part.faces + offset for part, offset in zip(scene, offsets, strict=False)])
    first = sum(len(part.faces) for part in scene if part.name != "sphere")
    corners = 2 * random.integers(0, size // 2, (_PACKETS, 1, 1, 2)) + np.indices((2, 2)).reshape(2, 1, 4, 1).T
    x, y = 2.0 * (corners + random.random((_PACKETS, 4, 16, 2))).reshape(-1, 2).T / size - 1.0
    half = np.tan(np.radians(mirrorbox.FOV_DEG / 2))
    directions = np.stack([half * x, -half * y, -np.ones_like(x)], axis=1)
    origins = np.tile(np.array(mirrorbox.EYE), (len(directions), 1))
    met = RayCaster(vertices, faces).closest_hit(origins, directions).primitive.reshape(_PACKETS, 64)
    return float(np.mean([len(set(row)) for row in met[(met >= first).mean(axis=1) > 0.9]]))


def measure_growth(repeats: int, largest: float, scale: int) -> list[dict[str, Any]]:
    """Measure how cost grows; ``scale`` divides the picture's edge (to try the script)."""
    rows: list[dict[str, Any]] = []

    def measure(series: str, value: int, scene: list[mirrorbox.Part], size: int, samples: int, **more: Any) -> None:
        row: dict[str, Any] = {"series": series, "value": value}
        try:
            with tempfile.TemporaryDirectory() as folder:
                compiled = compile_parts(scene, Path(folder), size=size, samples=samples, **more)
                seconds = median_cpu_s(compiled, repeats)
            row |= {"cpu_s": seconds, "s_per_sample": seconds / (size * size * samples)}
        except (MemoryError, OSError, RuntimeError, ValueError) as error:
            row["note"] = f"{type(error).__name__}: {error}"
        rows.append(row)
        print(row, flush=True)

    size = 256 // scale
    exponents = [exponent for exponent in range(2, 8) if 10**exponent <= largest]
    for exponent in exponents:
        scene = mirrorbox.parts(10**exponent)
        measure("triangles", sum(len(part.faces) for part in scene), scene, size, 16)
        rows[-1] |= {"size": size, "met_by_packet": triangles_met(scene, size)}
    # as many triangles a pixel as the next or the last of these has
    for exponent, edge in zip(exponents[-2:], (size / 10**0.5, size * 10**0.5), strict=False):
        scene = mirrorbox.parts(10**exponent)
        measure("fineness", sum(len(part.faces) for part in scene), scene, round(edge), 16)
        rows[-1] |= {"size": round(edge), "met_by_packet": triangles_met(scene, round(edge))}
    for lights in (1, 2, 4, 8, 16, 32, 64):
        measure("lights", lights, mirrorbox.parts(), size, 4, lights=lights)
    for edge in (64, 128, 256, 512, 1024):
        measure("resolution", edge // scale, mirrorbox.parts(), edge // scale, 16)
    for depth in (0, 1, 2, 4, 8, 16, 32):
        measure("depth", depth, mirrorbox.parts(mirror_walls=True), size, 16, depth=depth)
    return rows


def main() -> int:
    """Measure what is asked for, write the page, print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="whole,start,compile,growth", help="also: workers")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--largest", type=float, default=1e7, help="triangles, for growth")
    parser.add_argument("--peer", default=os.environ.get(MITSUBA_PYTHON), help="a Python with mitsuba")
    parser.add_argument("--small", action="store_true", help="to try the script: small sizes, pages into out/")
    options = parser.parse_args()
    chosen = set(options.only.split(","))
    size = 128 if options.small else options.size
    repeats = 2 if options.small else options.repeats
    is_result = not options.small and options.repeats >= 5 and options.size == 512
    folder = REPOSITORY / ("benchmarks/results" if is_result else "out")
    parts: dict[str, Callable[[], Any]] = {
        "whole": lambda: [
            measure_whole(name, mirrorbox.parts(triangles, sphere_mirror=mirror), size, repeats, options.peer)
            for name, triangles, mirror in WHOLE
        ],
        "start": lambda: measure_start(repeats, options.peer),
        "compile": measure_compile,
        "growth": lambda: measure_growth(
            1 if options.small else repeats,
            min(options.largest, 1e4 if options.small else 1e9),
            4 if options.small else 1,
        ),
        "workers": lambda: measure_workers(
            repeats, 2.0 if options.small else 60.0, REPOSITORY / "out" / "workers.json"
        ),
    }
    unknown = chosen - parts.keys()
    if unknown:
        parser.error(f"--only {','.join(sorted(unknown))}: expected some of {','.join(parts)}")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "jobs.json"
    # what is not measured now stays as it was measured before: the long rows come by runs of their own
    result: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    for name, measure in parts.items():
        if name in chosen:
            result[name] = {"machine": describe_machine(), "rows": measure()}
            print(json.dumps(result[name]["rows"], indent=1), flush=True)
            path.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")
    write_page(result, folder)
    print((folder / "jobs.md").read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
