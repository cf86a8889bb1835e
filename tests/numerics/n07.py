"""N7 and N8: where rays meet the unit sphere, tube, disk and slab box, against mpmath at 60 digits.

Near a tangent the class (hit or miss) may differ only where the line passes the surface by less than the bound; else it
is exact. A root's residual is the distance of its point from the surface, in units of 2^-53 times the distance of
the origin and the shape's size together; the suite's 4 eps, eps the spacing of float64 at 1, are 8 of these.
"""

import math

import mpmath
import numpy as np
from row import Row

from tracer.geometry.shapes import cross_shape
from tracer.jit import kernel
from tracer.types import SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_CYLINDER_OPEN, SHAPE_DISK, SHAPE_SPHERE, Vec3

EPS = 2.0**-53
CLASS_BOUND = 16 * EPS  # of the line's squared distance from the axis, times the square of the origin's distance


@kernel
def cross_all(kind, origins, directions, roots):
    for i in range(len(origins)):
        o = Vec3(origins[i, 0], origins[i, 1], origins[i, 2])
        d = Vec3(directions[i, 0], directions[i, 1], directions[i, 2])
        roots[i, 0], roots[i, 1] = cross_shape(kind, o, d)


def nearly_tangent(n, rng, flat):
    """Rays past the unit sphere (or, ``flat``, the unit tube), from 1 to 1e8 away, many of them tangent to some ulps."""
    normals = rng.normal(size=(n, 3))
    if flat:
        normals[:, 2] = 0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = np.cross(normals, rng.normal(size=(n, 3)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    kind = rng.integers(0, 3, n)
    depth = np.where(kind == 0, rng.uniform(0, 1.5, n), 1 + rng.integers(-64, 65, n) * 2.0**-53)
    depth = np.where(kind == 2, 1 + rng.choice([-1, 1], n) * 10.0 ** rng.uniform(-12, -2, n), depth)
    distance = 10.0 ** rng.uniform(0, 8, n)
    origins = normals * depth[:, None] - directions * distance[:, None]
    return origins, directions * 10.0 ** rng.uniform(-9, 9, (n, 1))


def exact_roots(origin, direction, axes):
    """(squared distance of the line from the centre, roots or None) in the axes that count."""
    o, d = [mpmath.mpf(float(origin[a])) for a in axes], [mpmath.mpf(float(direction[a])) for a in axes]
    dd = sum(x * x for x in d)
    b = -sum(x * y for x, y in zip(o, d, strict=True))
    rest = sum(x * x for x in o) - b * b / dd
    if rest > 1:
        return rest, None
    root = mpmath.sqrt((1 - rest) * dd)
    return rest, ((b - root) / dd, (b + root) / dd)


def run_round(kind, axes, cases, seed):
    """(wrong classes, worst residual in eps of the distance) of spheres or tubes."""
    rng = np.random.default_rng(seed)
    origins, directions = nearly_tangent(cases, rng, len(axes) == 2)
    roots = np.empty((cases, 2))
    cross_all(kind, origins, directions, roots)
    wrong, worst = 0, 0.0
    with mpmath.workdps(60):
        for i in range(cases):
            rest, exact = exact_roots(origins[i], directions[i], axes)
            far = float(np.linalg.norm(origins[i]))
            met = not math.isnan(roots[i, 0])
            if met != (exact is not None):
                wrong += abs(float(rest - 1)) > CLASS_BOUND * (1 + far)
                continue
            if exact is None:
                continue
            for t in roots[i]:
                point = [
                    mpmath.mpf(float(origins[i, a])) + mpmath.mpf(float(t)) * mpmath.mpf(float(directions[i, a]))
                    for a in axes
                ]
                residual = abs(mpmath.sqrt(sum(x * x for x in point)) - 1)
                worst = max(worst, float(residual / (EPS * (1 + far))))
            wrong += not roots[i, 0] <= roots[i, 1]
    return wrong, worst


def run(cases, seed=7):
    """Spheres."""
    wrong, worst = run_round(SHAPE_SPHERE, (0, 1, 2), cases, seed)
    return Row(
        "N7",
        "sphere against mpmath, distance 1 to 1e8, tangents",
        cases,
        wrong,
        worst,
        8.0,
        "residual in 2^-53 x distance",
    )


def exact_flat(kind, o, d):
    """Parameters at which a ray goes through box, disk or cylinder, and how far the nearest edge of the decision is."""
    o, d = [mpmath.mpf(float(x)) for x in o], [mpmath.mpf(float(x)) for x in d]
    near, far = mpmath.mpf("-inf"), mpmath.mpf("inf")
    margin = mpmath.mpf("inf")
    limits = {SHAPE_BOX: [(a, -1, 1) for a in range(3)], SHAPE_CYLINDER_CAPPED: [(2, 0, 1)]}.get(kind, [])
    if kind == SHAPE_DISK:
        t = -o[2] / d[2]
        rest = (o[0] + t * d[0]) ** 2 + (o[1] + t * d[1]) ** 2
        return ([t] if rest <= 1 else []), abs(rest - 1)
    if kind == SHAPE_CYLINDER_OPEN:
        rest, roots = exact_roots(o, d, (0, 1))
        heights = [(t, o[2] + t * d[2]) for t in roots or ()]
        margin = min([abs(rest - 1), *(min(abs(z), abs(z - 1)) for _, z in heights)])
        return [t for t, z in heights if 0 <= z <= 1], margin
    if kind == SHAPE_CYLINDER_CAPPED:
        rest, roots = exact_roots(o, d, (0, 1))
        margin = abs(rest - 1)
        if roots is None:
            return [], margin
        near, far = roots
    for a, low, high in limits:
        t0, t1 = sorted([(low - o[a]) / d[a], (high - o[a]) / d[a]])
        near, far = max(near, t0), min(far, t1)
    margin = min(margin, abs(far - near))
    return ([near, far] if near <= far else []), margin


def run_shapes(cases, seed=8):
    """Cylinders, disk and box: roots to 1e-12 of the distance, none lost away from their rims."""
    kinds = (SHAPE_CYLINDER_OPEN, SHAPE_CYLINDER_CAPPED, SHAPE_DISK, SHAPE_BOX)
    rng = np.random.default_rng(seed)
    each = cases // len(kinds)
    wrong, worst = 0, 0.0
    for kind in kinds:
        origins = rng.normal(size=(each, 3)) * 10.0 ** rng.uniform(0, 4, (each, 1))
        directions = rng.uniform(-1.2, 1.2, (each, 3)) - origins
        roots = np.empty((each, 2))
        cross_all(kind, origins, directions, roots)
        with mpmath.workdps(60):
            for i in range(each):
                exact, margin = exact_flat(kind, origins[i], directions[i])
                found = [t for t in roots[i] if not math.isnan(t)]
                if len(found) != len(exact):
                    wrong += margin > 1e-9
                    continue
                if margin > 1e-6:
                    worst = max(
                        [
                            worst,
                            *(
                                abs(float(mpmath.mpf(float(a)) / b) - 1)
                                for a, b in zip(found, exact, strict=True)
                                if abs(b) > 1e-3
                            ),
                        ]
                    )
    note = "relative t; cone, torus and general quadrics wait for the shapes"
    return Row("N8", "cylinders, disk, box against mpmath", each * len(kinds), int(wrong), worst, 1e-12, note)
