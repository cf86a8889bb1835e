"""Closest hit and light transmittance through the hierarchy.

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
from tracer.geometry.triangle import Shear, intersect_triangle, shear_ray
from tracer.geometry.vector import at, subtract
from tracer.jit import inline, int64
from tracer.types import MATERIAL_KT, N_MATERIAL, SceneView, Vec3

# A direction below this is none. A component whose inverse overflows is then smaller than the largest one by
# 2^-120, so what it moves within the scene is far below the padding.
_SHORTEST: Final = 2.0**-900


class Hit(NamedTuple):
    """A meeting of ray and primitive."""

    t: float  # ray parameter, infinite when nothing was met
    primitive: int  # id, -1 when nothing was met
    slot: int  # slot of the hierarchy, -1 for infinite planes
    v: float  # weights of the second and third vertex of the slot's (sorted) triangle
    w: float


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
def closest_hit(view: SceneView, o: Vec3, d: Vec3, skip: int, stack: Any, stack_t: Any) -> Hit:
    """Find the nearest primitive along a ray.

    Parameters
    ----------
    o, d : Vec3
        World ray; t counts in lengths of d.
    skip : int
        Id of a flat primitive that the ray starts on and hence cannot meet again; -1 for none.
    stack, stack_t : flat int64 and float64, MAX_DEPTH entries
        Scratch.
    """
    best_t = math.inf
    best = int64(-1)  # not a literal: numba would compile a copy of what it is handed to
    best_slot = int64(-1)
    best_v = 0.0
    best_w = 0.0
    if not is_valid_ray(o, d):
        return Hit(best_t, best, best_slot, best_v, best_w)
    # Planes first: they shorten the ray for the hierarchy.
    first_plane = view.n_triangles + view.n_shapes
    for k in range(view.n_planes):
        t = cross_plane(at(view.plane_point, 3 * k), at(view.plane_normal, 3 * k), o, d)
        if first_plane + k != skip and t < math.inf and _is_nearer(t, first_plane + k, best_t, best):
            best_t = t
            best = first_plane + k
    if first_plane == 0:
        return Hit(best_t, best, best_slot, best_v, best_w)
    shear = shear_ray(o, d)
    slabs = make_slabs(view.bvh_root, o, d)
    top = int64(0)
    node = int64(0)
    count = int64(0)
    while True:
        if count == 0:
            # Test both children; go on with the nearer one and keep the other.
            spans = enter_children(view.bvh_bounds, node, slabs, best_t)
            j = 4 * node
            hit0 = spans.near0 <= spans.far0
            hit1 = spans.near1 <= spans.far1
            if hit0 and hit1:
                if spans.near1 < spans.near0:
                    stack[top] = (int64(view.bvh_children[j]) << 32) | view.bvh_children[j + 1]
                    stack_t[top] = spans.near0
                    j += 2
                else:
                    stack[top] = (int64(view.bvh_children[j + 2]) << 32) | view.bvh_children[j + 3]
                    stack_t[top] = spans.near1
                top += 1
                node = int64(view.bvh_children[j])
                count = int64(view.bvh_children[j + 1])
                continue
            if hit0 or hit1:
                if hit1:
                    j += 2
                node = int64(view.bvh_children[j])
                count = int64(view.bvh_children[j + 1])
                continue
        else:
            for slot in range(node, node + count):
                primitive = int64(view.bvh_slots[slot])
                if primitive < view.n_triangles:
                    hit = intersect_triangle(view.bvh_vertices, slot, shear)
                    if _is_nearer(hit.t, primitive, best_t, best) and primitive != skip:
                        best_t = hit.t
                        best = primitive
                        best_slot = slot
                        best_v = hit.v
                        best_w = hit.w
                else:
                    crossings = _cross_local(view, primitive - view.n_triangles, o, d)
                    t = crossings.t0 if crossings.t0 > 0.0 else crossings.t1
                    if _is_nearer(t, primitive, best_t, best) and primitive != skip:
                        best_t = t
                        best = primitive
                        best_slot = slot
        # Take the next entry that is not yet beyond the best hit.
        while top > 0 and stack_t[top - 1] > best_t:
            top -= 1
        if top == 0:
            break
        top -= 1
        node = stack[top] >> 32
        count = stack[top] & 0xFFFFFFFF
    return Hit(best_t, best, best_slot, best_v, best_w)


@inline
def material_of(view: SceneView, primitive: int) -> int:
    """Row of the primitive's material."""
    if primitive < view.n_triangles:
        return int(view.face_material[primitive])
    if primitive < view.n_triangles + view.n_shapes:
        return int(view.shape_material[primitive - view.n_triangles])
    return int(view.plane_material[primitive - view.n_triangles - view.n_shapes])


