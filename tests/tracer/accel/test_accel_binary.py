"""The binary tree's lowest splits, held against all ways there are."""

from itertools import combinations

import numpy as np
import pytest

from tracer.accel import layout
from tracer.accel.assembly import _bound_records as bound_records
from tracer.accel.assembly import _build_binary as build_binary
from tracer.accel.sorting import empty_aligned


def half_area(boxes):
    x, y, z = boxes[:, 3:].max(0) - boxes[:, :3].min(0)
    return x * (y + z) + y * z


def cost_of(left, right):
    return half_area(left) * len(left) + half_area(right) * len(right)


@pytest.mark.parametrize("n", [3, 4])
def test_three_or_four_records_are_split_in_the_best_way(n):
    rng = np.random.default_rng(n)
    for _ in range(200):
        low = rng.uniform(-1, 0.5, (n, 3))
        boxes = np.concatenate([low, low + rng.uniform(0, 0.5, (n, 3)) ** 2], 1).astype(np.float32).astype(float)
        records = empty_aligned((n, 8), np.float32)
        records[:, :3], records[:, 4:7], records[:, 7] = boxes[:, :3], -boxes[:, 3:], 0.0
        records.view(np.int32)[:, 3] = np.arange(n)
        nodes, bounds = empty_aligned((16, 8), np.float32), np.empty((2, 8), np.float32)
        bound_records(records, 0, n, bounds)
        nodes[0] = bounds[0]
        words = nodes.view(np.int32)
        words[0, 3], words[0, 7] = 0, n
        build_binary(records, nodes, 0, 0, bounds[1], 1, layout.STOP, np.empty((0, 2), np.int64))
        ids = records.view(np.int32)[:, 3]
        assert sorted(ids.tolist()) == list(range(n))
        child = words[0, 3]

        def leaves_below(node, words=words):
            first, count = int(words[node, 3]), int(words[node, 7])
            return set(range(first, first + count)) if count else leaves_below(first) | leaves_below(first + 1)

        left, right = ([int(ids[k]) for k in sorted(leaves_below(node))] for node in (child, child + 1))
        assert sorted(left + right) == list(range(n))
        best = min(
            cost_of(boxes[list(some)], boxes[[k for k in range(n) if k not in some]])
            for size in range(1, n)
            for some in combinations(range(n), size)
        )
        assert cost_of(boxes[left], boxes[right]) <= best * (1 + 1e-5)
        for node, members in ((child, left), (child + 1, right)):
            np.testing.assert_array_equal(nodes[node, :3], boxes[members, :3].min(0))
            np.testing.assert_array_equal(-nodes[node, 4:7], boxes[members, 3:].max(0))
