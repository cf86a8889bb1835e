"""One triangle, and beams across its edges: what part of a beam meets is not said of all."""

import numpy as np
import pytest
from beams import Beams, answers_of

from tracer.rays import RayCaster
from tracer.rays.packet import NONE, SEVERAL

TRIANGLE = np.array([[-1.0, -1.0, -2.0], [1.0, -1.0, -2.0], [0.0, 1.0, -2.0]])


@pytest.mark.parametrize(("x", "expected"), [((-0.1, 0.1), 0), ((0.2, 0.4), SEVERAL), ((0.6, 0.8), NONE)])
def test_a_beam_from_a_point(x, expected):
    ways = np.array([[[u, v, -1.0] for v in (-0.05, 0.05) for u in x]])
    beam = Beams(np.zeros_like(ways), ways, np.array([np.inf]))
    caster = RayCaster(TRIANGLE, np.array([[0, 1, 2]]))
    assert answers_of(caster.bvh.buffer, 1, beam, until_hit=False)[0, 1] == expected
