"""Finite shapes and the infinite plane: where a ray meets them, and what is known of the point.

A shape is solved in its local space, where it has unit size (the forms are listed in :mod:`tracer.types`). The ray's
direction is mapped without making it unit, so the ray parameter t is the same in both spaces. A hit point is put back
onto the local surface before it is mapped to the world, so its error does not grow with the distance travelled.

Sources: :mod:`tracer.geometry.quadric`; Pharr et al., "Physically Based Rendering" 6.8 (refined points, error bounds).
"""

import math
from typing import Any, Final, NamedTuple

from tracer.geometry.quadric import Crossings, cross_unit_sphere, cross_unit_tube
from tracer.geometry.rounding import gamma
from tracer.geometry.vector import dot, normalize, subtract
from tracer.jit import inline, kernel
from tracer.types import (
    SHAPE_BOX,
    SHAPE_CYLINDER_CAPPED,
    SHAPE_CYLINDER_OPEN,
    SHAPE_DISK,
    SHAPE_SPHERE,
    Vec3,
)

_GAMMA_8: Final = gamma(8)
_GAMMA_16: Final = gamma(16)


class SurfacePoint(NamedTuple):
    """A point on a primitive, in world space."""

    position: Vec3
    error: Vec3  # bound on the error of each coordinate, that of meeting the same primitive from here included
    normal: Vec3  # geometric, unit, outward
    u: float
    v: float


@inline
def transform(matrix: Any, i: int, a: Vec3) -> Vec3:
    """3 x 3 matrix at ``matrix[i:]`` (flat, by rows) times a vector."""
    return Vec3(
        matrix[i] * a.x + matrix[i + 1] * a.y + matrix[i + 2] * a.z,
        matrix[i + 3] * a.x + matrix[i + 4] * a.y + matrix[i + 5] * a.z,
        matrix[i + 6] * a.x + matrix[i + 7] * a.y + matrix[i + 8] * a.z,
    )


@inline
def transform_transposed(matrix: Any, i: int, a: Vec3) -> Vec3:
    """Transpose of a 3 x 3 matrix times a vector."""
    return Vec3(
        matrix[i] * a.x + matrix[i + 3] * a.y + matrix[i + 6] * a.z,
        matrix[i + 1] * a.x + matrix[i + 4] * a.y + matrix[i + 7] * a.z,
        matrix[i + 2] * a.x + matrix[i + 5] * a.y + matrix[i + 8] * a.z,
    )


@inline
def _transform_absolute(matrix: Any, i: int, a: Vec3) -> Vec3:
    """Absolute values of a matrix times those of a vector: what its rounding errors are in proportion to."""
    return Vec3(
        abs(matrix[i] * a.x) + abs(matrix[i + 1] * a.y) + abs(matrix[i + 2] * a.z),
        abs(matrix[i + 3] * a.x) + abs(matrix[i + 4] * a.y) + abs(matrix[i + 5] * a.z),
        abs(matrix[i + 6] * a.x) + abs(matrix[i + 7] * a.y) + abs(matrix[i + 8] * a.z),
    )


@inline
def _slab(o: float, d: float, near: float, far: float) -> Crossings:
    """Clip [near, far] to -1 <= o + t d <= 1; a NaN (origin in a face, no motion) leaves the interval as it is."""
    inverse = 1.0 / d
    if math.copysign(1.0, d) > 0.0:
        t0 = (-1.0 - o) * inverse
        t1 = (1.0 - o) * inverse
    else:
        t0 = (1.0 - o) * inverse
        t1 = (-1.0 - o) * inverse
    return Crossings(max(t0, near) if t0 == t0 else near, min(t1, far) if t1 == t1 else far)  # noqa: PLR0124


@inline
def cross_unit_box(o: Vec3, d: Vec3) -> Crossings:
    """Meet the faces of [-1, 1]^3."""
    span = _slab(o.x, d.x, -math.inf, math.inf)
    span = _slab(o.y, d.y, span.t0, span.t1)
    span = _slab(o.z, d.z, span.t0, span.t1)
    if span.t0 <= span.t1:
        return span
    return Crossings(math.nan, math.nan)


