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

import math
from typing import Any, Final

from tracer.accel.traverse import closest_shape, shade_by_shapes
from tracer.geometry.vector import add, at, is_black, largest, multiply, negate, scale
from tracer.integrators.scratch import (
    PENDING_BYTES,
    PENDING_DEPTH,
    PENDING_DIRECTION,
    PENDING_FROM,
    PENDING_SAMPLE,
    PENDING_SKIP,
    PENDING_THROUGHPUT,
    REFLECTED,
    TRANSMITTED,
    WAVE,
    Scratch,
)
from tracer.jit import inline, int64, kernel
from tracer.rays.bundle import trace_bundle
from tracer.rays.packet import CLOSEST, SHADE
from tracer.rays.rows import (
    ALL,
    INTEGERS,
    LANES,
    LIGHT,
    NIBBLE,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    SKIP,
    STEP,
    T_BEST,
    VECTORS,
    set_ray,
)
from tracer.rays.spawn import offset_origin
from tracer.shading.direct import add_light, face_light
from tracer.shading.lights import shadow_ray
from tracer.shading.phong import (
    attenuation,
    attenuation_bound,
    reflect_direction,
    refract_direction,
    weigh_reflected,
    weigh_transmitted,
)
from tracer.shading.rows import (
    COLOR,
    DEPTH,
    DIRECTION,
    ERROR,
    FROM,
    GEOMETRIC,
    MATERIAL,
    NORMAL,
    POSITION,
    SAMPLE,
    START,
    THROUGHPUT,
    lane_at,
    put_lane,
)
from tracer.shading.surfaces import fill_surfaces
from tracer.simd import count_trailing_zeros, load, mask_to_bits, population_count, splat, store
from tracer.simd.gateway import types
from tracer.types import (
    COUNTERS,
    FLAG_TWO_SIDED,
    LIGHT_AMBIENT,
    LIMIT_MIN_THROUGHPUT,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    MATERIAL_ETA,
    MATERIAL_KR,
    MATERIAL_KT,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    SETTING_MAX_DEPTH,
    SETTING_SHADOWS,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int64: Final = types.int64

_SHADOW_RAYS: Final = COUNTERS.index("shadow_rays")
_REFLECTION_RAYS: Final = COUNTERS.index("reflection_rays")
_TRANSMISSION_RAYS: Final = COUNTERS.index("transmission_rays")
_SKIPPED_DEPTH: Final = COUNTERS.index("bounces_skipped_depth")
_SKIPPED_THROUGHPUT: Final = COUNTERS.index("bounces_skipped_throughput")


@inline
def total_ambient(view: SceneView) -> Vec3:
    """Sum of the global and all lights' ambient intensities, what eq. 10 multiplies by ka."""
    total = at(view.ambient, 0)
    for light in range(view.n_lights):
        total = add(total, at(view.lights, N_LIGHT * light + LIGHT_AMBIENT))
    return total


@inline
def _add_radiance(scratch: Scratch, lane: int, color: Vec3) -> None:
    """Add a ray's colour, weighted by its throughput, to its sample."""
    weighted = multiply(lane_at(scratch.hits + THROUGHPUT + 8 * lane), color)
    place = scratch.radiance + 8 * load(_int64, scratch.hits + SAMPLE + 8 * lane)
    store(place, load(_float64, place) + weighted.x)
    store(place + 8 * WAVE, load(_float64, place + 8 * WAVE) + weighted.y)
    store(place + 16 * WAVE, load(_float64, place + 16 * WAVE) + weighted.z)


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
def _find_hits(view: SceneView, scratch: Scratch, lanes: int) -> Any:
    """Trace the rays; returns those that have met something."""
    hits = scratch.hits
    trace_bundle(scratch.tree, hits, lanes, int64(CLOSEST), int64(0), int64(0), int64(0))
    if view.n_shapes + view.n_planes > 0:
        _meet_shapes(view, scratch, lanes)
    met = _int64(0)
    nothing = splat(INTEGERS, _int64(0))
    for i in range(VECTORS):
        if (lanes >> (LANES * i)) & NIBBLE != 0:
            met |= mask_to_bits(load(INTEGERS, hits + PRIMITIVE + STEP * i) >= nothing) << (LANES * i)
    return met & lanes


@inline
def _light_hits(view: SceneView, scratch: Scratch, lanes: int) -> None:
    """Add the light that comes straight from the lamps, shadow rays traced."""
    for light in range(view.n_lights):
        lit = face_light(view, light, scratch.hits, scratch.shadows, lanes, scratch.counters)
        if view.settings[SETTING_SHADOWS] != 0 and lit != 0:
            scratch.counters[_SHADOW_RAYS] += population_count(lit)
            lit &= ~trace_bundle(
                scratch.tree,
                scratch.shadows,
                lit,
                int64(SHADE),
                scratch.kt,
                scratch.face_material,
                int64(8 * N_MATERIAL),
            )
            if view.n_shapes + view.n_planes > 0:
                lit &= ~_shade_by_shapes(view, scratch, light, lit)
        if lit != 0:
            add_light(view, light, scratch.hits, scratch.shadows, lit)


@inline
def _push(
    view: SceneView, scratch: Scratch, which: int, lane: int, d: Vec3, weight: Vec3, depth: int, counter: int
) -> None:
    """Put a bounce on a stack, unless it is too deep or too weak."""
    hit = scratch.hits + 8 * lane
    material = load(_int64, hit + MATERIAL)
    if depth > view.settings[SETTING_MAX_DEPTH]:
        scratch.counters[_SKIPPED_DEPTH] += 1
        return
    bound = attenuation_bound(view.materials[N_MATERIAL * material + MATERIAL_A])
    if largest(weight) * bound < view.limits[LIMIT_MIN_THROUGHPUT]:
        scratch.counters[_SKIPPED_THROUGHPUT] += 1
        return
    scratch.counters[counter] += 1
    o = offset_origin(lane_at(hit + POSITION), lane_at(hit + ERROR), lane_at(hit + GEOMETRIC), d)
    height = load(_int64, scratch.heights + 8 * which)
    place = scratch.pending + which * scratch.pending_step + height * PENDING_BYTES
    store(place, o.x)
    store(place + 8, o.y)
    store(place + 16, o.z)
    store(place + PENDING_DIRECTION, d.x)
    store(place + PENDING_DIRECTION + 8, d.y)
    store(place + PENDING_DIRECTION + 16, d.z)
    store(place + PENDING_THROUGHPUT, weight.x)
    store(place + PENDING_THROUGHPUT + 8, weight.y)
    store(place + PENDING_THROUGHPUT + 16, weight.z)
    store(place + PENDING_SAMPLE, load(_int64, hit + SAMPLE))
    store(place + PENDING_DEPTH, _int64(depth))
    store(place + PENDING_FROM, material)
    store(place + PENDING_SKIP, load(_int64, hit + START))
    store(scratch.heights + 8 * which, height + 1)


@kernel
def _bounce(view: SceneView, scratch: Scratch, lanes: int, behind_lanes: int) -> None:
    """Send on what mirrors and lets through [farmer2019 eq. 14, 15, 17, 18]."""
    while lanes != 0:
        lane = count_trailing_zeros(lanes)
        lanes &= lanes - 1
        hit = scratch.hits + 8 * lane
        material = load(_int64, hit + MATERIAL)
        i = N_MATERIAL * material
        kr = at(view.materials, i + MATERIAL_KR)
        kt = at(view.materials, i + MATERIAL_KT)
        if is_black(kr) and is_black(kt):
            continue
        d = lane_at(hit + DIRECTION)
        n = lane_at(hit + NORMAL)
        throughput = lane_at(hit + THROUGHPUT)
        depth = load(_int64, hit + DEPTH) + 1
        mirrored = kr
        if not is_black(kt):
            behind = (behind_lanes >> lane) & 1 != 0
            turned = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TWO_SIDED] != 0
            facing = negate(n) if behind and not turned else n
            eta = view.materials[i + MATERIAL_ETA]
            through, u_t = refract_direction(d, facing, eta if behind else 1.0 / eta)
            if through:
                weight = weigh_transmitted(kt, throughput, 1.0)
                _push(view, scratch, int64(TRANSMITTED), lane, u_t, weight, depth, int64(_TRANSMISSION_RAYS))
            else:
                mirrored = add(kr, kt)
        if not is_black(mirrored):
            weight = weigh_reflected(mirrored, throughput, 1.0)
            u_r = reflect_direction(d, n)
            _push(view, scratch, int64(REFLECTED), lane, u_r, weight, depth, int64(_REFLECTION_RAYS))


