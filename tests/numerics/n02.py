"""N2: single rays, packets and placements give the same primitive and, bit for bit, the same t; brute force on a part.

Packets as rays come (incoherent: bundles of few) and as a pinhole would send them (one origin, sorted by direction).
A placement that is moved decides about the ray in its own space: brute force does so about the same moved ray.
"""

import numpy as np
from closed_meshes import by_brute_force
from n01 import batches
from packets import by_packets
from row import Row

from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.placements import place, random_turn, rows_of
from tracer.types import MAP_ORIGIN, MAP_TO_OBJECT

BRUTE = 200  # rays a batch that every face is tested against


def fan_out(origins, directions):
    """The same targets from one origin, sorted: rays that share packets."""
    targets = origins + directions
    directions = targets - origins[0]
    order = np.lexsort((directions[:, 2], directions[:, 1], directions[:, 0], np.abs(directions).argmax(1)))
    directions = directions[order]
    keep = np.abs(directions).max(1) > 0
    return np.broadcast_to(origins[0], directions.shape)[keep].copy(), directions[keep]


def moved_rays(origins, directions, row):
    """Rays in a placement's own space, by the renderer's arithmetic: the direction from its shear, products in order."""
    kz = 2 - np.abs(directions[:, ::-1]).argmax(1)  # z before y before x where equal
    n = np.arange(len(kz))
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    inverse = 1.0 / directions[n, kz]
    again = directions.copy()
    again[n, kx] = (directions[n, kx] * inverse) * directions[n, kz]
    again[n, ky] = (directions[n, ky] * inverse) * directions[n, kz]
    m = row[MAP_TO_OBJECT : MAP_TO_OBJECT + 9].reshape(3, 3)
    by = lambda v: np.stack([m[k, 0] * v[:, 0] + m[k, 1] * v[:, 1] + m[k, 2] * v[:, 2] for k in range(3)], 1)  # noqa: E731
    return by(origins - row[MAP_ORIGIN : MAP_ORIGIN + 3]), by(again)


def by_placements(vertices, faces, origins, directions, rng):
    """Wrong answers of a scene with one mesh as it is, one moved, and one too far away to be met."""
    size = np.abs(vertices - vertices.mean(0)).max()
    turned = random_turn(rng) @ np.diag([1.0, rng.choice([-1.0, 1.0]), 2.0])
    shift = vertices.mean(0) - turned @ vertices.mean(0) + rng.standard_normal(3) * size
    uses = [(0, None), (0, rows_of(turned, shift)), (0, rows_of(np.eye(3), [1e9 * (size + np.abs(shift).max()), 0, 0]))]
    scene = place([(vertices, faces)], uses).scene
    hits = find_closest(scene, origins, directions)
    t, primitive, _ = by_brute_force(vertices, faces, origins, directions)
    moved = by_brute_force(vertices, faces, *moved_rays(origins, directions, scene.placement_maps[1]))
    nearer = moved[0] < t
    t, primitive = np.where(nearer, moved[0], t), np.where(nearer, moved[1] + len(faces), primitive)
    return int(((hits.t != t) | (hits.primitive != primitive)).sum())


def run(cases, seed=2):
    total = brute = 0
    wrong = {"single": 0, "packet": 0, "any-hit in packets": 0, "placements": 0}
    rng = np.random.default_rng(seed)
    for _cell, caster, vertices, faces, origins, directions in batches(cases // 2, seed):
        for o, d in ((origins, directions), fan_out(origins, directions)):
            hits = caster.closest_hit(o, d)
            times, primitives, met = by_packets(caster.bvh, o, d)
            wrong["packet"] += int(((times != hits.t) | (primitives != hits.primitive)).sum())
            wrong["any-hit in packets"] += int((met != (hits.primitive >= 0)).sum())
            true_times, true_primitives, _ = by_brute_force(vertices, faces, o[:BRUTE], d[:BRUTE])
            wrong["placements"] += by_placements(vertices, faces, o[:BRUTE], d[:BRUTE], rng)
            differs = (true_times != hits.t[:BRUTE]) | (true_primitives != hits.primitive[:BRUTE])
            wrong["single"] += int(differs.sum())
            total += len(o)
            brute += len(o[:BRUTE])
    note = ", ".join(f"{name} {count}" for name, count in wrong.items()) + f"; {brute:,} by brute force"
    return Row("N2", "single = packet = placement = brute force", total, sum(wrong.values()), 0.0, 0.0, note)
