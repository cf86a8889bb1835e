"""Where bounces end for their throughput, the picture lacks no more than that share of what they would have brought."""

import numpy as np
import pytest

from tests.tracer.integrators.test_integrators_corners import NARROW
from tests.tracer.render.hand_made import build, material, settings
from tracer.render import get_backend, list_blocks
from tracer.types import COUNTERS

KR = np.array([0.7, 0.5, 0.3])


def box():
    """A closed box of glowing mirrors about the eye: a ray brings sum of KR^k, whichever way it goes."""
    c = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    sides = [(0, 1, 2, 3), (5, 4, 7, 6), (4, 0, 3, 7), (1, 5, 6, 2), (3, 2, 6, 7), (4, 5, 1, 0)]
    row = material(ke=1.0, kr=KR.tolist())
    return [(c[list(side)] * [4.0, 3.0, 6.0], row) for side in sides]


@pytest.mark.parametrize("least", [1e-1, 1e-3])
def test_what_is_left_out_is_less_than_the_threshold(least):
    films, skipped = [], []
    for threshold in (least, 0.0):
        scene = build(
            quads=box(),
            limits=[threshold, 0.0],
            settings=settings(width=32, height=32, samples=4, depth=30),
            camera=NARROW,
        )
        film = get_backend().render(scene, list_blocks(scene), (0, 4), np.zeros(1, np.int64))
        films.append(film.sums.sum(1) / 4)
        skipped.append(film.counters[COUNTERS.index("bounces_skipped_throughput")])
    lost = films[1] - films[0]
    assert skipped[0] == 32 * 32 * 4
    assert skipped[1] == 0
    assert (lost > 0).all()
    assert (lost <= least / (1 - KR)).all()
    np.testing.assert_allclose(films[1], np.broadcast_to((1 - KR**31) / (1 - KR), films[1].shape), rtol=1e-12)
