"""Shade pixels that see one flat face of one colour under lights that all of it gets or none (:mod:`.survey`).

Nothing is traced, and no ray is made. Such pixels' rays are one pencil: from a point, in directions that are affine in
the place (x, y) in the picture. Where they meet the plane n . (p - o) = c of the face, the way to a lamp L, times the
s = n . d of the ray, is affine, too: m = s (L - o) - c d. So the cosine at a sample is an affine number over the
length of an affine vector, and the colour is the face's own light plus, for each lamp, one colour times a sum of such
numbers over the samples. What a flat mirror shows is seen by the mirrored pencil.

Invariants: the face's plane, the rays and the lamps are such that its equation is as good as the weights of vertices
(:func:`tracer.integrators.faces.has_sure_plane`), so a pixel's sums are those of tracing every ray within 1e-12 of the
lights that arrive; which pixels are shaded so depends on their square of the picture alone.
"""

from typing import Any, Final, NamedTuple

from tracer.geometry.vector import add, at, cross, dot, is_black, multiply, negate, normalize, scale, subtract
from tracer.integrators.corners import PLAIN_LIGHTS, Seen
from tracer.integrators.faces import corners_of
from tracer.integrators.places import place_samples
from tracer.integrators.sums import SUMS, add_everywhere, add_shares
from tracer.jit import inline, int64, kernel
from tracer.rays.rows import PACKET, ROW, STEP, VECTOR
from tracer.shading.direct import attenuate, find_highlight
from tracer.shading.phong import reflect_direction
from tracer.shading.rows import spread
from tracer.shading.surfaces import face_normals
from tracer.simd import absolute, load, maximum, minimum, splat, sqrt, stack_memory, stand_alone, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_BOTTOM,
    CAMERA_DISTANCE,
    CAMERA_EYE,
    CAMERA_LEFT,
    CAMERA_RIGHT,
    CAMERA_TOP,
    CAMERA_U,
    CAMERA_V,
    CAMERA_W,
    COUNTERS,
    FLAG_TWO_SIDED,
    LIGHT_DIFFUSE,
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPECULAR,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KR,
    MATERIAL_KS,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    SETTING_SHADOWS,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64

# A lamp's record, in bytes. Affine functions of (x, y) are their values at (0, 0) and their two steps.
_DIFFUSE: Final = 0  # colours that its shares are multiplied by
_SPECULAR: Final = 24
_WAY: Final = 48  # m, three vectors: n . d times the way to the lamp
_FACING: Final = 120  # N . m, three numbers
_ALONG: Final = 144  # n . d, three numbers
_SIGN: Final = 168  # of n . d
_NORMAL: Final = 176  # N, turned to the viewer
_VIEW: Final = 200  # d, three vectors
_TO_LIGHT: Final = 272  # of a directional light
_EXPONENT: Final = 296
_FADING: Final = 304  # a, b, c
_AXIS: Final = 328  # of a spot
_CONE: Final = 352  # its scale and offset
_KIND: Final = 368  # int64, as are the next two
_FADES: Final = 376  # whether distance counts
_SHINES: Final = 384  # whether it has highlights
_LAMP: Final = 392
_TABLE: Final = 2 * PLAIN_LIGHTS * _LAMP
_ROWS: Final = 2 * ROW + STEP  # two, and what is read beyond them

_REFLECTION_RAYS: Final = COUNTERS.index("reflection_rays")
_PRIMARY_SHARED: Final = COUNTERS.index("primary_rays_skipped_shared")
_REFLECTION_SHARED: Final = COUNTERS.index("reflection_rays_skipped_shared")
_SKIPPED_FACING: Final = COUNTERS.index("shadow_rays_skipped_facing")
_SKIPPED_BLACK: Final = COUNTERS.index("shadow_rays_skipped_black")
_SKIPPED_SHARED: Final = COUNTERS.index("shadow_rays_skipped_shared")


class Pencil(NamedTuple):
    """Rays from one point through the places (x, y) of a picture: in direction start + x across + y down, not unit."""

    origin: Vec3
    start: Vec3
    across: Vec3
    down: Vec3


