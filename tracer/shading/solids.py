"""Shadow rays that pass through the inside of a closed opaque mesh (:mod:`tracer.render.solids`): dark without tracing.

Invariant: what is said to be hidden would meet a triangle by the predicate. A ray's origin, its direction and the ball
are rounded; the room that the ball leaves is 2**-20 of its radius, and 2**-40 of the origin's distance squared, in
radii, is taken off where that is far away.
"""

from typing import Any, Final

from tracer.geometry.vector import at
from tracer.jit import inline
from tracer.rays.rows import VECTOR
from tracer.shading.rows import spread
from tracer.simd import splat
from tracer.types import (
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_POSITION,
    N_LIGHT,
    N_SOLID,
    SOLID_BALL,
    SOLID_BOX,
    SOLID_CENTRE,
    SceneView,
    Vec3,
)

_FAR: Final = 2.0**-40
_OUTSIDE: Final = 1.0 + 2.0**-20


@inline
def may_hide(view: SceneView, solid: int, light: int) -> bool:
    """Tell whether a lamp is outside a closed mesh's box for certain."""
    if view.light_kind[light] == LIGHT_KIND_DIRECTIONAL:
        return True
    i, lamp = N_SOLID * solid, N_LIGHT * light + LIGHT_POSITION
    for axis in range(3):
        off = (view.lights[lamp + axis] - view.solids[i + SOLID_CENTRE + axis]) * view.solids[i + SOLID_BOX + axis]
        if abs(off) > _OUTSIDE:
            return True
    return False


@inline
def pass_through(view: SceneView, solid: int, light: int, origin: Any) -> Any:
    """Tell which of four rays to a lamp pass through the ball of a solid that `may_hide` it: a mask."""
    i = N_SOLID * solid
    centre, inverse = spread(at(view.solids, i + SOLID_CENTRE)), spread(at(view.solids, i + SOLID_BALL))
    o = Vec3((origin.x - centre.x) * inverse.x, (origin.y - centre.y) * inverse.y, (origin.z - centre.z) * inverse.z)
    directional = view.light_kind[light] == LIGHT_KIND_DIRECTIONAL
    zero = splat(VECTOR, 0.0)
    if directional:
        against = spread(at(view.lights, N_LIGHT * light + LIGHT_DIRECTION))
        d = Vec3(-against.x * inverse.x, -against.y * inverse.y, -against.z * inverse.z)
    else:
        lamp = spread(at(view.lights, N_LIGHT * light + LIGHT_POSITION))
        d = Vec3((lamp.x - origin.x) * inverse.x, (lamp.y - origin.y) * inverse.y, (lamp.z - origin.z) * inverse.z)
    square = d.x * d.x + d.y * d.y + d.z * d.z
    along = -(o.x * d.x + o.y * d.y + o.z * d.z)
    outside = o.x * o.x + o.y * o.y + o.z * o.z
    # nearest to the centre between origin and lamp, and there within the ball
    between = along > zero
    if not directional:
        between = between & (along < square)
    left = splat(VECTOR, 1.0) - outside * splat(VECTOR, _FAR)
    return between & ((outside - left) * square < along * along) & (left > zero)
