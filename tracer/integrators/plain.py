"""Waves that see one flat face and nothing else: four rays show it, and no other ray is traced.

The camera rays of a rectangle of pixels lie between the rays through its corners. Where the beam of these four meets
one triangle only, and passes within its edges (:data:`tracer.rays.packet.SOLE`), every ray of the rectangle meets that
triangle. What they meet lies within the quadrilateral of the corners' hits, so the shadow rays to a lamp lie between
the corners' shadow rays, and the same question tells whether all of them arrive or none does. Such a wave needs neither
packets nor shadow rays: its samples are shaded four at a time in registers.

Why the corners speak for all. Rays from one point (the eye, or back from a lamp) or of one direction that start on a
plane: their lines at any depth are a projective image of the rectangle, so the corners' hull holds all. The signs of
distances to a plane, of n . l, and the dominant axis with its sense are the same in a convex hull as at its corners;
each is asked for with a margin above what rounding can amount to. A spot's cone is convex, its outside is not.

Invariant: bit for bit the sums of the packets' path. The same floats are computed in the same order; where that is not
certain the wave is not plain.
"""

import math
from typing import Any, Final, NamedTuple

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.accel.layout import HEADER_WIDE_LEAVES
from tracer.geometry.vector import add, at, dot, is_black, multiply, negate, subtract
from tracer.integrators.scratch import WAVE, Scratch
from tracer.jit import inline, int64, kernel
from tracer.rays.camera_lanes import fill_camera_rays, view_directions
from tracer.rays.packet import CLOSEST, FROM_POINT, NONE, SOLE, trace_packet
from tracer.rays.packet_leaf import stack_of_nine
from tracer.rays.predicate import weigh
from tracer.rays.rows import (
    AXIS,
    INTEGERS,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    ROW,
    SHEAR,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    WEIGHT_1,
    shear_lanes,
)
from tracer.shading.direct import face_light, reflect_light, see_light
from tracer.shading.rows import ATTENUATION, DIRECTION, NORMAL, POSITION, THROUGHPUT, choose, spread, vector_at
from tracer.shading.surfaces import blend, face_normals, fill_surfaces
from tracer.simd import absolute, all_lanes, load, maximum, splat, sqrt, stand_alone, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_DISTANCE,
    CAMERA_EYE,
    CAMERA_VIEW_PLANE,
    COUNTERS,
    FACE_HAS_COLORS,
    FLAG_TEXTURE,
    FLAG_TWO_SIDED,
    LIGHT_DIFFUSE,
    LIGHT_SPECULAR,
    MATERIAL_A,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KR,
    MATERIAL_KS,
    MATERIAL_KT,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    SETTING_CAMERA,
    SETTING_HEIGHT,
    SETTING_SHADOWS,
    SETTING_SKIP,
    SETTING_WIDTH,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64
_INF: Final = math.inf
_SKIPPED_FACING: Final = COUNTERS.index("shadow_rays_skipped_facing")
_SKIPPED_BLACK: Final = COUNTERS.index("shadow_rays_skipped_black")
_SKIPPED_SHARED: Final = COUNTERS.index("shadow_rays_skipped_shared")
_SKIPPED_PLAIN: Final = COUNTERS.index("samples_skipped_plain")
_MOST_LIGHTS: Final = 62  # sets of lights are int64
_WITHIN: Final = 1.0 - 2.0**-30  # slopes: the dominant axis is certain for all between
_AWAY: Final = -(2.0**-30)  # n . l: no rounding makes it positive
_CLEAR: Final = 2.0**-20  # share of its way that a shadow ray has gone when it meets what darkens it, and has left


class Plain(NamedTuple):
    """What a wave sees; sets of lights have bit i for light i."""

    face: int  # -1: the wave is not plain
    place: int  # address of the face in its leaf
    row: int  # bytes of a row there
    size: int  # bytes of a coordinate there
    word: int  # the face's word there
    axis: int  # AXIS of the camera rays
    lit: int  # lights whose rays all arrive
    dark: int  # lights whose rays all meet something opaque
    black: int  # lights that add nothing here; what is left faces away


@inline
def _none() -> Plain:
    zero = _int64(0)
    return Plain(_int64(-1), zero, zero, zero, zero, zero, zero, zero, zero)


