"""The slab test against rational arithmetic."""

import math
from fractions import Fraction

import numpy as np
import pytest

from tracer.accel.boxes import enter_children, make_slabs
from tracer.jit import kernel, pointer
from tracer.types import Vec3


@kernel
def enter_both(bounds, root, ox, oy, oz, dx, dy, dz, t_max):
    slabs = make_slabs(pointer(root), Vec3(ox, oy, oz), Vec3(dx, dy, dz))
    return enter_children(pointer(bounds), 1, slabs, t_max)


def enter(box, other, child, root, *ray):
    """Entry of a ray into one of the two children of node 1, NaN for a miss."""
    bounds = np.full((2, 3, 2, 2), np.nan)
    bounds[1, :, :, child], bounds[1, :, :, 1 - child] = box, other
    spans = enter_both(bounds, root, *ray)
    near, far = spans[child], spans[2 + child]
    return near if near <= far else math.nan


def exact_box(low, high, o, d):
    """Entry and exit of the closed box in Fractions, or None."""
    near, far = Fraction(0), None
    for k in range(3):
        lo, hi, ok, dk = map(Fraction, (low[k], high[k], o[k], d[k]))
        if dk == 0:
            if not lo <= ok <= hi:
                return None
            continue
        t0, t1 = sorted([(lo - ok) / dk, (hi - ok) / dk])
        near = max(near, t0)
        far = t1 if far is None else min(far, t1)
    return (near, far) if far is None or near <= far else None


def test_slab_test_loses_nothing():
    """N5: origins on faces, edges and corners, flat boxes, signed zeros, tiny directions: no false miss, entry not late."""
    rng = np.random.default_rng(13)
    values = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-310, -1e-310, 1e-17, 3.0]
    n_hits = n_misses = 0
    for k in range(20_000):
        low = rng.choice([-1.0, 0.0, 0.5], 3)
        high = low + rng.choice([0.0, 0.5, 1.0, 1e-16], 3)
        o = np.where(rng.random(3) < 0.6, rng.choice([low, high]), rng.choice([-2.0, 0.25, 2.0], 3))
        d = rng.choice(values, 3)
        if np.abs(d).max() < 1e-300:
            continue  # too short to be a direction: closest_hit does not come here
        box, root = np.stack([low, high], axis=1), np.array([-1, -1, -1, 1.5, 1.5, 1.5])
        found = enter(box, rng.random((3, 2)), k % 2, root, *o, *d, np.inf)
        exact = exact_box(low, high, o, d)
        if exact is None:
            n_misses += math.isnan(found)
            continue
        n_hits += 1
        assert not math.isnan(found)
        assert found <= exact[0]
    assert n_hits > 4000
    assert n_misses > 5000


def test_slab_test_respects_the_end():
    bounds, root = np.array([[1.0, 2], [-1, 1], [-1, 1]]), np.array([1.0, -1, -1, 2, 1, 1])
    empty = np.tile([np.inf, -np.inf], (3, 1))
    assert enter(bounds, empty, 0, root, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 5.0) == pytest.approx(1.0, rel=1e-13)
    assert math.isnan(enter(bounds, empty, 0, root, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.9))
    assert enter(bounds, empty, 0, root, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0) <= 1.0  # touching the end is not beyond it
    assert math.isnan(enter(bounds, empty, 0, root, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 5.0))
    assert enter(bounds, empty, 0, root, 1.5, 0.0, 0.0, -1.0, 0.0, 0.0, 5.0) == 0.0
    assert math.isnan(enter(empty, bounds, 1, root, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, np.inf))
