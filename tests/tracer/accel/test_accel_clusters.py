"""The tree over groups, held against a plain search for the closest pair."""

import numpy as np
import pytest

from tracer.accel.sorting import _join_groups as join_groups
from tracer.accel.sorting import empty_aligned


def groups_of(low, high):
    groups = empty_aligned((len(low), 8), np.float32)
    groups[:, :3], groups[:, 4:7] = low, -high
    groups.view(np.int32)[:, 3] = 100 * np.arange(len(low))
    groups.view(np.int32)[:, 7] = 1 + np.arange(len(low))
    return groups


def join(groups):
    n = len(groups)
    nodes, depths = empty_aligned((2 * n, 8), np.float32), np.empty(2 * n, np.int64)
    clusters, kids = empty_aligned((2 * n, 8), np.float32), np.empty((2 * n, 2), np.int64)
    assert join_groups(groups, clusters, kids, nodes, depths) == 2 * n - 1
    return nodes[: 2 * n - 1], depths[: 2 * n - 1]


def members(nodes):
    """Return, for each node, which groups are below it; the index is the record's, a hundredth."""
    words = nodes.view(np.int32)
    below = [frozenset()] * len(nodes)
    for node in range(len(nodes) - 1, -1, -1):
        first = words[node, 3]
        below[node] = frozenset([first // 100]) if words[node, 7] else below[first] | below[first + 1]
    return below


def half_area(box):
    x, y, z = -(box[:3] + box[4:7]).astype(np.float64)
    return x * (y + z) + y * z


@pytest.mark.parametrize("n", [1, 2, 3, 40])
def test_closest_pairs_are_joined_first(n):
    rng = np.random.default_rng(n)
    low = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
    groups = groups_of(low, low + rng.uniform(0, 0.3, (n, 3)).astype(np.float32))
    nodes, depths = join(groups)
    clusters = {frozenset([k]): groups[k] for k in range(n)}
    expected = set(clusters)
    while len(clusters) > 1:
        pairs = [(a, b) for a in clusters for b in clusters if min(a) < min(b)]
        a, b = min(pairs, key=lambda pair: half_area(np.minimum(clusters[pair[0]], clusters[pair[1]])))
        clusters[a | b] = np.minimum(clusters.pop(a), clusters.pop(b))
        expected.add(a | b)
    below = members(nodes)
    assert set(below) == expected
    words = nodes.view(np.int32)
    assert depths[0] == 0
    for node, some in enumerate(below):
        box = groups[sorted(some)].min(0)
        np.testing.assert_array_equal(nodes[node, [0, 1, 2, 4, 5, 6]], box[[0, 1, 2, 4, 5, 6]])
        if words[node, 7]:
            assert words[node, 7] == 1 + min(some)
        else:
            assert (depths[words[node, 3] : words[node, 3] + 2] == depths[node] + 1).all()


def test_depth_is_bounded():
    """Boxes in boxes would be joined one by one."""
    size = (2.0 ** np.arange(60.0))[:, None] * np.ones(3)
    nodes, depths = join(groups_of(-size, size))
    assert depths.max() == 6
    assert members(nodes)[0] == frozenset(range(60))