@inline
def _goes_one_way(packet: int) -> bool:
    """Tell whether four rays, and so all between them, certainly have one dominant axis and sense."""
    axis = load(INTEGERS, packet + AXIS)
    slope = maximum(absolute(load(VECTOR, packet + SHEAR)), absolute(load(VECTOR, packet + SHEAR + ROW)))
    same = all_lanes(axis == splat(INTEGERS, load(_int64, packet + AXIS)))
    return bool(same and all_lanes(slope < splat(VECTOR, _WITHIN)))


@inline
def _is_plain(view: SceneView, face: int) -> bool:
    """Tell whether a face has one normal and one colour all over, and sends nothing on."""
    material = int64(view.face_material[face])
    i = N_MATERIAL * material
    flags = int64(view.face_flags[face])
    if flags & FACE_HAS_COLORS or view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TEXTURE] >= 0:
        return False
    if not (is_black(at(view.materials, i + MATERIAL_KR)) and is_black(at(view.materials, i + MATERIAL_KT))):
        return False
    i0, i1, i2 = _corners(view, face)
    p0 = at(view.vertex_positions, i0)
    smooth, _normal, _facing = face_normals(
        flags,
        subtract(at(view.vertex_positions, i1), p0),
        subtract(at(view.vertex_positions, i2), p0),
        at(view.vertex_normals, i0),
        at(view.vertex_normals, i1),
        at(view.vertex_normals, i2),
    )
    return not smooth


@inline
def _corners(view: SceneView, face: int) -> Any:
    """Return where the three vertices' coordinates begin."""
    return (
        3 * int64(view.face_vertices[3 * face]),
        3 * int64(view.face_vertices[3 * face + 1]),
        3 * int64(view.face_vertices[3 * face + 2]),
    )


@inline
def _all_dark(view: SceneView, scratch: Scratch, blocker: int) -> bool:
    """Tell whether four shadow rays, and so all between them, meet an opaque triangle well on their way."""
    if not is_black(at(view.materials, N_MATERIAL * int64(view.face_material[blocker]) + MATERIAL_KT)):
        return False
    shadows = scratch.shadows
    end = load(VECTOR, shadows + T_BEST)
    store(shadows + PRIMITIVE, splat(INTEGERS, _int64(-1)))
    trace_packet(scratch.tree, shadows, _int64(NIBBLE), int64(CLOSEST), int64(0), int64(0), int64(0))
    t = load(VECTOR, shadows + T_BEST)
    store(shadows + T_BEST, end)
    if not all_lanes(load(INTEGERS, shadows + PRIMITIVE) == splat(INTEGERS, blocker)):
        return False
    if load(_float64, shadows + T_BEST) == _INF:  # t counts world units: as a share of the scene's size
        extent = max(
            view.bvh_root[3] - view.bvh_root[0],
            view.bvh_root[4] - view.bvh_root[1],
            view.bvh_root[5] - view.bvh_root[2],
        )
        return bool(all_lanes(t > splat(VECTOR, _CLEAR * extent)))
    return bool(all_lanes((t > splat(VECTOR, _CLEAR)) & (t < splat(VECTOR, 1.0 - _CLEAR))))


@inline
def _faces_away(view: SceneView, scratch: Scratch, light: int) -> bool:
    """Tell whether a light certainly is behind all between the corners' hits."""
    hits = scratch.hits
    to_light, _strength = see_light(
        view, int64(view.light_kind[light]), light, vector_at(hits + POSITION), vector_at(hits + ATTENUATION)
    )
    return bool(all_lanes(dot(vector_at(hits + NORMAL), to_light) < splat(VECTOR, _AWAY)))


