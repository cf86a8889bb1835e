"""N23: sums of samples against `math.fsum`: many of them, of 1e-30 beside 1e30, in calls of any length.

Samples are not negative, as radiance is: else no sum of a fixed length has a bound in ulps.
"""

import math

import numpy as np
from row import Row

from tracer.integrators.sums import add_up
from tracer.jit import kernel
from tracer.simd import address_of


@kernel
def add_calls(values, ends, sums):
    first = 0
    for end in ends:
        add_up(address_of(values) + 8 * first, end - first, first & 1, sums, 0)
        first = end


def run(cases, seed=23, chunk=1_000_000):
    rng = np.random.default_rng(seed)
    total, worst, wrong = 0, 0.0, 0
    while total < cases:
        n = min(chunk, cases - total)
        values = rng.random(n) * 10.0 ** rng.uniform(-rng.integers(0, 31), rng.integers(0, 31), n)
        values[rng.integers(0, n)] = rng.choice([0.0, 1e30])
        ends = np.unique(np.append(rng.integers(1, n + 1, 1 + n // 300), n))
        sums = np.zeros(12)
        add_calls(values, ends, sums)
        for half in range(2):
            want = math.fsum(values[half::2].tolist())
            got = float(sums[3 * half] + sums[3 * half + 6])
            wrong += not math.isfinite(got)
            worst = max(worst, abs(got - want) / math.ulp(want))
        total += n
    return Row("N23", "sums of samples against fsum", total, wrong, worst, 2.0, "ulp")
