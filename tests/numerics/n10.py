"""N10: nested spheres whose gap is 8 bounds of a hit point's error: a ray that enters the outer meets the inner.

Also when it starts where it entered, offset by the bound. Oracle: the ray aims at the common centre.
"""

import numpy as np
from row import Row

from tests.tracer.rays.spawning import offset_origin
from tracer.geometry.shapes import cross_shape, locate_on_shape
from tracer.geometry.vector import subtract
from tracer.jit import kernel
from tracer.types import SHAPE_SPHERE, Vec3


@kernel
def meet_nested(centres, radii, starts, verdicts):
    """0: the inner sphere is met after the outer, before leaving it; from the outside and from the hit point."""
    for i in range(len(radii)):
        r = radii[i]
        k = 1 / r
        to_world = np.array([r, 0.0, 0.0, 0.0, r, 0.0, 0.0, 0.0, r])
        to_local = np.array([k, 0.0, 0.0, 0.0, k, 0.0, 0.0, 0.0, k])
        centre = Vec3(centres[i, 0], centres[i, 1], centres[i, 2])
        o = Vec3(starts[i, 0], starts[i, 1], starts[i, 2])
        d = subtract(centre, o)
        outer = cross_shape(SHAPE_SPHERE, Vec3(-d.x * k, -d.y * k, -d.z * k), Vec3(d.x * k, d.y * k, d.z * k))
        point = locate_on_shape(SHAPE_SPHERE, centre, to_world, to_local, 0, o, d, outer.t0)
        n = point.normal
        bound = abs(n.x) * point.error.x + abs(n.y) * point.error.y + abs(n.z) * point.error.z
        k = 1 / (r - 8 * bound)
        q = subtract(offset_origin(point.position, point.error, n, d), centre)
        inner = cross_shape(SHAPE_SPHERE, Vec3(q.x * k, q.y * k, q.z * k), Vec3(d.x * k, d.y * k, d.z * k))
        verdicts[i] = 0 if inner.t0 > 0.0 and inner.t1 > inner.t0 else 1
        if not outer.t0 > 0.0:
            verdicts[i] += 2


def run(cases, seed=10):
    rng = np.random.default_rng(seed)
    radii = 10.0 ** rng.uniform(-9, 9, cases)
    centres = rng.normal(size=(cases, 3)) * radii[:, None] * 10.0 ** rng.uniform(-3, 6, (cases, 1))
    away = rng.normal(size=(cases, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    starts = centres + away * radii[:, None] * 10.0 ** rng.uniform(0.2, 3, (cases, 1))
    verdicts = np.empty(cases, np.int64)
    meet_nested(centres, radii, starts, verdicts)
    return Row("N10", "nested spheres, gap of 8 bounds", cases, int((verdicts != 0).sum()), 0.0, 0.0)
