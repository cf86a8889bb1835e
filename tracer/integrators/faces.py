"""Faces, and whether their plane's equation is as good as the weights of their vertices."""

import math
from typing import Any, Final

from tracer.geometry.vector import at, cross, dot, is_black, length, multiply, subtract
from tracer.jit import inline, int64
from tracer.rays.rows import T_BEST, VECTOR
from tracer.shading.rows import DIRECTION, GEOMETRIC, lane_at, vector_at
from tracer.simd import absolute, all_lanes, load, maximum, splat
from tracer.types import (
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_POSITION,
    LIGHT_SPECULAR,
    MATERIAL_EXPONENT,
    MATERIAL_KS,
    N_LIGHT,
    N_MATERIAL,
    SceneView,
)

_SLANT: Final = 2.0**-10  # of the cosine between a ray and a plane whose equation is used
_SLIM: Final = 2.0**-6  # of twice a triangle's area over its longest edge squared; beyond, it has no sure plane
SLIM_MIRROR: Final = 2.0**-3  # the same of a mirror whose pencil is used
ROOM: Final = 2.0**13  # reach over the lamp's height, its share, slant and slimness: 2**-53 of it is below 1e-12
ROOM_MIRRORED: Final = 2.0**10


@inline
def corners_of(view: SceneView, face: int) -> Any:
    """Return where the coordinates of a face's three vertices begin."""
    return (
        3 * int64(view.face_vertices[3 * face]),
        3 * int64(view.face_vertices[3 * face + 1]),
        3 * int64(view.face_vertices[3 * face + 2]),
    )


@inline
def slimness(view: SceneView, face: int) -> Any:
    """Return twice a triangle's area over its longest edge squared, and the length of that edge."""
    i0, i1, i2 = corners_of(view, face)
    p0, p1, p2 = at(view.vertex_positions, i0), at(view.vertex_positions, i1), at(view.vertex_positions, i2)
    e1, e2, e3 = subtract(p1, p0), subtract(p2, p0), subtract(p2, p1)
    longest = max(dot(e1, e1), dot(e2, e2), dot(e3, e3))
    return length(cross(e1, e2)) / longest, math.sqrt(longest)


@inline
def has_sure_plane(view: SceneView, hits: int, face: int, lit: int, before: Any, room: float) -> bool:
    """Tell whether the plane's equation gives the light of all between the corners' hits within what `.plain` states.

    A point of the plane is off by about eps (reach) / (slimness slant), reach being the largest of the vertices'
    coordinates, the longest edge and the way from the eye; a lamp's cosine by that over its height above the plane.
    """
    slim, longest = slimness(view, face)
    i0, i1, i2 = corners_of(view, face)
    p0, p1, p2 = at(view.vertex_positions, i0), at(view.vertex_positions, i1), at(view.vertex_positions, i2)
    n = lane_at(hits + GEOMETRIC)
    slant = absolute(dot(vector_at(hits + GEOMETRIC), vector_at(hits + DIRECTION)))
    if not (slim > _SLIM and all_lanes(slant > splat(VECTOR, _SLANT))):
        return False
    farthest = max(abs(p0.x), abs(p0.y), abs(p0.z), abs(p1.x), abs(p1.y), abs(p1.z), abs(p2.x), abs(p2.y), abs(p2.z))
    reach = maximum(before + load(VECTOR, hits + T_BEST), splat(VECTOR, max(farthest, longest)))
    i = N_MATERIAL * int64(view.face_material[face])
    for light in range(view.n_lights):
        if (lit >> light) & 1 == 0 or view.light_kind[light] == LIGHT_KIND_DIRECTIONAL:
            continue
        lamp = N_LIGHT * light
        height = abs(dot(n, subtract(at(view.lights, lamp + LIGHT_POSITION), p0)))
        ks = multiply(at(view.materials, i + MATERIAL_KS), at(view.lights, lamp + LIGHT_SPECULAR))
        if not is_black(ks):
            height /= math.sqrt(max(1.0, view.materials[i + MATERIAL_EXPONENT]))
        if not all_lanes(reach <= slant * splat(VECTOR, room * slim * height)):
            return False
    return True
