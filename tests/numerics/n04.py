"""N4 and N5 by every path: faces without area, duplicates, slivers, denormals; flat boxes and signed zeros."""

import numpy as np
from by_packets import BUDGETS, by_packets
from row import Row

from tests.numerics.closed_meshes import by_brute_force, flat_boxes
from tracer.rays import RayCaster


def compare(vertices, faces, origins, directions):
    """(rays on which the paths differ from brute force, NaNs among the results, rays that meet anything)."""
    caster = RayCaster(vertices, faces)
    hits = caster.closest_hit(origins, directions)
    times, primitives, crossings = by_brute_force(vertices, faces, origins, directions)
    differs = (hits.t != times) | (hits.primitive != primitives) | (caster.count_hits(origins, directions) != crossings)
    nans = sum(int(np.isnan(column).sum()) for column in hits)
    for budget in BUDGETS:
        packet_times, packet_primitives, met = by_packets(caster.bvh, origins, directions, budget=budget)
        differs |= (packet_times != times) | (packet_primitives != primitives) | (met != (primitives >= 0))
        nans += int(np.isnan(packet_times).sum())
    return int(differs.sum()), nans, int((crossings > 0).sum())


def degenerate(n, rng):
    vertices = rng.normal(size=(60, 3))
    vertices[10:20] = vertices[0] + (vertices[1] - vertices[0]) * rng.random((10, 1))
    vertices[20:30] = vertices[2]
    vertices[30:40] *= 1e-310
    vertices[40:50] = vertices[3] + 1e-12 * rng.normal(size=(10, 3))
    faces = rng.integers(0, 60, (300, 3)).astype(np.int32)
    faces = np.concatenate([faces, faces[:30, [1, 2, 0]], faces[:30]])
    origins = rng.normal(size=(n, 3)) * 2
    return vertices, faces, origins, vertices[rng.integers(0, 60, n)] - origins


def run(cases, seed=4):
    rng = np.random.default_rng(seed)
    total = wrong = nans = 0
    while total < cases:
        n = min(20_000, cases - total)
        differs, bad, _ = compare(*degenerate(n, rng))
        total, wrong, nans = total + n, wrong + differs, nans + bad
    return Row("N4", "degenerate triangles, all paths = brute force", total, wrong + nans, 0.0, 0.0, f"NaN {nans}")


def run_slabs(cases, seed=5):
    rng = np.random.default_rng(seed)
    vertices, faces = flat_boxes()
    values = np.array([0.0, -0.0, 1.0, -1.0, 1e-310, -1e-310, 0.5])
    places = np.array([-1.0, -0.5, 0.0, 0.25, 1.0, -2.0])
    every = np.array([[a, b, c] for a in values for b in values for c in values])
    every = every[np.abs(every).max(1) > 1e-300]
    directions = np.concatenate([every, every[rng.integers(0, len(every), cases - len(every))]])
    origins = places[rng.integers(0, len(places), directions.shape)]
    wrong, nans, met = compare(vertices, faces, origins, directions)
    assert met > 0.2 * cases  # else the rays would tell little
    return Row("N5", "flat boxes, signed zeros, all paths = brute force", cases, wrong + nans, 0.0, 0.0)
