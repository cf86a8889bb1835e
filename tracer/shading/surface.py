"""The facts of a hit that shading needs: point, normals, tint, material."""

from typing import NamedTuple

from tracer.accel.traverse import Hit, material_of
from tracer.geometry.shapes import SurfacePoint, locate_on_plane, locate_on_shape, locate_on_triangle
from tracer.geometry.vector import at, dot, is_zero, negate, normalize
from tracer.jit import inline, int64
from tracer.shading.texture import sample_texture
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
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
def _interpolate(values: "object", i0: int, i1: int, i2: int, b0: float, b1: float, b2: float) -> Vec3:
    """Weighted sum of three rows of three."""
    a = at(values, 3 * i0)
    b = at(values, 3 * i1)
    c = at(values, 3 * i2)
    return Vec3(b0 * a.x + b1 * b.x + b2 * c.x, b0 * a.y + b1 * b.y + b2 * c.y, b0 * a.z + b1 * b.z + b2 * c.z)


@inline
def _weight_of(corner: int, view: SceneView, hit: Hit) -> float:
    """Weight of a corner of the face as given, from those of the sorted triangle in the hierarchy's slot."""
    i = 3 * hit.slot
    if view.bvh_corners[i + 1] == corner:
        return hit.v
    if view.bvh_corners[i + 2] == corner:
        return hit.w
    return 1.0 - hit.v - hit.w


@inline
def make_surface(view: SceneView, hit: Hit, o: Vec3, d: Vec3) -> Surface:
    """Gather the facts of a hit of the ray (o, d); ``hit.primitive`` must not be -1."""
    material = material_of(view, hit.primitive)
    tint = Vec3(1.0, 1.0, 1.0)
    skip = int64(-1)
    raw = Vec3(0.0, 0.0, 0.0)
    if hit.primitive < view.n_triangles:
        face = hit.primitive
        i0 = int64(view.face_vertices[3 * face])
        i1 = int64(view.face_vertices[3 * face + 1])
        i2 = int64(view.face_vertices[3 * face + 2])
        b1 = _weight_of(1, view, hit)
        b2 = _weight_of(2, view, hit)
        b0 = 1.0 - b1 - b2
        point = locate_on_triangle(view.vertex_positions, i0, i1, i2, b1, b2)
        skip = face
        flags = int64(view.face_flags[face])
        if flags & FACE_HAS_NORMALS:  # as given, then unit
            raw = _interpolate(view.vertex_normals, i0, i1, i2, b0, b1, b2)
        if flags & FACE_HAS_COLORS:
            tint = _interpolate(view.vertex_colors, i0, i1, i2, b0, b1, b2)
        u = 0.0
        v = 0.0
        if flags & FACE_HAS_UVS:
            uvs = view.vertex_uvs
            u = b0 * uvs[2 * i0] + b1 * uvs[2 * i1] + b2 * uvs[2 * i2]
            v = b0 * uvs[2 * i0 + 1] + b1 * uvs[2 * i1 + 1] + b2 * uvs[2 * i2 + 1]
        point = SurfacePoint(point.position, point.error, point.normal, u, v)
    elif hit.primitive < view.n_triangles + view.n_shapes:
        shape = hit.primitive - view.n_triangles
        point = locate_on_shape(
            view.shape_kind[shape],
            at(view.shape_origin, 3 * shape),
            view.shape_to_world,
            view.shape_to_local,
            9 * shape,
            o,
            d,
            hit.t,
        )
    else:
        plane = hit.primitive - view.n_triangles - view.n_shapes
        point = locate_on_plane(
            at(view.plane_point, 3 * plane), at(view.plane_normal, 3 * plane), view.plane_uv, 6 * plane, o, d, hit.t
        )
        skip = hit.primitive
    # Flat faces, and those whose vertex normals cancel out, shade by the geometric normal.
    shading = point.normal if is_zero(raw) else normalize(raw)
    geometric = negate(point.normal) if dot(point.normal, shading) < 0.0 else point.normal
    texture = int64(view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TEXTURE])
    if texture >= 0:
        wrap = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_WRAP]
        filtering = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_FILTER]
        texel = sample_texture(view.textures, view.texels, texture, wrap, filtering, point.u, point.v)
        tint = Vec3(tint.x * texel.x, tint.y * texel.y, tint.z * texel.z)
    return Surface(point.position, point.error, geometric, shading, tint, material, skip)
