"""The facts of a hit on a shape or a plane that shading needs: point, normals, tint, material."""

from typing import NamedTuple

from tracer.accel.traverse import material_of
from tracer.geometry.shapes import locate_on_plane, locate_on_shape
from tracer.geometry.vector import at
from tracer.jit import inline, int64
from tracer.shading.texture import sample_texture
from tracer.types import (
    FLAG_FILTER,
    FLAG_TEXTURE,
    FLAG_WRAP,
    N_MATERIAL_FLAGS,
    SceneView,
    Vec3,
)


class Surface(NamedTuple):
    """A hit point, in world space."""

    position: Vec3
    error: Vec3  # bound on each coordinate's error
    geometric: Vec3  # unit, turned to the shading normal's side
    shading: Vec3  # unit, not yet turned towards the viewer
    tint: Vec3  # vertex colour x texture, multiplies ka and kd
    material: int
    skip: int  # the primitive's id when it is flat, else -1: what a ray from here cannot meet again


@inline
def make_surface(view: SceneView, primitive: int, t: float, o: Vec3, d: Vec3) -> Surface:
    """Gather the facts of a hit of the ray (o, d) on a shape or a plane at parameter ``t``."""
    material = material_of(view, primitive)
    tint = Vec3(1.0, 1.0, 1.0)
    skip = int64(-1)
    if primitive < view.n_triangles + view.n_shapes:
        shape = primitive - view.n_triangles
        point = locate_on_shape(
            view.shape_kind[shape],
            at(view.shape_origin, 3 * shape),
            view.shape_to_world,
            view.shape_to_local,
            9 * shape,
            o,
            d,
            t,
        )
    else:
        plane = primitive - view.n_triangles - view.n_shapes
        point = locate_on_plane(
            at(view.plane_point, 3 * plane), at(view.plane_normal, 3 * plane), view.plane_uv, 6 * plane, o, d, t
        )
        skip = primitive
    texture = int64(view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TEXTURE])
    if texture >= 0:
        wrap = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_WRAP]
        filtering = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_FILTER]
        texel = sample_texture(view.textures, view.texels, texture, wrap, filtering, point.u, point.v)
        tint = Vec3(tint.x * texel.x, tint.y * texel.y, tint.z * texel.z)
    return Surface(point.position, point.error, point.normal, point.normal, tint, material, skip)
