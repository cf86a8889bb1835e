"""Rays per second of `RayCaster` beside Embree (the ``embreex`` wheel, its default robust mode), in one process.

    python -m benchmarks.rays [--meshes cornell,sphere-80k,...] [--kinds primary,...] [--rays 1000000] [--repeats 5]
        [--json FILE]

Five meshes in boxes; primary rays in scan order, cosine-distributed bounces from where they hit, and shadow rays to a
point light. t, primitive, u and v are returned by both. Both take turns, each run is measured in CPU time of the
process, and the median of the runs counts: so a busy machine slows both alike. Building is timed the same way,
against Embree's commit alone, which the wheel does with the first ray; its own copying of the mesh, more than half of
the whole call, is not counted.

Two threads are timed by the clock against one, in turn, in memory that the process has touched before (whether fresh
pages come large or small decides more than the second thread does), and the least of each counts. The processor time
of both stands beside it: what the second thread costs.

Needs ``embreex``: ``pip install smalti[bench]``.
"""

import argparse
import contextlib
import ctypes
import json
import math
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.rays import RayCaster

Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]
KINDS = ("primary", "bounce", "shadow")
LIGHT = np.array([0.2, 1.2, -0.3])
EYE = np.array([0.0, 0.35, -1.55])


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Any, Any]:
    """Twelve triangles."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])


def lattice(n: int, m: int) -> NDArray[np.int64]:
    """Two triangles for each cell of a grid of (n + 1) x (m + 1) vertices."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a = (i * (m + 1) + j).ravel()
    return np.concatenate([np.stack([a, a + m + 1, a + 1], -1), np.stack([a + 1, a + m + 1, a + m + 2], -1)])


def bumpy_sphere(n: int) -> tuple[Any, Any]:
    """4 n**2 triangles."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    r = 1 + 0.03 * np.sin(17 * theta) * np.cos(23 * phi)
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    return (r[..., None] * points).reshape(-1, 3), lattice(n, 2 * n)


def terrain(n: int) -> tuple[Any, Any]:
    """2 n**2 triangles."""
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, n + 1), np.linspace(-1.5, 1.5, n + 1), indexing="ij")
    z = 0.15 * np.sin(5 * x) * np.cos(4 * y) + 0.04 * np.sin(23 * x + 1) * np.cos(31 * y)
    z += 0.01 * np.sin(97 * x) * np.sin(89 * y) - 0.5
    return np.stack([x, z, y], -1).reshape(-1, 3), lattice(n, n)


def soup(n: int) -> tuple[Any, Any]:
    """Draw n small random triangles."""
    rng = np.random.default_rng(1)
    centres = rng.uniform(-1.4, 1.4, (n, 1, 3))
    return (centres + rng.normal(size=(n, 3, 3)) * 0.02).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def in_a_box(*parts: tuple[Any, Any]) -> Mesh:
    """Join meshes with a box around them."""
    vertices, faces, count = [], [], 0
    for points, triangles in (box((-1.6, -1.6, -1.6), (1.6, 1.6, 1.6)), *parts):
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32)


MESHES: dict[str, Callable[[], Mesh]] = {
    "cornell": lambda: in_a_box(box((-0.6, -1.6, -0.5), (-0.1, 0.2, 0.1)), box((0.1, -1.6, -0.1), (0.6, -0.4, 0.5))),
    "sphere-80k": lambda: in_a_box(bumpy_sphere(142)),
    "sphere-1.3m": lambda: in_a_box(bumpy_sphere(572)),
    "terrain-1m": lambda: in_a_box(terrain(707)),
    "soup-200k": lambda: in_a_box(soup(200_000)),
}


def primary_rays(n: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Aim about n rays from the eye in scan order."""
    side = math.isqrt(n)
    y, x = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    u, v = (x + 0.5) / side * 2 - 1, 1 - (y + 0.5) / side * 2
    directions = np.stack([u * 0.75, v * 0.75 - 0.15, np.ones_like(u)], -1).reshape(-1, 3).astype(np.float32)
    return np.broadcast_to(EYE.astype(np.float32), directions.shape).copy(), directions