@inline
def cross_unit_disk(o: Vec3, d: Vec3, height: float) -> float:
    """Meet x^2 + y^2 <= 1 at z = height: t, or NaN."""
    t = (height - o.z) / d.z
    x = o.x + t * d.x
    y = o.y + t * d.y
    return t if x * x + y * y <= 1.0 else math.nan


@inline
def _cross_open_cylinder(o: Vec3, d: Vec3) -> Crossings:
    """Meet the side of the cylinder x^2 + y^2 = 1, 0 <= z <= 1."""
    side = cross_unit_tube(o, d)
    z0 = o.z + side.t0 * d.z
    z1 = o.z + side.t1 * d.z
    first = side.t0 if 0.0 <= z0 <= 1.0 else math.nan
    second = side.t1 if 0.0 <= z1 <= 1.0 else math.nan
    return Crossings(first, second)


@inline
def _cross_capped_cylinder(o: Vec3, d: Vec3) -> Crossings:
    """Meet the closed cylinder: the tube's interval cut by that of the two end planes, so that no rim leaks."""
    if d.x == 0.0 and d.y == 0.0:
        if not o.x * o.x + o.y * o.y <= 1.0:
            return Crossings(math.nan, math.nan)
        near = -math.inf
        far = math.inf
    else:
        side = cross_unit_tube(o, d)
        if not side.t0 <= side.t1:  # passes by: the end planes must not be asked, since a NaN does not clip them
            return Crossings(math.nan, math.nan)
        near = side.t0
        far = side.t1
    ends = _slab(2.0 * o.z - 1.0, 2.0 * d.z, near, far)
    if ends.t0 <= ends.t1:
        return ends
    return Crossings(math.nan, math.nan)


@kernel
def cross_shape(kind: int, o: Vec3, d: Vec3) -> Crossings:
    """Meet a shape in its local space.

    Returns
    -------
    Crossings
        The parameters at which the line goes through the surface, at most two as all shapes are convex; NaN for
        each that is absent.
    """
    if kind == SHAPE_SPHERE:
        return cross_unit_sphere(o, d)
    if kind == SHAPE_BOX:
        return cross_unit_box(o, d)
    if kind == SHAPE_DISK:
        return Crossings(cross_unit_disk(o, d, 0.0), math.nan)
    if kind == SHAPE_CYLINDER_OPEN:
        return _cross_open_cylinder(o, d)
    return _cross_capped_cylinder(o, d)


@inline
def cross_plane(point: Vec3, normal: Vec3, o: Vec3, d: Vec3) -> float:
    """Meet an infinite plane: t (infinite or NaN for a parallel ray)."""
    return dot(subtract(point, o), normal) / dot(d, normal)


@inline
def _azimuth(x: float, y: float) -> float:
    """Angle about z from +x towards +y, as a fraction of a turn in [0, 1)."""
    turn = math.atan2(y, x) / (2.0 * math.pi)
    return turn + 1.0 if turn < 0.0 else turn


