"""Where rounding alone decides whether a lamp is hidden, four corner rays must not speak for a wave.

Shadow rays end a few roundings before their lamp. An opaque panel right there, tilted by a few roundings, hides the lamp
from some points and not from their neighbours. The oracle is the same picture with every ray traced.
"""

import numpy as np

from tests.tracer.integrators.test_integrators_corners import NARROW, both, point
from tests.tracer.render.hand_made import build, material, settings
from tracer.render import get_backend, list_blocks
from tracer.shading.lights import BEFORE_LIGHT
from tracer.types import LIGHT_KIND_POINT


def test_a_panel_where_shadow_rays_end():
    rng = np.random.default_rng(56)
    lamp = np.array([0.11, 0.07, 2.0])
    far = 6.0  # from the wall to the lamp
    wall = [[-400, -100, -4], [400, -100, -4], [0, 400, -4], [-400, 400, -4]]
    n_undecided = 0
    for _ in range(24):
        z = -4.0 + far * BEFORE_LIGHT + 2.0**-52 * rng.integers(-4, 5, 4)
        panel = [[x, y, depth] for (x, y), depth in zip(((-7, -9), (8, -9), (8, 11), (-7, 11)), z, strict=True)]
        scene = build(
            quads=[(wall, material(kd=0.7)), (panel, material())],
            lights=[point(lamp)],
            light_kind=[LIGHT_KIND_POINT],
            settings=settings(width=96, height=96, samples=16),
            camera=NARROW,
        )
        both(scene)
        lit = get_backend().render(scene, list_blocks(scene), (0, 16), np.zeros(1, np.int64)).sums > 0
        n_undecided += bool(lit.any() and not lit.all())
    assert n_undecided >= 6
