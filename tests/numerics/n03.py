"""N3: nearly degenerate ray/triangle pairs against fractions: hit or miss exact, t within its published bound."""

from fractions import Fraction

import numpy as np
from row import Row
from test_predicate import EPS, KINDS, on_floats, pairs, predicate


def run(cases, seed=3):
    each = max(1, cases // len(KINDS))
    rng = np.random.default_rng(seed)
    total = wrong = 0
    worst = 0.0
    for kind in KINDS:
        triangles, origins, directions = pairs(kind, each, rng)
        met, times = predicate(triangles, origins, directions)
        for i in range(each):
            want = on_floats(triangles[i], origins[i], directions[i])
            wrong += met[i] != want[0]
            if met[i] and want[0] and np.isfinite(times[i]):
                _, t, spread = want
                # products of denormals lose what no weight can make good
                relative = 3 * 2.0**-24 if kind == "denormal" else 8 * EPS
                bound = relative * spread + 4 * EPS * abs(float(t)) + 5e-324
                worst = max(worst, float(abs(Fraction(float(times[i])) - t) / Fraction(bound)))
        total += each
    return Row("N3", "predicate against fractions", total, int(wrong), worst, 1.0, "t's error in units of its bound")