def secondary_rays(mesh: Mesh, caster: RayCaster, origins: Any, directions: Any) -> tuple[Any, Any, Any]:
    """Return (points a little off where primary rays hit, cosine bounces, directions to the light)."""
    vertices, faces = mesh
    hits = caster.closest_hit(origins, directions)
    met = hits.primitive >= 0
    points = (origins + hits.t[:, None] * directions)[met]
    a, b, c = (vertices[faces[hits.primitive[met], k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    normals[(normals * directions[met]).sum(1) > 0] *= -1
    points = (points + normals * 1e-4).astype(np.float32)
    on_sphere = np.random.default_rng(0).normal(size=points.shape)
    on_sphere /= np.linalg.norm(on_sphere, axis=1, keepdims=True)
    return points, (normals + 0.999 * on_sphere).astype(np.float32), (LIGHT - points).astype(np.float32)


def cpu_seconds(work: Callable[[], Any]) -> float:
    """Time one call in this process's CPU time."""
    start = time.process_time()
    work()
    return time.process_time() - start


def taking_turns(first: Callable[[], Any], second: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Return the medians of both, run in turn; the first turn does not count."""
    times = [(cpu_seconds(first), cpu_seconds(second)) for _ in range(repeats + 1)][1:]
    return statistics.median(t for t, _ in times), statistics.median(t for _, t in times)


def embree_of(mesh: Mesh) -> tuple[Any, float]:
    """Build Embree's scene; returns it, and the CPU seconds of its commit, which comes with the first ray."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, *mesh)
    one = np.ones((1, 3), np.float32)
    return scene, cpu_seconds(lambda: scene.run(one, one))


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


def measure_build(name: str, mesh: Mesh, repeats: int) -> tuple[dict[str, Any], Any, Any]:
    """Return (row, our caster, Embree's scene)."""
    runs = []
    for _ in range(min(repeats, 5) + 1):
        ours = cpu_seconds(lambda: RayCaster(*mesh))
        embree, theirs = embree_of(mesh)
        runs.append((ours, theirs))
    ours, theirs = (statistics.median(column) for column in zip(*runs[1:], strict=True))
    caster = RayCaster(*mesh)
    n = len(mesh[1])
    row = {"mesh": name, "work": "build", "count": n, "ours_s": ours, "embree_s": theirs, "agree": 1.0}
    row |= {"bytes_per_triangle": caster.bvh.n_bytes / n}
    row |= one_and_two_threads(lambda threads: RayCaster(*mesh, threads=threads), repeats)
    return row, caster, embree


def measure(name: str, n_rays: int, repeats: int, kinds: list[str]) -> list[dict[str, Any]]:
    """Measure one mesh; returns a row a kind of work."""
    mesh = MESHES[name]()
    row, caster, embree = measure_build(name, mesh, repeats)
    rows = [row]
    eyes, views = primary_rays(n_rays)
    points, bounces, to_light = secondary_rays(mesh, caster, eyes, views)
    ones = np.ones(len(points), np.float32)
    closest = {"primary": (eyes, views), "bounce": (points, bounces)}
    for work, (origins, directions) in ((kind, closest[kind]) for kind in kinds if kind in closest):
        run = lambda o=origins, d=directions: embree.run(o, d, query="INTERSECT", output=1)  # noqa: E731
        cast = lambda o=origins, d=directions: caster.closest_hit(o, d)  # noqa: E731
        ours, theirs = taking_turns(cast, run, repeats)
        agree = float((run()["primID"] == cast().primitive).mean())
        rows.append(
            {"mesh": name, "work": work, "count": len(origins), "ours_s": ours, "embree_s": theirs, "agree": agree}
        )
    if "shadow" not in kinds:
        return rows
    cast_any = lambda: caster.any_hit(points, to_light, 0.0, 1.0)  # noqa: E731
    occluded = lambda: embree.run(points, to_light, ones, query="OCCLUDED")  # noqa: E731
    ours, theirs = taking_turns(cast_any, occluded, repeats)
    agree = float(((occluded() >= 0) == cast_any()).mean())
    rows.append(
        {"mesh": name, "work": "shadow", "count": len(points), "ours_s": ours, "embree_s": theirs, "agree": agree}
    )
    return rows


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", default=",".join(MESHES))
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kinds", default=",".join(KINDS), help="of rays; building is always measured")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for name in options.meshes.split(","):
        for row in measure(name, options.rays, options.repeats, options.kinds.split(",")):
            rows.append(row)
            million = row["count"] / 1e6
            ours, theirs = million / row["ours_s"], million / row["embree_s"]
            print(
                f"{row['mesh']:12s} {row['work']:8s} {ours:7.2f} M/s, Embree {theirs:7.2f} M/s: "
                f"{ours / theirs:5.2f} x, "
                + (
                    f"2 threads {row['two_threads']:.2f} x by the clock for "
                    f"{row['two_threads_cpu_s'] / row['one_thread_cpu_s']:.2f} x the processor time, "
                    f"{row['bytes_per_triangle']:.1f} bytes a triangle"
                    if row["work"] == "build"
                    else f"same answer {row['agree']:.6f}"
                ),
                flush=True,
            )
    for work in ("build", *options.kinds.split(",")):
        ratios = [row["embree_s"] / row["ours_s"] for row in rows if row["work"] == work]
        print(f"geometric mean {work:8s} {statistics.geometric_mean(ratios):.2f} x, least {min(ratios):.2f} x")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
