"""What the camera rays of a rectangle of pixels see, told by the four rays through the corners of its pixels.

The camera rays of a rectangle of pixels lie between the rays through its corners. Where these four meet one triangle,
and the beam between them holds nothing else up to there and passes within its edges
(:data:`tracer.rays.packet.SOLE`), every ray of the rectangle meets that triangle. What they meet lies within the
quadrilateral of the corners' hits, so the shadow rays to a lamp lie between the corners' shadow rays, and the same
question tells whether all of them arrive or none does.

Why the corners speak for all. Rays from one point (the eye, or back from a lamp) or of one direction that start on a
plane: their lines at any depth are a projective image of the rectangle, so the corners' hull holds all. The distance
to a plane, its sign, the sign of n . l of a flat face, and the dominant axis with its sense are in a convex hull what
they are at its corners; each is asked for with a margin above what rounding can amount to. A spot's cone is convex, its
outside is not.

A flat mirror sends on what comes from the eye as if from one point behind it. So the corners' mirrored rays tell of all
mirrored rays what the corners' rays told of the camera's (`look_in_mirror`). That holds for the plane's own normal; the
rays' directions and origins are off by some units of 2**-52 of the scene's size, a fiftieth of what the beam has room
for.

Invariant: what is said is certain for the rays as they are rounded; else nothing is said (face -1, or a light that is
in no set).
"""

import math
from typing import Any, Final, NamedTuple

from tracer.accel.layout import HEADER_WIDE_LEAVES
from tracer.geometry.vector import add, at, cross, dot, is_black, largest, multiply, negate, scale, subtract
from tracer.integrators.faces import ROOM, ROOM_MIRRORED, SLIM_MIRROR, corners_of, has_sure_plane, slimness
from tracer.integrators.scratch import Scratch
from tracer.jit import inline, int64, kernel
from tracer.rays.camera_lanes import fill_camera_rays
from tracer.rays.leaf import CLOSEST
from tracer.rays.packet import ENDING, NONE, PARALLEL, PENCIL, SOLE, UNLIMITED, trace_packet
from tracer.rays.rows import (
    AXIS,
    INTEGERS,
    LIGHT,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    ROW,
    SHEAR,
    SKIP,
    T_BEST,
    VECTOR,
    WEIGHT_1,
    WEIGHT_2,
    mask_of,
    shear_lanes,
)
from tracer.shading.direct import face_light, offset_origins, see_light
from tracer.shading.phong import attenuation_bound
from tracer.shading.rows import (
    ATTENUATION,
    DIRECTION,
    ERROR,
    GEOMETRIC,
    NORMAL,
    POSITION,
    START,
    THROUGHPUT,
    TO_LIGHT,
    choose,
    put_vector,
    vector_at,
)
from tracer.shading.solids import may_hide, pass_through
from tracer.shading.surfaces import face_normals, fill_surfaces
from tracer.simd import absolute, all_lanes, load, maximum, splat, stand_alone, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_DISTANCE,
    CAMERA_VIEW_PLANE,
    FACE_HAS_COLORS,
    FLAG_TEXTURE,
    LIGHT_DIFFUSE,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_SPECULAR,
    LIMIT_MIN_THROUGHPUT,
    MATERIAL_A,
    MATERIAL_KD,
    MATERIAL_KR,
    MATERIAL_KS,
    MATERIAL_KT,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    N_SOLID,
    SETTING_CAMERA,
    SETTING_HEIGHT,
    SETTING_MAX_DEPTH,
    SETTING_SHADOWS,
    SETTING_SKIP,
    SETTING_WIDTH,
    SOLID_BALL,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64
_INF: Final = math.inf
_MOST_LIGHTS: Final = 62  # sets of lights are int64
PLAIN_LIGHTS: Final = 16  # that a plain wave's shading has room for
_WITHIN: Final = 1.0 - 2.0**-30  # slopes: the dominant axis is certain for all between
_AWAY: Final = 2.0**-30  # of cosines: no rounding changes the sign
_PER_ERROR: Final = 2.0**50  # the largest coordinate of a face, at most, over the error of its hits
_SMALL: Final = 2.0**-24  # error of a hit, of a ball's half axis
_SAME: Final = 2.0**-50  # of a unit normal's components: one plane


