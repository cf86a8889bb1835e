"""Shade waves that see one flat face of one colour under lights that all of it gets or none (:mod:`.corners`).

Nothing is traced, and nothing is kept in memory between the steps: four samples at a time from the place in the picture
to the colour.

Invariant: bit for bit the colours that the packets give. The same floats are computed in the same order.
"""

from typing import Final

from tracer.accel.emit import ORDER_BITS, PLACE_1, PLACE_2
from tracer.geometry.vector import add, at, cross, dot, multiply, negate, subtract
from tracer.integrators.corners import Seen, corners_of
from tracer.integrators.scratch import WAVE, Scratch
from tracer.jit import inline, int64, kernel
from tracer.rays.camera_lanes import view_directions
from tracer.rays.packet_leaf import stack_of_nine
from tracer.rays.predicate import weigh
from tracer.rays.rows import (
    ROW,
    STEP,
    VECTOR,
)
from tracer.shading.direct import reflect_light, see_light
from tracer.shading.rows import choose, spread
from tracer.shading.surfaces import blend, face_normals
from tracer.simd import load, splat, sqrt, stack_memory, stand_alone, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_EYE,
    COUNTERS,
    FLAG_TWO_SIDED,
    LIGHT_DIFFUSE,
    LIGHT_SPECULAR,
    MATERIAL_A,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KS,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    SETTING_HEIGHT,
    SETTING_SHADOWS,
    SETTING_WIDTH,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64
_LAMP_BYTES: Final = 56  # kd and ks times the light's colours, and its number
_SHARED_BYTES: Final = 64 * _LAMP_BYTES
_SKIPPED_FACING: Final = COUNTERS.index("shadow_rays_skipped_facing")
_SKIPPED_BLACK: Final = COUNTERS.index("shadow_rays_skipped_black")
_SKIPPED_SHARED: Final = COUNTERS.index("shadow_rays_skipped_shared")
_SKIPPED_SHARED_PRIMARY: Final = COUNTERS.index("primary_rays_skipped_shared")


@inline
def _put_color(address: int, color: Vec3) -> None:
    store(address, color.x)
    store(address + 8, color.y)
    store(address + 16, color.z)


@inline
def _spread_color(address: int) -> Vec3:
    return Vec3(
        splat(VECTOR, load(_float64, address)),
        splat(VECTOR, load(_float64, address + 8)),
        splat(VECTOR, load(_float64, address + 16)),
    )


@kernel
def shade_plain(view: SceneView, ambient: Vec3, scratch: Scratch, seen: Seen, places: int, n: int, start: int) -> None:
    """Shade samples of a plain wave, and write their colours.

    Parameters
    ----------
    view, ambient, scratch
        As for :func:`tracer.integrators.blinn_phong.trace_radiance`; of ``scratch`` only ``radiance`` and ``counters``
        are written.
    seen
        What the wave sees, plain.
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
    face = seen.face
    kz = seen.axis >> 1
    kx = kz - 2 if kz == 2 else kz + 1
    ky = kz - 1 if kz > 0 else _int64(2)
    zero, one = splat(VECTOR, 0.0), splat(VECTOR, 1.0)
    ox, oy, oz = camera[CAMERA_EYE + kx], camera[CAMERA_EYE + ky], camera[CAMERA_EYE + kz]
    c = stack_of_nine(seen.place, seen.size, seen.row, kx, ky, kz)
    pax, pay, paz = splat(VECTOR, c[0] - ox), splat(VECTOR, c[1] - oy), splat(VECTOR, c[2] - oz)
    pbx, pby, pbz = splat(VECTOR, c[3] - ox), splat(VECTOR, c[4] - oy), splat(VECTOR, c[5] - oz)
    pcx, pcy, pcz = splat(VECTOR, c[6] - ox), splat(VECTOR, c[7] - oy), splat(VECTOR, c[8] - oz)
    order = seen.word & ((1 << ORDER_BITS) - 1)
    second = (PLACE_1 >> (2 * order)) & 3
    third = (PLACE_2 >> (2 * order)) & 3
    i0, i1, i2 = corners_of(view, face)
    p0, p1, p2 = at(view.vertex_positions, i0), at(view.vertex_positions, i1), at(view.vertex_positions, i2)
    _smooth, normal, facing = face_normals(
        int64(view.face_flags[face]),
        cross(subtract(p1, p0), subtract(p2, p0)),
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
    shared = stack_memory(_SHARED_BYTES)
    n_lit = _int64(0)
    for light in range(view.n_lights):
        if (seen.lit >> light) & 1:
            place, lamp = shared + _LAMP_BYTES * n_lit, N_LIGHT * light
            _put_color(place, multiply(kd, at(view.lights, lamp + LIGHT_DIFFUSE)))
            _put_color(place + 24, multiply(ks, at(view.lights, lamp + LIGHT_SPECULAR)))
            store(place + 48, _int64(light))
            n_lit += 1
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
        for lamp in range(n_lit):
            place = shared + _LAMP_BYTES * lamp
            light = load(_int64, place + 48)
            to_light, strength = see_light(view, int64(view.light_kind[light]), light, position, fading)
            cosine = dot(shading, to_light)
            reflected = reflect_light(
                _spread_color(place),
                _spread_color(place + 24),
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
    counters[_SKIPPED_SHARED_PRIMARY] += n
    for light in range(view.n_lights):
        if ((seen.lit | seen.dark) >> light) & 1:
            if settings[SETTING_SHADOWS] != 0:
                counters[_SKIPPED_SHARED] += n
        elif (seen.black >> light) & 1:
            counters[_SKIPPED_BLACK] += n
        else:
            counters[_SKIPPED_FACING] += n