@kernel
def look_at_corners(
    view: SceneView, ambient: Vec3, scratch: Scratch, x0: float, y0: float, x1: float, y1: float
) -> Plain:
    """Find out whether all camera rays of a rectangle of pixels see one plain face under the same lights.

    Parameters
    ----------
    view, ambient, scratch
        As for :func:`tracer.integrators.blinn_phong.trace_radiance`; the rays of ``scratch`` are overwritten.
    x0, y0, x1, y1
        Rectangle in pixels from the top left corner of the full image.
    """
    stand_alone()
    settings = view.settings
    hits = scratch.hits
    distance = view.camera[CAMERA_DISTANCE]
    if (
        settings[SETTING_SKIP] == 0
        or settings[SETTING_CAMERA] != CAMERA_VIEW_PLANE
        or view.n_shapes + view.n_planes > 0
        or view.n_lights > _MOST_LIGHTS
        or not 1e-100 < distance < 1e100
    ):
        return _none()
    x, y = hits + THROUGHPUT, hits + THROUGHPUT + ROW  # free so far
    for corner in range(4):
        store(x + 8 * corner, _float64(x0 if corner % 2 == 0 else x1))
        store(y + 8 * corner, _float64(y0 if corner < 2 else y1))
    fill_camera_rays(
        view.camera, settings[SETTING_CAMERA], settings[SETTING_WIDTH], settings[SETTING_HEIGHT], 4, x,
        hits + ORIGIN, hits + DIRECTION,
    )  # fmt: skip
    d = vector_at(hits + DIRECTION)
    shear_lanes(hits, 0, d.x, d.y, d.z)
    store(hits + T_BEST, splat(VECTOR, _INF))
    store(hits + PRIMITIVE, splat(INTEGERS, _int64(-1)))
    store(hits + SKIP, splat(INTEGERS, _int64(-1)))
    if not _goes_one_way(hits):
        return _none()
    corners = _int64(NIBBLE)
    face = trace_packet(scratch.tree, hits, corners, int64(SOLE + FROM_POINT), int64(0), int64(0), int64(0))
    if face < 0 or not _is_plain(view, face):
        return _none()
    place, row, word = (
        load(_int64, hits + WEIGHT_1),
        load(_int64, hits + WEIGHT_1 + 8),
        load(_int64, hits + WEIGHT_1 + 16),
    )
    trace_packet(scratch.tree, hits, corners, int64(CLOSEST), int64(0), int64(0), int64(0))
    if not all_lanes(load(INTEGERS, hits + PRIMITIVE) == splat(INTEGERS, face)):
        return _none()
    fill_surfaces(view, ambient, hits, corners)
    material = N_MATERIAL * int64(view.face_material[face])
    lit, dark, black = _int64(0), _int64(0), _int64(0)
    for light in range(view.n_lights):
        i = N_LIGHT * light
        kd = multiply(at(view.materials, material + MATERIAL_KD), at(view.lights, i + LIGHT_DIFFUSE))
        ks = multiply(at(view.materials, material + MATERIAL_KS), at(view.lights, i + LIGHT_SPECULAR))
        if _faces_away(view, scratch, light):
            continue
        if is_black(kd) and is_black(ks):
            black |= _int64(1) << light
            continue
        # what it counts is nobody's: into memory that only shapes need
        facing = face_light(view, light, hits, scratch.shadows, corners, scratch.stack)
        if facing != corners:
            return _none()
        if settings[SETTING_SHADOWS] != 0:
            if not _goes_one_way(scratch.shadows):
                return _none()
            blocker = trace_packet(scratch.tree, scratch.shadows, corners, int64(SOLE), int64(0), int64(0), int64(0))
            if blocker != NONE:
                if blocker < 0 or not _all_dark(view, scratch, blocker):
                    return _none()
                dark |= _int64(1) << light
                continue
        lit |= _int64(1) << light
    size = _int64(8 if load(_int64, scratch.tree + 8 * HEADER_WIDE_LEAVES) else 4)
    return Plain(face, place, row, size, word, load(_int64, hits + AXIS), lit, dark, black)