class Seen(NamedTuple):
    """What all camera rays of a rectangle of pixels see; sets of lights have bit i for light i."""

    face: int  # -1: nothing is known
    place: int  # address of the face in its leaf
    row: int  # bytes of a row there
    size: int  # bytes of a coordinate there
    word: int  # the face's word there
    axis: int  # AXIS of the rays
    lit: int  # lights of which every shadow ray arrives
    dark: int  # lights of which every shadow ray meets something opaque
    black: int  # lights that add nothing to this face
    away: int  # lights behind it
    divided: bool  # parts of the rectangle may see one face each, or more of what is known of it
    even: bool  # one normal and colour all over, not too grazing, and each light is in a set: `.plain` can shade it
    plain: bool  # the same, and nothing is mirrored or let through


@inline
def nothing_seen(divided: bool) -> Seen:
    """Return what is said where nothing is known."""
    zero = _int64(0)
    return Seen(_int64(-1), zero, zero, zero, zero, zero, zero, zero, zero, zero, divided, False, False)


@inline
def _goes_one_way(packet: int) -> bool:
    """Tell whether four rays, and so all between them, certainly have one dominant axis and sense."""
    axis = load(INTEGERS, packet + AXIS)
    slope = maximum(absolute(load(VECTOR, packet + SHEAR)), absolute(load(VECTOR, packet + SHEAR + ROW)))
    same = all_lanes(axis == splat(INTEGERS, load(_int64, packet + AXIS)))
    return bool(same and all_lanes(slope < splat(VECTOR, _WITHIN)))


@inline
def _some_agree(hits: int) -> bool:
    """Tell whether two neighbours of the four corners have met the same face."""
    p = hits + PRIMITIVE
    a, b, c, d = load(_int64, p), load(_int64, p + 8), load(_int64, p + 16), load(_int64, p + 24)
    agree = ((a == b) | (a == c)) & (a >= 0)
    return bool(agree | (((d == b) | (d == c)) & (d >= 0)))


@inline
def _is_flat(view: SceneView, face: int) -> bool:
    """Tell whether a face has one shading normal."""
    i0, i1, i2 = corners_of(view, face)
    p0 = at(view.vertex_positions, i0)
    smooth, _normal, _facing = face_normals(
        int64(view.face_flags[face]),
        cross(subtract(at(view.vertex_positions, i1), p0), subtract(at(view.vertex_positions, i2), p0)),
        at(view.vertex_normals, i0),
        at(view.vertex_normals, i1),
        at(view.vertex_normals, i2),
    )
    return not smooth


@inline
def _has_one_color(view: SceneView, face: int) -> Any:
    """Tell whether a face has one colour."""
    texture = N_MATERIAL_FLAGS * int64(view.face_material[face]) + FLAG_TEXTURE
    return view.face_flags[face] & FACE_HAS_COLORS == 0 and view.material_flags[texture] < 0


@inline
def _sends_nothing_on(view: SceneView, face: int) -> bool:
    """Tell whether a face mirrors nothing and lets nothing through."""
    i = N_MATERIAL * int64(view.face_material[face])
    return is_black(at(view.materials, i + MATERIAL_KR)) and is_black(at(view.materials, i + MATERIAL_KT))


@inline
def is_mirror(view: SceneView, face: int) -> bool:
    """Tell whether a face mirrors and lets nothing through."""
    i = N_MATERIAL * int64(view.face_material[face])
    return not is_black(at(view.materials, i + MATERIAL_KR)) and is_black(at(view.materials, i + MATERIAL_KT))


@inline
def _faces_away(view: SceneView, scratch: Scratch, light: int) -> bool:
    """Tell whether a light certainly is behind all between the corners' hits."""
    hits = scratch.hits
    to_light, _strength = see_light(
        view, int64(view.light_kind[light]), light, vector_at(hits + POSITION), vector_at(hits + ATTENUATION)
    )
    return bool(all_lanes(dot(vector_at(hits + NORMAL), to_light) < splat(VECTOR, -_AWAY)))


@inline
def _one_side(scratch: Scratch) -> bool:
    """Tell whether the shadow rays of all between the corners' hits leave on one side of the face."""
    cosine = dot(vector_at(scratch.hits + GEOMETRIC), vector_at(scratch.hits + TO_LIGHT))
    margin = splat(VECTOR, _AWAY)
    return bool(all_lanes(cosine > margin) or all_lanes(cosine < -margin))


