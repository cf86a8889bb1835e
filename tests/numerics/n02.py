"""N2: single rays and packets give the same primitive and, bit for bit, the same t; brute force on a part of them.

Packets as rays come (incoherent: bundles of few) and as a pinhole would send them (one origin, sorted by direction).
"""

import numpy as np
from closed_meshes import by_brute_force
from n01 import batches
from packets import by_packets
from row import Row

BRUTE = 200  # rays a batch that every face is tested against


def fan_out(origins, directions):
    """The same targets from one origin, sorted: rays that share packets."""
    targets = origins + directions
    directions = targets - origins[0]
    order = np.lexsort((directions[:, 2], directions[:, 1], directions[:, 0], np.abs(directions).argmax(1)))
    directions = directions[order]
    keep = np.abs(directions).max(1) > 0
    return np.broadcast_to(origins[0], directions.shape)[keep].copy(), directions[keep]


def run(cases, seed=2):
    total = brute = 0
    wrong = {"single": 0, "packet": 0, "any-hit in packets": 0}
    for _cell, caster, vertices, faces, origins, directions in batches(cases // 2, seed):
        for o, d in ((origins, directions), fan_out(origins, directions)):
            hits = caster.closest_hit(o, d)
            times, primitives, met = by_packets(caster.bvh, o, d)
            wrong["packet"] += int(((times != hits.t) | (primitives != hits.primitive)).sum())
            wrong["any-hit in packets"] += int((met != (hits.primitive >= 0)).sum())
            true_times, true_primitives, _ = by_brute_force(vertices, faces, o[:BRUTE], d[:BRUTE])
            differs = (true_times != hits.t[:BRUTE]) | (true_primitives != hits.primitive[:BRUTE])
            wrong["single"] += int(differs.sum())
            total += len(o)
            brute += len(o[:BRUTE])
    note = ", ".join(f"{name} {count}" for name, count in wrong.items()) + f"; {brute:,} by brute force"
    return Row("N2", "single = packet = brute force", total, sum(wrong.values()), 0.0, 0.0, note)
