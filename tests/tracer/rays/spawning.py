"""Origins of rays that leave a surface, one at a time."""

from tracer.jit import kernel
from tracer.rays import spawn
from tracer.rays.rows import VECTOR
from tracer.shading.rows import spread
from tracer.simd import extract, splat
from tracer.types import Vec3


@kernel
def offset_origin(position, error, normal, direction):
    """`tracer.rays.spawn.offset_origin` of one ray: a Vec3."""
    o = spawn.offset_origin(spread(position), spread(error), spread(normal), spread(direction))
    return Vec3(extract(o.x, 0), extract(o.y, 0), extract(o.z, 0))


@kernel
def away(value, towards):
    """`tracer.rays.spawn.away` of one number."""
    return extract(spawn.away(splat(VECTOR, value), splat(VECTOR, towards)), 0)
