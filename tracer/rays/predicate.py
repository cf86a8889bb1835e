"""Does a ray meet a triangle? The one definition, in scalars; every path computes the same floats or calls it.

In float64 and without fused multiply-add, per ray: kz is the axis of the largest direction component, kx and ky the
next two in cyclic order, Sz = 1 / d.kz, Sx = d.kx Sz, Sy = d.ky Sz. Per vertex (Woop et al. 2013)::

    z = v.kz - o.kz      x = (v.kx - o.kx) - Sx z      y = (v.ky - o.ky) - Sy z

which depends on ray and vertex alone: triangles that share a vertex share these bits. The rest is decided on these
floats as if they were exact. The triangle is met when the origin lies inside (x, y): when the three edge functions
U = C.x B.y - C.y B.x, V = A.x C.y - A.y C.x, W = B.x A.y - B.y A.x have one sign; on a zero the origin moves to
(eps, eps**2) (simulation of simplicity), so an edge belongs to exactly one side: **no ray is lost or counted twice
on a closed mesh**.

An edge function is off by at most (3 + 16 eps) eps (|l| + |r|) <= 6.1 eps L**2, eps = 2**-53, where l and r are its
products and L the largest |x|, |y| of the three vertices (Shewchuk 1997, ccwerrboundA). Beyond ``e = 2**-50 L**2``
(8 eps L**2) its sign is therefore certain. When all three are, the rounded values' signs do; else the exact ones are
computed by fused multiply-add.

Distances are counted for a direction scaled by a power of two into [1, 2) (`unit_of`; exact), so that neither very
long nor very short directions cost accuracy.

t is the mean of the vertices' Sz z weighted with U, V, W to 1.5 ulp each (:func:`weigh`), clamped to their range:
within 8 eps (range) + 3 eps |t| of the value for exact arithmetic on the same x, y, z, however slim the triangle.

Sources: Edelsbrunner and Muecke 1990 (ties); Jeannerod, Louvet and Muller 2013 (Kahan's difference of products).
"""

from typing import Any, Final

from tracer.jit import inline, kernel
from tracer.simd import fma, from_bits, to_bits
from tracer.simd.gateway import types

_int64: Final = types.int64

CERTAIN: Final = 2.0**-50  # times L**2: beyond it an edge function's sign is certain
TINY: Final = 1e-180  # added to it: below, products of three would lose bits to underflow
_CCW: Final = 3.3306690738754716e-16  # (3 + 16 eps) eps
_LEAST_PRODUCT: Final = 1e-250  # above, the exact rest of a product does not underflow


@inline
def _power_of_two_of(x: float) -> Any:
    """2**-k for x in [2**k, 2**(k + 1)), x positive and normal; within 2**-1022 .. 2**1023."""
    exponent = (to_bits(x) >> 52) & 2047
    return from_bits(max(_int64(1), 2046 - exponent) << 52)


@inline
def _scale_up(a: float, b: float) -> float:
    """Return a power of two that brings the larger of |a|, |b| near 1; only ever up, so scaling by it is exact."""
    larger = max(abs(a), abs(b))
    return max(1.0, _power_of_two_of(larger)) if larger > 0.0 else 1.0


@inline
def weigh(px: float, py: float, qx: float, qy: float) -> Any:
    """Return px qy - py qx to 1.5 ulp, scalars or lanes, where no product underflows (Kahan)."""
    right = py * qx
    rest = fma(-py, qx, right)
    return fma(px, qy, -right) + rest


@kernel
def _sign_of_tiny(px: float, py: float, qx: float, qy: float) -> Any:
    """Sign of px qy - py qx where the products underflow: after scaling rows and columns up, they do not."""
    # twice, because one factor of at most 2**1022 does not bring the smallest denormal to 1
    for _ in range(2):
        s = _scale_up(px, py)
        px, py = px * s, py * s
        s = _scale_up(qx, qy)
        qx, qy = qx * s, qy * s
        s = _scale_up(px, qx)
        px, qx = px * s, qx * s
        s = _scale_up(py, qy)
        py, qy = py * s, qy * s
    left = px * qy
    right = py * qx
    difference = left - right
    if abs(difference) > _CCW * (abs(left) + abs(right)):
        return difference
    first = fma(px, qy, -left)
    second = fma(py, qx, -right)
    rest = first - second
    total = difference + rest
    if total != 0.0:
        return total
    back = rest - first
    return (first - (rest - back)) - (second + back)


