"""The stress suite's table: which tests there are, how many cases small and at full size, and what waits for what.

Invariant: a test is a function ``run(cases, seed) -> Row``; pytest and ``make stress`` call the same ones.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple

import n01
import n02
import n03
import n04
import n06
import n07
import n09
import n10
import n11
import n12
import n16
import n21
import n22
import n23
import n24
from row import Row


class Test(NamedTuple):
    """A test and its sizes; the full one is shared out over ``shards`` processes' tasks, each with a seed of its own."""

    run: Callable[..., Any]
    small: int
    full: int
    shards: int = 1


TESTS = {
    "N1": Test(n01.run, 6_000, 60_000_000, 24),
    "N2": Test(n02.run, 4_000, 20_000_000, 20),
    "N3": Test(n03.run, 500, 100_000, 2),
    "N4": Test(n04.run, 2_000, 1_000_000, 2),
    "N5": Test(n04.run_slabs, 12_000, 2_000_000, 2),
    "N6": Test(n06.run, 20_000, 6_000_000, 2),
    "N7": Test(n07.run, 300, 100_000, 2),
    "N8": Test(n07.run_shapes, 400, 100_000, 2),
    "N9": Test(n09.run, 3_000, 10_000_000, 4),
    "N10": Test(n10.run, 2_000, 10_000_000, 2),
    "N11": Test(n11.run, 300, 20_000, 2),
    "N12": Test(n12.run, 500, 100_000, 2),
    "N15": Test(n16.run_orders, 3, 100, 1),
    "N16": Test(n16.run, 3_000, 100_000, 1),
    "N18": Test(n12.run_attenuation, 300, 100_000, 1),
    "N19": Test(n12.run_power, 300, 100_000, 1),
    "N21": Test(n21.run, 5_000, 1_000_000, 1),
    "N22": Test(n22.run, 50, 6_000, 2),
    "N23": Test(n23.run, 20_000, 200_000_000, 4),
    "N24": Test(n24.run, 300, 20_000, 2),
}
ELSEWHERE = {"N25": "make mutants"}
WAITING = {
    "N13": "waits for nested media",
    "N14": "waits for the path tracer's orthonormal basis",
    "N17": "waits for the path tracer's samplers, BSDFs and area lights",
    "N20": "waits for a treatment of the shadow terminator",
}


def run_shard(name: str, cases: int, shard: int) -> tuple[str, Row]:
    """Run a part of a test; the first has the test's own seed."""
    run = TESTS[name].run
    return name, run(cases) if shard == 0 else run(cases, seed=1000 * shard + len(name))


def merged(rows: list[Row]) -> Row:
    """Join the rows of a test's parts: the note is that of the worst part."""
    worst = max(rows, key=lambda row: (row.failures, row.worst))
    cases, failures = sum(row.cases for row in rows), sum(row.failures for row in rows)
    return worst._replace(cases=cases, failures=failures)


def run_all(names: list[str], scale: float, processes: int, done: Callable[[Row], None]) -> list[Row]:
    """Run tests at ``scale`` times their full size (0: as small as pytest); ``done`` is told of each as it ends."""
    parts: dict[str, list[Row]] = {name: [] for name in names}
    shards = {name: TESTS[name].shards if scale else 1 for name in names}
    rows = []
    with ProcessPoolExecutor(processes) as pool:
        tasks = []
        for name in names:
            test = TESTS[name]
            cases = max(test.small, round(test.full * scale / shards[name]))
            tasks += [pool.submit(run_shard, name, cases, shard) for shard in range(shards[name])]
        for task in as_completed(tasks):
            name, row = task.result()
            parts[name].append(row)
            if len(parts[name]) == shards[name]:
                rows.append(merged(parts[name]))
                done(rows[-1])
    return rows