@kernel
def trace_radiance(view: SceneView, ambient: Vec3, scratch: Scratch, lanes: int) -> None:
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
    lanes
        The rays.
    """
    met = _find_hits(view, scratch, lanes)
    # the distance travelled is known only now
    left = lanes
    while left != 0:
        lane = count_trailing_zeros(left)
        left &= left - 1
        ray = scratch.hits + 8 * lane
        material = load(_int64, ray + FROM)
        if material < 0:
            break  # camera rays: all of them
        i = N_MATERIAL * material
        share = attenuation(
            view.materials[i + MATERIAL_A],
            view.materials[i + MATERIAL_B],
            view.materials[i + MATERIAL_C],
            load(_float64, ray + T_BEST),
        )
        put_lane(ray + THROUGHPUT, scale(lane_at(ray + THROUGHPUT), share))
    missed = lanes & ~met
    while missed != 0:
        lane = count_trailing_zeros(missed)
        missed &= missed - 1
        _add_radiance(scratch, lane, at(view.background, 0))
    if met == 0:
        return
    behind = fill_surfaces(view, ambient, scratch.hits, met)
    _light_hits(view, scratch, met)
    left = met
    while left != 0:
        lane = count_trailing_zeros(left)
        left &= left - 1
        _add_radiance(scratch, lane, lane_at(scratch.hits + COLOR + 8 * lane))
    _bounce(view, scratch, met, behind)


@inline
def _top_depth(scratch: Scratch, which: int) -> Any:
    """Depth of a stack's topmost bounce, -1 when it is empty."""
    height = load(_int64, scratch.heights + 8 * which)
    if height == 0:
        return _int64(-1)
    place = scratch.pending + which * scratch.pending_step + height * PENDING_BYTES - PENDING_BYTES
    return load(_int64, place + PENDING_DEPTH)