@inline
def exact_edge(px: float, py: float, qx: float, qy: float) -> Any:
    """Return (px qy - py qx to nearly full relative accuracy, its sign or the tie's: -1, 0, 1).

    0 only for equal points: then the triangle has no area and is never met.
    """
    left = px * qy
    right = py * qx
    difference = left - right
    size = abs(left) + abs(right)
    value = difference
    if size < _LEAST_PRODUCT:
        tiny = _sign_of_tiny(px, py, qx, qy)
        if tiny != 0.0:  # as a weight it is nothing beside the two others
            return (max(value, 0.0), 1) if tiny > 0.0 else (min(value, -0.0), -1)
        value = 0.0
    else:
        first = fma(px, qy, -left)
        second = fma(py, qx, -right)
        rest = first - second
        if abs(difference) > _CCW * size:
            back = difference - left
            error = (left - (difference - back)) - (right + back)
            value = difference + (error + rest)
        else:  # left and right are within a factor of two: the difference is exact
            value = difference + rest
            if value == 0.0:
                back = rest - first
                value = (first - (rest - back)) - (second + back)
    if value > 0.0:
        return value, 1
    if value < 0.0:
        return value, -1
    # the origin at (eps, eps**2): the coefficients of eps, then of eps**2
    if py != qy:
        return 0.0, (1 if py > qy else -1)
    if qx != px:
        return 0.0, (1 if qx > px else -1)
    return 0.0, 0


@inline
def decide(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float, sz: float
) -> Any:
    """Intersect, from the sheared coordinates.

    Parameters
    ----------
    ax, ay, az, bx, by, bz, cx, cy, cz
        x, y, z of the three vertices as the module says.
    sz
        1 / d.kz.

    Returns
    -------
    tuple
        (met, t, weights U, V, W of one sign).
    """
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    largest = max(abs(ax), abs(ay), abs(bx), abs(by), abs(cx), abs(cy))
    e = largest * largest * CERTAIN + TINY
    low = min(u, v, w)
    high = max(u, v, w)
    if low > e or high < -e:
        u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
    else:
        if not (low >= -e or high <= e):
            return False, 0.0, u, v, w
        # the same power of two for all x, and for all y, keeps the weights' proportions, exactly, out of the denormals
        scale = _scale_up(max(abs(ax), abs(bx)), cx)
        ax, bx, cx = ax * scale, bx * scale, cx * scale
        scale = _scale_up(max(abs(ay), abs(by)), cy)
        ay, by, cy = ay * scale, by * scale, cy * scale
        u, sign_u = exact_edge(cx, cy, bx, by)
        v, sign_v = exact_edge(ax, ay, cx, cy)
        w, sign_w = exact_edge(bx, by, ax, ay)
        if sign_u == 0 or sign_u != sign_v or sign_v != sign_w:
            return False, 0.0, u, v, w
    total = (u + v) + w
    ta = sz * az
    tb = sz * bz
    tc = sz * cz
    t = ((u * ta + v * tb) + w * tc) / total
    least = min(ta, tb, tc)
    most = max(ta, tb, tc)
    t = t if t > least else least  # noqa: FURB136 - a NaN becomes `least`, as in the lanes
    t = t if t < most else most  # noqa: FURB136
    return True, t, u, v, w


@inline
def unit_of(dx: float, dy: float, dz: float) -> Any:
    """Return the power of two that brings the largest component of a direction into [1, 2): t is counted in it."""
    return _power_of_two_of(max(abs(dx), abs(dy), abs(dz)))


@inline
def shear_of(dx: float, dy: float, dz: float) -> Any:
    """Return (kx, ky, kz, Sx, Sy, Sz) of a direction."""
    x, y, z = abs(dx), abs(dy), abs(dz)
    if z >= x and z >= y:
        inverse = 1.0 / dz
        return 0, 1, 2, dx * inverse, dy * inverse, inverse
    if y >= x:
        inverse = 1.0 / dy
        return 2, 0, 1, dz * inverse, dx * inverse, inverse
    inverse = 1.0 / dx
    return 1, 2, 0, dy * inverse, dz * inverse, inverse


@inline
def intersect_triangle(
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    cx: float,
    cy: float,
    cz: float,
    ox: float,
    oy: float,
    oz: float,
    sx: float,
    sy: float,
    sz: float,
) -> Any:
    """Intersect, from coordinates that are in the order kx, ky, kz already; returns what :func:`decide` does."""
    az, bz, cz = az - oz, bz - oz, cz - oz
    return decide(
        (ax - ox) - sx * az,
        (ay - oy) - sy * az,
        az,
        (bx - ox) - sx * bz,
        (by - oy) - sy * bz,
        bz,
        (cx - ox) - sx * cz,
        (cy - oy) - sy * cz,
        cz,
        sz,
    )