@inline
def camera_pencil(camera: Any, width: int, height: int) -> Pencil:
    """Rays from the eye through the picture [farmer2019 eq. 1], in units of the view plane's distance."""
    u, v, w = at(camera, CAMERA_U), at(camera, CAMERA_V), at(camera, CAMERA_W)
    unit = 1.0 / camera[CAMERA_DISTANCE]
    left, top = camera[CAMERA_LEFT] * unit, camera[CAMERA_TOP] * unit
    wide, high = camera[CAMERA_RIGHT] * unit - left, top - camera[CAMERA_BOTTOM] * unit
    return Pencil(
        at(camera, CAMERA_EYE),
        subtract(add(scale(u, left), scale(v, top)), w),
        scale(u, wide / width),
        scale(v, -high / height),
    )


@kernel
def _mirror(view: SceneView, pencil: Pencil, face: int) -> Pencil:
    """Rays that a flat face mirrors, as they come from the eye behind it."""
    i0, i1, i2 = corners_of(view, face)
    p0 = at(view.vertex_positions, i0)
    n = normalize(cross(subtract(at(view.vertex_positions, i1), p0), subtract(at(view.vertex_positions, i2), p0)))
    return Pencil(
        add(p0, reflect_direction(subtract(pencil.origin, p0), n)),
        reflect_direction(pencil.start, n),
        reflect_direction(pencil.across, n),
        reflect_direction(pencil.down, n),
    )


@inline
def _put(address: int, v: Vec3) -> None:
    store(address, v.x)
    store(address + 8, v.y)
    store(address + 16, v.z)


@inline
def _get(address: int) -> Vec3:
    return Vec3(load(_float64, address), load(_float64, address + 8), load(_float64, address + 16))


@inline
def _splat_vector(address: int) -> Any:
    return spread(_get(address))


@kernel
def _add_surface(
    view: SceneView, ambient: Vec3, seen: Seen, pencil: Pencil, weight: Vec3, table: int, n_lamps: int
) -> Any:
    """Add to the table the lamps whose light varies over a face; returns (what does not vary, lamps in the table)."""
    stand_alone()
    i0, i1, i2 = corners_of(view, seen.face)
    p0, p1, p2 = at(view.vertex_positions, i0), at(view.vertex_positions, i1), at(view.vertex_positions, i2)
    _smooth, normal, facing = face_normals(
        int64(view.face_flags[seen.face]),
        cross(subtract(p1, p0), subtract(p2, p0)),
        at(view.vertex_normals, i0),
        at(view.vertex_normals, i1),
        at(view.vertex_normals, i2),
    )
    material = int64(view.face_material[seen.face])
    i = N_MATERIAL * material
    c = dot(normal, subtract(p0, pencil.origin))  # of the sign of n . d, for the rays meet the plane in front of them
    if c > 0.0 and view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TWO_SIDED] != 0:
        facing = negate(facing)
    along = Vec3(dot(normal, pencil.start), dot(normal, pencil.across), dot(normal, pencil.down))
    kd, ks = at(view.materials, i + MATERIAL_KD), at(view.materials, i + MATERIAL_KS)
    fading = at(view.materials, i + MATERIAL_A)
    base = multiply(
        weight, add(multiply(at(view.materials, i + MATERIAL_KA), ambient), at(view.materials, i + MATERIAL_KE))
    )
    for light in range(view.n_lights):
        if (seen.lit >> light) & 1 == 0:
            continue
        lamp, place = N_LIGHT * light, table + _LAMP * n_lamps
        diffuse = multiply(weight, multiply(kd, at(view.lights, lamp + LIGHT_DIFFUSE)))
        specular = multiply(weight, multiply(ks, at(view.lights, lamp + LIGHT_SPECULAR)))
        shines = not is_black(specular)
        direction = at(view.lights, lamp + LIGHT_DIRECTION)
        kind = int64(view.light_kind[light])
        if kind == LIGHT_KIND_DIRECTIONAL:
            strength = 1.0 / fading.x if fading.x > 0.0 else 0.0
            base = add(base, scale(diffuse, -dot(facing, direction) * strength))
            if not shines:
                continue
            specular = scale(specular, strength)
        _put(place + _DIFFUSE, diffuse)
        _put(place + _SPECULAR, specular)
        offset = subtract(at(view.lights, lamp + LIGHT_POSITION), pencil.origin)
        start = subtract(scale(offset, along.x), scale(pencil.start, c))
        across = subtract(scale(offset, along.y), scale(pencil.across, c))
        down = subtract(scale(offset, along.z), scale(pencil.down, c))
        _put(place + _WAY, start)
        _put(place + _WAY + 24, across)
        _put(place + _WAY + 48, down)
        _put(place + _FACING, Vec3(dot(facing, start), dot(facing, across), dot(facing, down)))
        _put(place + _ALONG, along)
        store(place + _SIGN, 1.0 if c > 0.0 else -1.0)
        _put(place + _NORMAL, facing)
        _put(place + _VIEW, pencil.start)
        _put(place + _VIEW + 24, pencil.across)
        _put(place + _VIEW + 48, pencil.down)
        _put(place + _TO_LIGHT, negate(direction))
        store(place + _EXPONENT, _float64(view.materials[i + MATERIAL_EXPONENT]))
        _put(place + _FADING, fading)
        _put(place + _AXIS, direction)
        store(place + _CONE, _float64(view.lights[lamp + LIGHT_SPOT_SCALE]))
        store(place + _CONE + 8, _float64(view.lights[lamp + LIGHT_SPOT_OFFSET]))
        store(place + _KIND, kind)
        store(place + _FADES, _int64(0 if fading.x == 1.0 and fading.y == 0.0 and fading.z == 0.0 else 1))
        store(place + _SHINES, _int64(1 if shines else 0))
        n_lamps += 1
    return base, n_lamps


