"""Where rounding alone decides whether a lamp is hidden, four corner rays must not speak for a wave.

A lamp in the plane of an opaque panel, as a bulb in a ceiling, is met or hidden by the last bit of t. The oracle is the
same picture with every ray traced.
"""

import numpy as np
import pytest

from tests.tracer.integrators.test_integrators_corners import NARROW, both, point
from tests.tracer.render.hand_made import build, material, settings
from tracer.types import LIGHT_KIND_POINT


@pytest.mark.parametrize("seed", range(6))
def test_a_lamp_in_the_plane_of_a_panel(seed):
    """The panel is tilted, and the lamp in it rounded to floats: above it for some rays, below it for others."""
    rng = np.random.default_rng(seed)
    lamp = rng.uniform([-0.5, -0.5, 1.5], [0.5, 0.5, 2.5])
    along, up = np.eye(2, 3) + rng.uniform(-0.3, 0.3, (2, 3))
    panel = [lamp + x * along + y * up for x, y in ((-7, -9), (8, -9), (8, 11), (-7, 11))]
    wall = [[-400, -100, -4], [400, -100, -4], [0, 400, -4], [-400, 400, -4]]
    scene = build(
        quads=[(wall, material(kd=0.7)), (panel, material())],
        lights=[point(lamp)],
        light_kind=[LIGHT_KIND_POINT],
        settings=settings(width=96, height=96, samples=16),
        camera=NARROW,
    )
    both(scene)