@inline
def _largest_error(hits: int) -> Any:
    """Bound on the errors of four hits' coordinates."""
    error = vector_at(hits + ERROR)
    return maximum(error.x, maximum(error.y, error.z))


@inline
def _judge_light(view: SceneView, scratch: Scratch, light: int) -> Any:
    """Tell what a light does to all between the corners' hits: 1 lit, -1 dark, 0 not known."""
    corners = _int64(NIBBLE)
    # what it counts is nobody's: into memory that only shapes need
    facing = face_light(view, light, scratch.hits, scratch.shadows, corners, int64(0), scratch.stack)
    if facing != corners or not _one_side(scratch):
        return 0
    if view.settings[SETTING_SHADOWS] == 0:
        return 1
    error = _largest_error(scratch.hits)
    store(scratch.shadows + LIGHT, error * splat(VECTOR, _PER_ERROR))
    for solid in range(view.n_solids):  # what is within is convex, and the four rays are a hull's corners
        if not may_hide(view, solid, light):
            continue
        widest = splat(VECTOR, largest(at(view.solids, N_SOLID * solid + SOLID_BALL)))
        hidden = pass_through(view, solid, light, vector_at(scratch.shadows + ORIGIN))
        if all_lanes(hidden & (error * widest < splat(VECTOR, _SMALL))):
            return -1
    if not _goes_one_way(scratch.shadows):
        return 0
    directional = view.light_kind[light] == LIGHT_KIND_DIRECTIONAL
    mode = int64(SOLE + PARALLEL) if directional else int64(SOLE + ENDING)
    blocker = trace_packet(
        scratch.trees,
        scratch.shadows,
        corners,
        mode,
        scratch.kt,
        scratch.face_material,
        int64(8 * N_MATERIAL),
        int64(UNLIMITED),
    )[0]
    if blocker == NONE:
        return 1
    return -1 if blocker >= 0 else 0


@kernel
def _look(view: SceneView, ambient: Vec3, scratch: Scratch, before: Any, start: Any, room: float) -> Seen:
    """Find out what all rays between four see.

    ORIGIN, DIRECTION (unit), SKIP of ``scratch.hits`` are set; their lines meet ``before`` the origins. ``start`` is
    the largest coordinate of what they start on, ``room`` what `has_sure_plane` asks for.
    """
    stand_alone()
    hits = scratch.hits
    d = vector_at(hits + DIRECTION)
    shear_lanes(hits, 0, d.x, d.y, d.z)
    store(hits + T_BEST, splat(VECTOR, _INF))
    store(hits + PRIMITIVE, splat(INTEGERS, _int64(-1)))
    if not _goes_one_way(hits):
        return nothing_seen(False)
    corners = _int64(NIBBLE)
    trace_packet(scratch.trees, hits, corners, int64(CLOSEST), int64(0), int64(0), int64(0), int64(UNLIMITED))
    face = load(_int64, hits + PRIMITIVE)
    if face < 0 or not all_lanes(load(INTEGERS, hits + PRIMITIVE) == splat(INTEGERS, face)):
        return nothing_seen(_some_agree(hits))
    fill_surfaces(view, ambient, hits, corners)
    # the rays end now at their hits: what is behind these does not count
    store(hits + WEIGHT_2, before)
    store(hits + LIGHT, start)
    sole = trace_packet(
        scratch.trees, hits, corners, int64(SOLE + PENCIL), int64(0), int64(0), int64(0), int64(UNLIMITED)
    )[0]
    if sole != face:
        return nothing_seen(True)
    place, row = load(_int64, hits + WEIGHT_1), load(_int64, hits + WEIGHT_1 + 8)
    word = load(_int64, hits + WEIGHT_1 + 16)
    size = _int64(8 if load(_int64, scratch.trees + 8 * HEADER_WIDE_LEAVES) else 4)
    flat = _is_flat(view, face)
    material = N_MATERIAL * int64(view.face_material[face])
    lit, dark, black, away = _int64(0), _int64(0), _int64(0), _int64(0)
    for light in range(view.n_lights):
        i = N_LIGHT * light
        kd = multiply(at(view.materials, material + MATERIAL_KD), at(view.lights, i + LIGHT_DIFFUSE))
        ks = multiply(at(view.materials, material + MATERIAL_KS), at(view.lights, i + LIGHT_SPECULAR))
        if flat and _faces_away(view, scratch, light):
            away |= _int64(1) << light
        elif is_black(kd) and is_black(ks):
            black |= _int64(1) << light
        else:
            judgement = _judge_light(view, scratch, light)
            if judgement > 0:
                lit |= _int64(1) << light
            elif judgement < 0:
                dark |= _int64(1) << light
    simple = flat and _has_one_color(view, face)
    judged = lit | dark | black | away == (_int64(1) << view.n_lights) - 1
    even = simple and judged and view.n_lights <= PLAIN_LIGHTS and has_sure_plane(view, hits, face, lit, before, room)
    plain = even and _sends_nothing_on(view, face)
    axis = load(_int64, hits + AXIS)
    divided = (simple and not judged and _sends_nothing_on(view, face)) or (flat and is_mirror(view, face))
    return Seen(face, place, row, size, word, axis, lit, dark, black, away, divided, even, plain)