@inline
def _affine(address: int, x: Any, y: Any) -> Any:
    """Value of three affine functions at four places."""
    start, across, down = _splat_vector(address), _splat_vector(address + 24), _splat_vector(address + 48)
    return Vec3(
        start.x + x * across.x + y * down.x,
        start.y + x * across.y + y * down.y,
        start.z + x * across.z + y * down.z,
    )


@kernel
def _light_up(lamp: int, places: int, n: int, shares: int) -> None:
    """Find what a lamp's two colours are multiplied by at each sample: two rows."""
    stand_alone()
    one, zero = splat(VECTOR, 1.0), splat(VECTOR, 0.0)
    directional = load(_int64, lamp + _KIND) == LIGHT_KIND_DIRECTIONAL
    spot = load(_int64, lamp + _KIND) == LIGHT_KIND_SPOT
    fades, shines = load(_int64, lamp + _FADES) != 0, load(_int64, lamp + _SHINES) != 0
    sign = splat(VECTOR, load(_float64, lamp + _SIGN))
    facing, along = _splat_vector(lamp + _FACING), _splat_vector(lamp + _ALONG)
    normal, fading, axis = _splat_vector(lamp + _NORMAL), _splat_vector(lamp + _FADING), _splat_vector(lamp + _AXIS)
    exponent = splat(VECTOR, load(_float64, lamp + _EXPONENT))
    slope, offset = splat(VECTOR, load(_float64, lamp + _CONE)), splat(VECTOR, load(_float64, lamp + _CONE + 8))
    for k in range(0, 8 * n, STEP):
        x, y = load(VECTOR, places + k), load(VECTOR, places + ROW + k)
        to_light, strength = _splat_vector(lamp + _TO_LIGHT), one
        if not directional:
            way = _affine(lamp + _WAY, x, y)
            length = sqrt(dot(way, way))
            inverse = sign / length
            share = (facing.x + x * facing.y + y * facing.z) * inverse
            to_light = scale(way, inverse)
            if fades:
                strength = attenuate(fading, length / absolute(along.x + x * along.y + y * along.z))
            if spot:  # glTF KHR_lights_punctual
                cone = minimum(maximum(offset - dot(to_light, axis) * slope, zero), one)
                strength = strength * cone * cone
            store(shares + k, share * strength)
        if shines:
            d = _affine(lamp + _VIEW, x, y)
            viewing = scale(d, one / sqrt(dot(d, d)))
            store(shares + ROW + k, find_highlight(exponent, normal, to_light, viewing) * strength)