@kernel
def shade_plain(
    view: SceneView, ambient: Vec3, scratch: Scratch, plain: Plain, places: int, n: int, start: int
) -> None:
    """Shade samples of a plain wave, and write their colours.

    Parameters
    ----------
    view, ambient, scratch
        As for :func:`tracer.integrators.blinn_phong.trace_radiance`; of ``scratch`` only ``radiance`` and ``counters``
        are written.
    plain
        What the wave sees.
    places
        Address of two rows: x, y in pixels from the top left corner of the full image.
    n
        How many; colours are written up to the next multiple of four.
    start
        Sample of the wave of the first.
    """
    stand_alone()
    camera, settings = view.camera, view.settings
    width, height = settings[SETTING_WIDTH], settings[SETTING_HEIGHT]
    face = plain.face
    kz = plain.axis >> 1
    kx = kz - 2 if kz == 2 else kz + 1
    ky = kz - 1 if kz > 0 else _int64(2)
    zero, one = splat(VECTOR, 0.0), splat(VECTOR, 1.0)
    ox, oy, oz = camera[CAMERA_EYE + kx], camera[CAMERA_EYE + ky], camera[CAMERA_EYE + kz]
    c = stack_of_nine(plain.place, plain.size, plain.row, kx, ky, kz)
    pax, pay, paz = splat(VECTOR, c[0] - ox), splat(VECTOR, c[1] - oy), splat(VECTOR, c[2] - oz)
    pbx, pby, pbz = splat(VECTOR, c[3] - ox), splat(VECTOR, c[4] - oy), splat(VECTOR, c[5] - oz)
    pcx, pcy, pcz = splat(VECTOR, c[6] - ox), splat(VECTOR, c[7] - oy), splat(VECTOR, c[8] - oz)
    order = plain.word & ((1 << ORDER_BITS) - 1)
    second = (PLACE_1 >> (2 * order)) & 3
    third = (PLACE_2 >> (2 * order)) & 3
    i0, i1, i2 = _corners(view, face)
    p0, p1, p2 = at(view.vertex_positions, i0), at(view.vertex_positions, i1), at(view.vertex_positions, i2)
    _smooth, normal, facing = face_normals(
        int64(view.face_flags[face]),
        subtract(p1, p0),
        subtract(p2, p0),
        at(view.vertex_normals, i0),
        at(view.vertex_normals, i1),
        at(view.vertex_normals, i2),
    )
    material = int64(view.face_material[face])
    two_sided = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TWO_SIDED] != 0
    i = N_MATERIAL * material
    kd, ks = at(view.materials, i + MATERIAL_KD), at(view.materials, i + MATERIAL_KS)
    exponent, fading = view.materials[i + MATERIAL_EXPONENT], spread(at(view.materials, i + MATERIAL_A))
    own = add(multiply(at(view.materials, i + MATERIAL_KA), ambient), at(view.materials, i + MATERIAL_KE))
    flat, level, turned = spread(normal), spread(facing), spread(negate(facing))
    for k in range((n + 3) // 4):
        x, y = load(VECTOR, places + STEP * k), load(VECTOR, places + ROW + STEP * k)
        d = view_directions(camera, width, height, x, y)
        inverse = one / sqrt(dot(d, d))
        d = Vec3(d.x * inverse, d.y * inverse, d.z * inverse)
        along = d.z if kz == 2 else (d.y if kz == 1 else d.x)
        inverse = one / along
        shear_x = (d.x if kx == 0 else (d.y if kx == 1 else d.z)) * inverse
        shear_y = (d.x if ky == 0 else (d.y if ky == 1 else d.z)) * inverse
        ax, ay = pax - shear_x * paz, pay - shear_y * paz
        bx, by = pbx - shear_x * pbz, pby - shear_y * pbz
        cx, cy = pcx - shear_x * pcz, pcy - shear_y * pcz
        u, v, w = weigh(cx, cy, bx, by), weigh(ax, ay, cx, cy), weigh(bx, by, ax, ay)
        total = (u + v) + w
        b1 = (u if second == 0 else (v if second == 1 else w)) / total
        b2 = (u if third == 0 else (v if third == 1 else w)) / total
        b0 = (one - b1) - b2
        position = blend(p0, p1, p2, b0, b1, b2)
        shading = level
        if two_sided:
            shading = choose(dot(flat, d) > zero, turned, level)
        color = spread(own)
        for light in range(view.n_lights):
            if (plain.lit >> light) & 1 == 0:
                continue
            place = N_LIGHT * light
            to_light, strength = see_light(view, int64(view.light_kind[light]), light, position, fading)
            cosine = dot(shading, to_light)
            reflected = reflect_light(
                spread(multiply(kd, at(view.lights, place + LIGHT_DIFFUSE))),
                spread(multiply(ks, at(view.lights, place + LIGHT_SPECULAR))),
                cosine,
                splat(VECTOR, exponent),
                shading,
                to_light,
                d,
            )
            arrives = (cosine > zero) & (strength > zero)
            color = choose(
                arrives,
                Vec3(
                    color.x + reflected.x * strength,
                    color.y + reflected.y * strength,
                    color.z + reflected.z * strength,
                ),
                color,
            )
        pixel = scratch.radiance + 8 * start + STEP * k
        store(pixel, color.x)
        store(pixel + 8 * WAVE, color.y)
        store(pixel + 16 * WAVE, color.z)
    counters = scratch.counters
    counters[_SKIPPED_PLAIN] += n
    for light in range(view.n_lights):
        if ((plain.lit | plain.dark) >> light) & 1:
            if settings[SETTING_SHADOWS] != 0:
                counters[_SKIPPED_SHARED] += n
        elif (plain.black >> light) & 1:
            counters[_SKIPPED_BLACK] += n
        else:
            counters[_SKIPPED_FACING] += n