@kernel
def _put_on_surface(kind: int, p: Vec3) -> tuple[Vec3, Vec3, float, float]:
    """Point moved onto the local surface, local outward normal (not unit), u and v."""
    if kind == SHAPE_SPHERE:
        n = normalize(p)
        return n, n, _azimuth(n.x, n.y), 0.5 + math.asin(min(max(n.z, -1.0), 1.0)) / math.pi
    if kind == SHAPE_BOX:
        q = Vec3(min(max(p.x, -1.0), 1.0), min(max(p.y, -1.0), 1.0), min(max(p.z, -1.0), 1.0))
        if abs(p.x) >= abs(p.y) and abs(p.x) >= abs(p.z):
            side = math.copysign(1.0, p.x)
            return Vec3(side, q.y, q.z), Vec3(side, 0.0, 0.0), 0.5 + 0.5 * q.y, 0.5 + 0.5 * q.z
        if abs(p.y) >= abs(p.z):
            side = math.copysign(1.0, p.y)
            return Vec3(q.x, side, q.z), Vec3(0.0, side, 0.0), 0.5 + 0.5 * q.x, 0.5 + 0.5 * q.z
        side = math.copysign(1.0, p.z)
        return Vec3(q.x, q.y, side), Vec3(0.0, 0.0, side), 0.5 + 0.5 * q.x, 0.5 + 0.5 * q.y
    if kind == SHAPE_DISK:
        return Vec3(p.x, p.y, 0.0), Vec3(0.0, 0.0, 1.0), 0.5 + 0.5 * p.x, 0.5 + 0.5 * p.y
    radius = math.sqrt(p.x * p.x + p.y * p.y)
    off_side = abs(radius - 1.0)
    if kind == SHAPE_CYLINDER_CAPPED and min(abs(p.z), abs(p.z - 1.0)) < off_side:
        end = 0.0 if p.z < 0.5 else 1.0
        return Vec3(p.x, p.y, end), Vec3(0.0, 0.0, 2.0 * end - 1.0), 0.5 + 0.5 * p.x, 0.5 + 0.5 * p.y
    x = p.x / radius
    y = p.y / radius
    z = min(max(p.z, 0.0), 1.0)
    return Vec3(x, y, z), Vec3(x, y, 0.0), _azimuth(x, y), z


@inline
def locate_on_shape(
    kind: int, origin: Vec3, to_world: Any, to_local: Any, i: int, o: Vec3, d: Vec3, t: float
) -> SurfacePoint:
    """Find the facts of the point at parameter ``t`` of a world ray; ``i`` is the offset of the shape's matrices."""
    ol = transform(to_local, i, subtract(o, origin))
    dl = transform(to_local, i, d)
    local, normal, u, v = _put_on_surface(kind, Vec3(ol.x + t * dl.x, ol.y + t * dl.y, ol.z + t * dl.z))
    offset = transform(to_world, i, local)
    position = Vec3(origin.x + offset.x, origin.y + offset.y, origin.z + offset.z)
    # There and back again: the point's own roundings (3 products, 3 sums and that of the local point: below gamma(8) of
    # |origin| + |M| |local|), and as many when the next ray from here is mapped to local space with an inverse that is
    # itself rounded, which |M| |M^-1| magnifies.
    size = _transform_absolute(to_world, i, local)
    spread = _transform_absolute(to_world, i, _transform_absolute(to_local, i, size))
    error = Vec3(
        _GAMMA_16 * (abs(origin.x) + size.x + spread.x),
        _GAMMA_16 * (abs(origin.y) + size.y + spread.y),
        _GAMMA_16 * (abs(origin.z) + size.z + spread.z),
    )
    return SurfacePoint(position, error, normalize(transform_transposed(to_local, i, normal)), u, v)


@inline
def locate_on_plane(point: Vec3, normal: Vec3, uv: Any, i: int, o: Vec3, d: Vec3, t: float) -> SurfacePoint:
    """Find the facts of the point at parameter ``t`` on an infinite plane; ``uv[i:]`` are its two texture rows."""
    p = Vec3(o.x + t * d.x, o.y + t * d.y, o.z + t * d.z)
    offset = subtract(p, point)
    height = dot(offset, normal)
    p = Vec3(p.x - height * normal.x, p.y - height * normal.y, p.z - height * normal.z)
    # The height is known to gamma(5) of the sum below; the subtraction and p itself round once more.
    lever = abs(offset.x * normal.x) + abs(offset.y * normal.y) + abs(offset.z * normal.z)
    error = Vec3(
        _GAMMA_8 * (abs(p.x) + abs(point.x) + lever),
        _GAMMA_8 * (abs(p.y) + abs(point.y) + lever),
        _GAMMA_8 * (abs(p.z) + abs(point.z) + lever),
    )
    offset = subtract(p, point)
    u = uv[i] * offset.x + uv[i + 1] * offset.y + uv[i + 2] * offset.z
    v = uv[i + 3] * offset.x + uv[i + 4] * offset.y + uv[i + 5] * offset.z
    return SurfacePoint(p, error, normal, u, v)