@inline
def _count(view: SceneView, counters: Any, seen: Seen, n: int) -> None:
    """Count shadow rays that were not traced."""
    for light in range(view.n_lights):
        if ((seen.lit | seen.dark) >> light) & 1:
            if view.settings[SETTING_SHADOWS] != 0:
                counters[_SKIPPED_SHARED] += n
        elif (seen.black >> light) & 1:
            counters[_SKIPPED_BLACK] += n
        else:
            counters[_SKIPPED_FACING] += n


@inline
def is_plain(view: SceneView, seen: Seen, mirrored: Seen) -> Any:
    """Tell whether `shade_plain` can shade what is seen: a dull face, or a flat mirror that shows one."""
    if seen.plain or not (seen.even and mirrored.plain):
        return seen.plain
    i = N_MATERIAL * int64(view.face_material[seen.face])
    return view.materials[i + MATERIAL_B] == 0.0 and view.materials[i + MATERIAL_C] == 0.0


@kernel
def shade_plain(
    view: SceneView,
    ambient: Vec3,
    counters: Any,
    seen: Seen,
    mirrored: Seen,
    pencil: Pencil,
    pixels: Any,
    begin: int,
    end: int,
    first: int,
    per_pixel: int,
    points: int,
    sums: Any,
) -> None:
    """Add samples of pixels to their sums.

    Parameters
    ----------
    view, ambient
        As for :func:`tracer.integrators.blinn_phong.trace_radiance`.
    counters
        Flat, COUNTERS.
    seen, mirrored
        What the pixels see, and what in it, if it mirrors (`is_plain`).
    pencil
        The camera's rays (`camera_pencil`).
    pixels, begin, end
        As `place_samples`; which of them.
    first, per_pixel
        First sample of each; how many.
    points
        Address of two rows of scratch.
    sums
        Flat float64, `SUMS` of each pixel.
    """
    stand_alone()
    table = stack_memory(_TABLE)
    n = (end - begin) * per_pixel
    white = Vec3(1.0, 1.0, 1.0)
    base, n_lamps = _add_surface(view, ambient, seen, pencil, white, table, int64(0))
    counters[_PRIMARY_SHARED] += n
    _count(view, counters, seen, n)
    if not seen.plain:
        i = N_MATERIAL * int64(view.face_material[seen.face])
        kr = scale(at(view.materials, i + MATERIAL_KR), 1.0 / view.materials[i + MATERIAL_A])
        shown, n_lamps = _add_surface(view, ambient, mirrored, _mirror(view, pencil, seen.face), kr, table, n_lamps)
        base = add(base, shown)
        counters[_REFLECTION_RAYS] += n
        counters[_REFLECTION_SHARED] += n
        _count(view, counters, mirrored, n)
    for pixel in range(begin, end):
        add_everywhere(base, first, first + per_pixel, sums, SUMS * pixel)
    if n_lamps == 0:
        return
    places, shares = stack_memory(_ROWS), stack_memory(_ROWS)
    together = max(1, PACKET // per_pixel)
    for pixel in range(begin, end, together):
        n_together = min(together, end - pixel)
        for skipped in range(0, per_pixel, PACKET):
            each = min(PACKET, per_pixel - skipped)
            taken = each * n_together
            place_samples(view.settings, pixels, pixel, first + skipped, taken, each, points, places)
            for k in range(n_lamps):
                lamp = table + _LAMP * k
                _light_up(lamp, places, taken, shares)
                for i in range(n_together):
                    if load(_int64, lamp + _KIND) != LIGHT_KIND_DIRECTIONAL:
                        add_shares(_get(lamp + _DIFFUSE), shares + 8 * each * i, each, first, sums, SUMS * (pixel + i))
                    if load(_int64, lamp + _SHINES) != 0:
                        add_shares(
                            _get(lamp + _SPECULAR), shares + ROW + 8 * each * i, each, first, sums, SUMS * (pixel + i)
                        )