@inline
def _take_bounces(scratch: Scratch, which: int, depth: int) -> Any:
    """Take up to 64 bounces of a depth off a stack and make them rays; returns how many."""
    height = load(_int64, scratch.heights + 8 * which)
    n = _int64(0)
    while n < PACKET and height > 0:
        place = scratch.pending + which * scratch.pending_step + (height - 1) * PENDING_BYTES
        if load(_int64, place + PENDING_DEPTH) != depth:
            break
        ray = scratch.hits + 8 * n
        dx = load(_float64, place + PENDING_DIRECTION)
        dy = load(_float64, place + PENDING_DIRECTION + 8)
        dz = load(_float64, place + PENDING_DIRECTION + 16)
        put_lane(ray + ORIGIN, Vec3(load(_float64, place), load(_float64, place + 8), load(_float64, place + 16)))
        put_lane(ray + DIRECTION, Vec3(dx, dy, dz))
        set_ray(scratch.hits, n, dx, dy, dz)
        weight = place + PENDING_THROUGHPUT
        put_lane(
            ray + THROUGHPUT, Vec3(load(_float64, weight), load(_float64, weight + 8), load(_float64, weight + 16))
        )
        store(ray + SAMPLE, load(_int64, place + PENDING_SAMPLE))
        store(ray + DEPTH, depth)
        store(ray + FROM, load(_int64, place + PENDING_FROM))
        store(ray + SKIP, load(_int64, place + PENDING_SKIP))
        store(ray + T_BEST, math.inf)
        store(ray + PRIMITIVE, _int64(-1))
        height -= 1
        n += 1
    store(scratch.heights + 8 * which, height)
    return n


@kernel
def trace_bounces(view: SceneView, ambient: Vec3, scratch: Scratch) -> None:
    """Trace all bounces that wait, and theirs; parameters as `trace_radiance`."""
    while True:
        mirrored, transmitted = _top_depth(scratch, int64(REFLECTED)), _top_depth(scratch, int64(TRANSMITTED))
        depth = max(mirrored, transmitted)
        if depth < 0:
            return
        n = _take_bounces(scratch, int64(REFLECTED) if mirrored == depth else int64(TRANSMITTED), depth)
        lanes = int64(ALL) if n == PACKET else (int64(1) << n) - 1
        trace_radiance(view, ambient, scratch, lanes)
