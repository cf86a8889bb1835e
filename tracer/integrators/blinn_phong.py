"""The report's recursive integrator, without recursion and 64 rays at a time: direct light at every hit, then bounces.

Bounces wait on two stacks (mirrored, transmitted) with their throughput, the product of kr or kt and of the
attenuations on the way, and are taken off up to 64 at a time, deepest first: neighbours left the same surface and
travel well together, and the stacks stay small. The order is fixed, so a sample's sum depends on nothing but the wave
it is in.

Semantics where the report leaves a choice:

* A viewer is behind a surface by the geometric normal, turned to the shading normal's side. A two-sided material
  turns its shading normal to such a viewer; refraction enters in front and leaves behind, whatever `two_sided`
  says.
* Total internal reflection sends the kt share along the mirror direction.
* `max_depth` counts bounces after the primary ray; what lies beyond is black. A bounce whose throughput, with the
  largest value of its attenuation, is below `min_throughput` in every channel is black, too.

Source: [farmer2019 eq. 9-18].
"""

from typing import Any, Final

from tracer.accel.traverse import closest_shape, shade_by_shapes
from tracer.geometry.vector import add, at, is_black, multiply, scale
from tracer.integrators.bounces import make_bounces, take_bounces
from tracer.integrators.corners import Seen, nothing_seen
from tracer.integrators.scratch import WAVE, Scratch
from tracer.jit import inline, int64, kernel
from tracer.rays.leaf import CLOSEST, SHADE
from tracer.rays.packet import FROM_POINT, TO_POINT
from tracer.rays.packet_leaf import meet_known
from tracer.rays.placed import trace_scene
from tracer.rays.rows import (
    ALL,
    INTEGERS,
    LANES,
    LIGHT,
    NIBBLE,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    ROW,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    mask_of,
    put,
)
from tracer.shading.direct import add_light, face_light
from tracer.shading.lights import shadow_ray
from tracer.shading.phong import attenuation
from tracer.shading.rows import COLOR, DEPTH, DIRECTION, FROM, SAMPLE, THROUGHPUT, lane_at, put_lane, put_vector, spread
from tracer.shading.surfaces import fill_surfaces
from tracer.simd import count_trailing_zeros, load, mask_to_bits, population_count, splat, store
from tracer.simd.gateway import types
from tracer.types import (
    CAMERA_VIEW_PLANE,
    COUNTERS,
    LIGHT_AMBIENT,
    LIGHT_KIND_DIRECTIONAL,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    N_LIGHT,
    N_MATERIAL,
    SETTING_CAMERA,
    SETTING_SHADOWS,
    SETTING_SKIP,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64

BOUNCES: Final = -1  # instead of the first ray's sample: rays of any samples, and whether they come from the eye
FROM_EYE: Final = -2

_PRIMARY_SHARED: Final = COUNTERS.index("primary_rays_skipped_shared")
_REFLECTION_SHARED: Final = COUNTERS.index("reflection_rays_skipped_shared")
_SHADOW_SHARED: Final = COUNTERS.index("shadow_rays_skipped_shared")
_SHADOW_RAYS: Final = COUNTERS.index("shadow_rays")


@inline
def total_ambient(view: SceneView) -> Vec3:
    """Sum of the global and all lights' ambient intensities, what eq. 10 multiplies by ka."""
    total = at(view.ambient, 0)
    for light in range(view.n_lights):
        total = add(total, at(view.lights, N_LIGHT * light + LIGHT_AMBIENT))
    return total


@kernel
def _meet_shapes(view: SceneView, scratch: Scratch, lanes: int) -> None:
    """Go on from the nearest triangles to the nearest primitives."""
    while lanes != 0:
        ray = scratch.hits + 8 * count_trailing_zeros(lanes)
        lanes &= lanes - 1
        hit = closest_shape(
            view,
            lane_at(ray + ORIGIN),
            lane_at(ray + DIRECTION),
            load(_int64, ray + SKIP),
            load(_float64, ray + T_BEST),
            load(_int64, ray + PRIMITIVE),
            scratch.stack,
        )
        store(ray + T_BEST, hit.t)
        store(ray + PRIMITIVE, hit.primitive)


@kernel
def _shade_by_shapes(view: SceneView, scratch: Scratch, light: int, lanes: int) -> Any:
    """Multiply the light of shadow rays by what shapes and planes let through; returns those left in the dark."""
    dark = _int64(0)
    while lanes != 0:
        lane = count_trailing_zeros(lanes)
        lanes &= lanes - 1
        ray = scratch.shadows + 8 * lane
        o = lane_at(ray + ORIGIN)
        d, t_max = shadow_ray(view.lights, view.light_kind[light], light, o)
        left = shade_by_shapes(view, o, d, t_max, load(_int64, ray + SKIP), lane_at(ray + LIGHT), scratch.stack)
        put_lane(ray + LIGHT, left)
        if is_black(left):
            dark |= _int64(1) << lane
    return dark


@inline
def _find_hits(view: SceneView, scratch: Scratch, seen: Seen, lanes: int, mode: int) -> Any:
    """Trace the rays; returns those that have met something."""
    hits = scratch.hits
    if seen.face >= 0:
        from_eye = mode & FROM_POINT != 0
        meet_known(hits, lanes, seen.place, seen.size, seen.row, seen.word, seen.axis, from_eye)
        scratch.counters[_PRIMARY_SHARED if from_eye else _REFLECTION_SHARED] += population_count(lanes)
        return lanes
    trace_scene(view, scratch.trees, hits, lanes, mode, int64(0), int64(0), int64(0))
    if view.n_shapes + view.n_planes > 0:
        _meet_shapes(view, scratch, lanes)
    met = _int64(0)
    nothing = splat(INTEGERS, _int64(0))
    for i in range(VECTORS):
        if (lanes >> (LANES * i)) & NIBBLE != 0:
            met |= mask_to_bits(load(INTEGERS, hits + PRIMITIVE + STEP * i) >= nothing) << (LANES * i)
    return met & lanes


@inline
def _light_hits(view: SceneView, scratch: Scratch, seen: Seen, lanes: int) -> None:
    """Add the light that comes straight from the lamps, shadow rays traced where it is not known that all arrive."""
    for light in range(view.n_lights):
        if (seen.dark >> light) & 1:
            scratch.counters[_SHADOW_SHARED] += population_count(lanes)
            continue
        known = view.settings[SETTING_SHADOWS] == 0 or (seen.lit >> light) & 1 != 0
        shadows = int64(0) if known else scratch.shadows
        n_solids = int64(0) if known or view.settings[SETTING_SKIP] == 0 else view.n_solids
        lit = face_light(view, light, scratch.hits, shadows, lanes, n_solids, scratch.counters)
        if view.settings[SETTING_SHADOWS] != 0 and known:
            scratch.counters[_SHADOW_SHARED] += population_count(lit)
        elif lit != 0 and not known:
            scratch.counters[_SHADOW_RAYS] += population_count(lit)
            to_point = view.light_kind[light] != LIGHT_KIND_DIRECTIONAL
            lit &= ~trace_scene(
                view,
                scratch.trees,
                scratch.shadows,
                lit,
                int64(SHADE + TO_POINT) if to_point else int64(SHADE),
                scratch.kt,
                scratch.face_material,
                int64(8 * N_MATERIAL),
            )
            if view.n_shapes + view.n_planes > 0:
                lit &= ~_shade_by_shapes(view, scratch, light, lit)
        if lit != 0:
            add_light(view, light, scratch.hits, shadows, lit)


@inline
def _attenuate_throughput(view: SceneView, scratch: Scratch, lanes: int) -> None:
    """Weaken bounces by the way that they went, which is known only now [farmer2019 eq. 14, 15]."""
    none = splat(INTEGERS, _int64(0))
    for k in range(VECTORS):
        bits = (lanes >> (LANES * k)) & NIBBLE
        bits &= mask_to_bits(load(INTEGERS, scratch.hits + FROM + STEP * k) >= none)
        while bits != 0:
            ray = scratch.hits + STEP * k + 8 * count_trailing_zeros(bits)
            bits &= bits - 1
            i = N_MATERIAL * load(_int64, ray + FROM)
            share = attenuation(
                view.materials[i + MATERIAL_A],
                view.materials[i + MATERIAL_B],
                view.materials[i + MATERIAL_C],
                load(_float64, ray + T_BEST),
            )
            put_lane(ray + THROUGHPUT, scale(lane_at(ray + THROUGHPUT), share))


@inline
def _collect(scratch: Scratch, lanes: int, start: int) -> None:
    """Add COLOR, weighted by the throughput, to the rays' samples."""
    if start >= 0:  # camera rays: each has a sample of its own, side by side
        for k in range(VECTORS):
            if (lanes >> (LANES * k)) & NIBBLE != 0:
                mask = mask_of(lanes, k)
                ray = scratch.hits + COLOR + STEP * k
                place = scratch.radiance + 8 * start + STEP * k
                for channel in range(3):
                    put(place + 8 * WAVE * channel, mask, load(VECTOR, ray + channel * ROW))
        return
    while lanes != 0:
        lane = count_trailing_zeros(lanes)
        lanes &= lanes - 1
        ray = scratch.hits + 8 * lane
        weighted = multiply(lane_at(ray + THROUGHPUT), lane_at(ray + COLOR))
        place = scratch.radiance + 8 * load(_int64, ray + SAMPLE)
        store(place, load(_float64, place) + weighted.x)
        store(place + 8 * WAVE, load(_float64, place + 8 * WAVE) + weighted.y)
        store(place + 16 * WAVE, load(_float64, place + 16 * WAVE) + weighted.z)


@kernel
def trace_radiance(view: SceneView, ambient: Vec3, scratch: Scratch, seen: Seen, lanes: int, start: int) -> None:
    """Find the colour I of rays [farmer2019 eq. 9], and add it to their samples; bounces are put on the stacks.

    Parameters
    ----------
    view
        The scene.
    ambient
        :func:`total_ambient` of it.
    scratch
        ``hits`` holds the rays: ORIGIN, DIRECTION (unit), SHEAR, SPEED, AXIS, SKIP, THROUGHPUT, SAMPLE, DEPTH, FROM;
        T_BEST infinite and PRIMITIVE -1.
    seen
        What is known of them.
    lanes
        The rays.
    start
        For camera rays the sample of lane 0: lane i is the first ray of sample ``start + i``; or `FROM_EYE`: they are
        in any order. For bounces `BOUNCES`.
    """
    from_eye = start != BOUNCES and view.settings[SETTING_CAMERA] == CAMERA_VIEW_PLANE
    met = _find_hits(view, scratch, seen, lanes, int64(CLOSEST + FROM_POINT) if from_eye else int64(CLOSEST))
    if start == BOUNCES:
        _attenuate_throughput(view, scratch, lanes)
    missed = lanes & ~met
    if missed != 0:
        background = spread(at(view.background, 0))
        for k in range(VECTORS):
            put_vector(scratch.hits + COLOR + STEP * k, mask_of(missed, k), background)
    behind = _int64(0)
    if met != 0:
        behind = fill_surfaces(view, ambient, scratch.hits, met)
        _light_hits(view, scratch, seen, met)
    _collect(scratch, lanes, start)
    if met != 0:
        make_bounces(view, scratch, met, behind)


@kernel
def trace_bounces(view: SceneView, ambient: Vec3, scratch: Scratch, seen: Seen, kept: int) -> None:
    """Trace bounces that wait, and theirs.

    Parameters
    ----------
    view, ambient, scratch
        As `trace_radiance`.
    seen, kept
        What is known of those of depth 1; as `take_bounces`: all bounces, or what a flat mirror has just sent on.
    """
    while True:
        n = take_bounces(view, scratch, kept)
        if n == 0:
            return
        known = nothing_seen(False)
        if load(_int64, scratch.hits + DEPTH) == 1:
            known = seen
        trace_radiance(
            view, ambient, scratch, known, int64(ALL) if n == PACKET else (int64(1) << n) - 1, int64(BOUNCES)
        )