@kernel
def look_at_corners(
    view: SceneView, ambient: Vec3, scratch: Scratch, x0: float, y0: float, x1: float, y1: float
) -> Seen:
    """Find out what all camera rays of a rectangle of pixels see.

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
    if (
        settings[SETTING_SKIP] == 0
        or settings[SETTING_CAMERA] != CAMERA_VIEW_PLANE
        or view.n_shapes + view.n_planes > 0
        or view.n_placements > 1
        or view.n_lights > _MOST_LIGHTS
        or not 1e-100 < view.camera[CAMERA_DISTANCE] < 1e100
    ):
        return nothing_seen(False)
    x, y = hits + THROUGHPUT, hits + THROUGHPUT + ROW  # free so far
    for corner in range(4):
        store(x + 8 * corner, _float64(x0 if corner % 2 == 0 else x1))
        store(y + 8 * corner, _float64(y0 if corner < 2 else y1))
    width, height = settings[SETTING_WIDTH], settings[SETTING_HEIGHT]
    fill_camera_rays(view.camera, settings[SETTING_CAMERA], width, height, int64(4), x, hits + ORIGIN, hits + DIRECTION)
    store(hits + SKIP, splat(INTEGERS, _int64(-1)))
    none = splat(VECTOR, 0.0)
    return _look(view, ambient, scratch, none, none, ROOM)


@kernel
def look_in_mirror(view: SceneView, ambient: Vec3, scratch: Scratch, seen: Seen) -> Seen:
    """Find out what all camera rays of a rectangle see in the flat mirror that they meet.

    Parameters
    ----------
    view, ambient, scratch
        As :func:`look_at_corners` has left them.
    seen
        What it returned.
    """
    stand_alone()
    if seen.face < 0 or view.settings[SETTING_MAX_DEPTH] < 1 or not is_mirror(view, seen.face):
        return nothing_seen(False)
    i = N_MATERIAL * int64(view.face_material[seen.face])
    greatest = largest(at(view.materials, i + MATERIAL_KR)) * attenuation_bound(view.materials[i + MATERIAL_A])
    if greatest < view.limits[LIMIT_MIN_THROUGHPUT]:
        return nothing_seen(False)
    hits = scratch.hits
    d, n, plane = vector_at(hits + DIRECTION), vector_at(hits + NORMAL), vector_at(hits + GEOMETRIC)
    along = dot(d, n)
    n_turned = choose(dot(n, plane) < splat(VECTOR, 0.0), negate(n), n)
    off = maximum(
        maximum(absolute(n_turned.x - plane.x), absolute(n_turned.y - plane.y)), absolute(n_turned.z - plane.z)
    )
    if not (
        _is_flat(view, seen.face) and all_lanes((off < splat(VECTOR, _SAME)) & (absolute(along) > splat(VECTOR, _AWAY)))
    ):
        return nothing_seen(False)
    mirrored = add(d, negate(scale(n, splat(VECTOR, 2.0) * along)))
    origin = offset_origins(hits, mirrored)
    put_vector(hits + ORIGIN, mask_of(_int64(NIBBLE), 0), origin)
    put_vector(hits + DIRECTION, mask_of(_int64(NIBBLE), 0), mirrored)
    store(hits + SKIP, load(INTEGERS, hits + START))
    start = _largest_error(hits) * splat(VECTOR, _PER_ERROR)
    room = ROOM_MIRRORED if slimness(view, seen.face)[0] > SLIM_MIRROR else 0.0
    return _look(view, ambient, scratch, load(VECTOR, hits + T_BEST), start, room)
