"""N15 and N16: coincident triangles in any build order give the same answer, and build a tree that is not deep."""

import time

import numpy as np
from by_packets import by_packets
from row import Row

from tests.numerics.closed_meshes import sphere
from tracer.accel.layout import HEADER_DEPTH, MAX_DEPTH
from tracer.accel.wide import build_wide
from tracer.rays import RayCaster


def run_orders(cases, seed=15):
    """Cases are build orders; each meets the lowest of the coincident faces, by every path."""
    vertices, faces = sphere(8, 8)
    rng = np.random.default_rng(seed)
    origins, directions = rng.normal(size=(128, 3)) * 0.2, rng.normal(size=(128, 3))
    plain = RayCaster(vertices, faces).closest_hit(origins, directions)
    copies = np.concatenate([faces, faces[:, [1, 2, 0]], faces[:, [2, 1, 0]]])
    wrong = 0
    for _ in range(cases):
        order = rng.permutation(len(copies))
        lowest = np.full(len(faces), len(copies))
        np.minimum.at(lowest, order % len(faces), np.arange(len(copies)))
        caster = RayCaster(vertices, copies[order])
        hits = caster.closest_hit(origins, directions)
        times, primitives, _ = by_packets(caster.bvh, origins, directions)
        right = (hits.t == plain.t) & (hits.primitive == lowest[plain.primitive])
        wrong += int((~right | (times != plain.t) | (primitives != hits.primitive)).any())
    return Row("N15", "coincident faces, build orders", cases, wrong, 0.0, 0.0)


def run(cases, seed=16):
    """Identical triangles, and triangles of one centroid: depth bounded, time at most twice the ordinary build's."""
    rng = np.random.default_rng(seed)
    triangle = rng.normal(size=(3, 3))
    ordinary = rng.normal(size=(cases, 1, 3)) + 0.01 * rng.normal(size=(cases, 3, 3))
    same = np.broadcast_to(triangle, (cases, 3, 3))
    spokes = rng.normal(size=(cases, 3, 3))
    spokes -= spokes.mean(1, keepdims=True)
    faces = np.arange(3 * cases).reshape(-1, 3)
    seconds, depths = {}, {}
    for name, triangles in (("ordinary", ordinary), ("same", same), ("spokes", spokes)):
        vertices = np.ascontiguousarray(triangles).reshape(-1, 3)
        best = float("inf")
        for _ in range(3):
            start = time.process_time()
            bvh = build_wide(vertices, faces)
            best = min(best, time.process_time() - start)
        seconds[name], depths[name] = best, int(bvh.buffer[HEADER_DEPTH])
    slower = max(seconds["same"], seconds["spokes"]) / seconds["ordinary"]
    deep = sum(depth > MAX_DEPTH for depth in depths.values())
    return Row(
        "N16",
        "equal triangles, equal centroids",
        2 * cases,
        deep,
        slower,
        2.0,
        f"build against ordinary; depths {depths}",
    )
