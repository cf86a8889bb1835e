"""Shapes and planes: the nearest one along a ray, and the light that they let through.

The triangles have a tree of their own (:mod:`tracer.accel.wide`) and are met first, many rays at a time; what is here
goes on from their answer, one ray at a time.

Invariants
----------
* The closest hit is the least (t, id) over all primitives with 0 < t, whatever the order of traversal: boxes are
  only left out when they begin beyond the best t, and their test (:mod:`tracer.accel.boxes`) is conservative.
* A ray that is not finite or has no direction misses at once.

Source: Pharr et al., "Physically Based Rendering" 7.3 (ordered traversal with a stack).
"""

import math
from typing import Any, Final, NamedTuple

from tracer.accel.boxes import enter_children, make_slabs
from tracer.geometry.quadric import Crossings
from tracer.geometry.shapes import cross_plane, cross_shape, transform
from tracer.geometry.vector import at, multiply, subtract
from tracer.jit import inline, int64, kernel
from tracer.types import MATERIAL_KT, N_MATERIAL, SceneView, Vec3

# A direction below this is none. A component whose inverse overflows is then smaller than the largest one by
# 2^-120, so what it moves within the scene is far below the padding.
_SHORTEST: Final = 2.0**-900


class Hit(NamedTuple):
    """A meeting of ray and primitive."""

    t: float  # ray parameter, infinite when nothing was met
    primitive: int  # id, -1 when nothing was met


@inline
def is_valid_ray(o: Vec3, d: Vec3) -> bool:
    """Tell whether a ray has a finite origin and a finite direction of some length."""
    size = abs(d.x) + abs(d.y) + abs(d.z)
    return _SHORTEST < size < math.inf and abs(o.x) + abs(o.y) + abs(o.z) < math.inf


@inline
def _cross_local(view: SceneView, shape: int, o: Vec3, d: Vec3) -> Crossings:
    """Meet a shape in its local space; t is that of the world ray."""
    i = 9 * shape
    local_o = transform(view.shape_to_local, i, subtract(o, at(view.shape_origin, 3 * shape)))
    local_d = transform(view.shape_to_local, i, d)
    return cross_shape(view.shape_kind[shape], local_o, local_d)


@inline
def _is_nearer(t: float, primitive: int, best_t: float, best: int) -> bool:
    """Order hits by (t, id); False for NaN and for t <= 0."""
    return t > 0.0 and (t < best_t or (t == best_t and primitive < best))


@inline
def _take(view: SceneView, place: int, stack: Any, top: int) -> int:
    """Put a child on the stack."""
    stack[top] = (int64(view.bvh_children[place]) << 32) | view.bvh_children[place + 1]
    return top + 1


@kernel
def closest_shape(view: SceneView, o: Vec3, d: Vec3, skip: int, t: float, primitive: int, stack: Any) -> Hit:
    """Find the nearest shape or plane along a ray, unless something nearer is known.

    Parameters
    ----------
    o, d : Vec3
        World ray; t counts in lengths of d.
    skip : int
        Id of a flat primitive that the ray starts on and hence cannot meet again; -1 for none.
    t, primitive
        The nearest triangle: infinite and -1 when there is none.
    stack : flat int64, MAX_DEPTH entries
        Scratch.
    """
    best_t = t
    best = int64(primitive)
    if not is_valid_ray(o, d):
        return Hit(best_t, best)
    # Planes first: they shorten the ray for the hierarchy.
    first_plane = view.n_triangles + view.n_shapes
    for k in range(view.n_planes):
        there = cross_plane(at(view.plane_point, 3 * k), at(view.plane_normal, 3 * k), o, d)
        if first_plane + k != skip and there < math.inf and _is_nearer(there, first_plane + k, best_t, best):
            best_t = there
            best = first_plane + k
    if view.n_shapes == 0:
        return Hit(best_t, best)
    slabs = make_slabs(view.bvh_root, o, d)
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = stack[top] >> 32
        count = stack[top] & 0xFFFFFFFF
        if count == 0:
            # The nearer child goes on top; what begins beyond the best hit is left out.
            spans = enter_children(view.bvh_bounds, node, slabs, best_t)
            hit0 = spans.near0 <= spans.far0
            hit1 = spans.near1 <= spans.far1
            if hit0 and hit1 and spans.near1 < spans.near0:
                top = _take(view, 4 * node, stack, top)
                top = _take(view, 4 * node + 2, stack, top)
            else:
                if hit1:
                    top = _take(view, 4 * node + 2, stack, top)
                if hit0:
                    top = _take(view, 4 * node, stack, top)
            continue
        for slot in range(node, node + count):
            shape = int64(view.bvh_slots[slot])
            crossings = _cross_local(view, shape, o, d)
            there = crossings.t0 if crossings.t0 > 0.0 else crossings.t1
            shape += view.n_triangles
            if _is_nearer(there, shape, best_t, best) and shape != skip:
                best_t = there
                best = shape
    return Hit(best_t, best)


@inline
def material_of(view: SceneView, primitive: int) -> int:
    """Row of a shape's or plane's material."""
    if primitive < view.n_triangles + view.n_shapes:
        return int(view.shape_material[primitive - view.n_triangles])
    return int(view.plane_material[primitive - view.n_triangles - view.n_shapes])


@kernel
def shade_by_shapes(view: SceneView, o: Vec3, d: Vec3, t_max: float, skip: int, light: Vec3, stack: Any) -> Vec3:
    """Multiply light by the kt of every shape and plane crossed in 0 < t < t_max; stop when nothing is left.

    Parameters
    ----------
    o, d, t_max
        World ray; infinite t_max for a directional light, 1 where d reaches to the light.
    skip
        As for :func:`closest_shape`.
    light
        What is left of it, RGB.
    stack
        Scratch of MAX_DEPTH int64.
    """
    if not is_valid_ray(o, d):
        return light
    first_plane = view.n_triangles + view.n_shapes
    for k in range(view.n_planes):
        t = cross_plane(at(view.plane_point, 3 * k), at(view.plane_normal, 3 * k), o, d)
        if 0.0 < t < t_max and first_plane + k != skip:
            light = multiply(light, at(view.materials, N_MATERIAL * int64(view.plane_material[k]) + MATERIAL_KT))
    if view.n_shapes == 0:
        return light
    slabs = make_slabs(view.bvh_root, o, d)
    stack[0] = 0
    top = 1
    while top > 0 and not (light.x == 0.0 and light.y == 0.0 and light.z == 0.0):
        top -= 1
        node = stack[top] >> 32
        count = stack[top] & 0xFFFFFFFF
        if count == 0:
            spans = enter_children(view.bvh_bounds, node, slabs, t_max)
            if spans.near0 <= spans.far0:
                top = _take(view, 4 * node, stack, top)
            if spans.near1 <= spans.far1:
                top = _take(view, 4 * node + 2, stack, top)
            continue
        for slot in range(node, node + count):
            shape = int64(view.bvh_slots[slot])
            if shape + view.n_triangles != skip:
                crossings = _cross_local(view, shape, o, d)
                kt = at(view.materials, N_MATERIAL * int64(view.shape_material[shape]) + MATERIAL_KT)
                if 0.0 < crossings.t0 < t_max:
                    light = multiply(light, kt)
                if 0.0 < crossings.t1 < t_max:
                    light = multiply(light, kt)
    return light