@inline
def is_opaque(view: SceneView, material: int) -> bool:
    """Tell whether a material lets no light through: kt is black."""
    i = N_MATERIAL * material + MATERIAL_KT
    return bool(view.materials[i] == 0.0 and view.materials[i + 1] == 0.0 and view.materials[i + 2] == 0.0)


@inline
def hits_occluder(view: SceneView, slot: int, t_max: float, skip: int, shear: Shear) -> bool:
    """Tell whether the (opaque) triangle in a slot lies in 0 < t < t_max."""
    t = intersect_triangle(view.bvh_vertices, slot, shear).t
    return 0.0 < t < t_max and int64(view.bvh_slots[slot]) != skip


class Shadow(NamedTuple):
    """Share of a light that arrives, RGB, and the slot of an opaque triangle in its way (-1: none known)."""

    red: float
    green: float
    blue: float
    occluder: int
    from_cache: bool


@inline
def transmit(view: SceneView, o: Vec3, d: Vec3, t_max: float, skip: int, occluder: int, stack: Any) -> Shadow:
    """Multiply the kt of every surface crossed in 0 < t < t_max; stop when nothing is left.

    Parameters
    ----------
    o, d, t_max
        World ray; infinite t_max for a directional light, 1 where d reaches to the light.
    skip
        As for :func:`closest_hit`.
    occluder
        Slot of the opaque triangle that ended the last shadow ray of this light, tried first, or -1. It changes no
        result: what it ends is black anyway.
    stack
        Scratch of MAX_DEPTH int64.
    """
    red = 1.0
    green = 1.0
    blue = 1.0
    if not is_valid_ray(o, d):
        return Shadow(red, green, blue, -1, False)
    first_plane = view.n_triangles + view.n_shapes
    for k in range(view.n_planes):
        t = cross_plane(at(view.plane_point, 3 * k), at(view.plane_normal, 3 * k), o, d)
        if 0.0 < t < t_max and first_plane + k != skip:
            i = N_MATERIAL * int64(view.plane_material[k]) + MATERIAL_KT
            red *= view.materials[i]
            green *= view.materials[i + 1]
            blue *= view.materials[i + 2]
    if (red == 0.0 and green == 0.0 and blue == 0.0) or first_plane == 0:
        return Shadow(red, green, blue, -1, False)
    shear = shear_ray(o, d)
    if occluder >= 0 and hits_occluder(view, occluder, t_max, skip, shear):
        return Shadow(0.0, 0.0, 0.0, occluder, True)
    slabs = make_slabs(view.bvh_root, o, d)
    top = int64(0)
    node = int64(0)
    count = int64(0)
    while True:
        if count == 0:
            spans = enter_children(view.bvh_bounds, node, slabs, t_max)
            j = 4 * node
            hit1 = spans.near1 <= spans.far1
            if spans.near0 <= spans.far0:
                if hit1:
                    stack[top] = (int64(view.bvh_children[j + 2]) << 32) | view.bvh_children[j + 3]
                    top += 1
                node = int64(view.bvh_children[j])
                count = int64(view.bvh_children[j + 1])
                continue
            if hit1:
                node = int64(view.bvh_children[j + 2])
                count = int64(view.bvh_children[j + 3])
                continue
        else:
            for slot in range(node, node + count):
                primitive = int64(view.bvh_slots[slot])
                crossed = 0
                if primitive < view.n_triangles:
                    t = intersect_triangle(view.bvh_vertices, slot, shear).t
                    if 0.0 < t < t_max and primitive != skip:
                        crossed = 1
                elif primitive != skip:
                    crossings = _cross_local(view, primitive - view.n_triangles, o, d)
                    crossed = int(0.0 < crossings.t0 < t_max) + int(0.0 < crossings.t1 < t_max)
                for _ in range(crossed):
                    i = N_MATERIAL * material_of(view, primitive) + MATERIAL_KT
                    red *= view.materials[i]
                    green *= view.materials[i + 1]
                    blue *= view.materials[i + 2]
                if red == 0.0 and green == 0.0 and blue == 0.0:
                    keep = primitive < view.n_triangles and is_opaque(view, material_of(view, primitive))
                    return Shadow(0.0, 0.0, 0.0, slot if keep else -1, False)
        if top == 0:
            break
        top -= 1
        node = stack[top] >> 32
        count = stack[top] & 0xFFFFFFFF
    return Shadow(red, green, blue, -1, False)
