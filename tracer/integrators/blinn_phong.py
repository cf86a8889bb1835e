"""The report's recursive integrator, without recursion: direct light at every hit, mirror and refraction bounces.

Rays wait on a small stack with their throughput, the product of kr or kt and of the attenuations on the way. Depth
first and in a fixed order, so sums do not depend on anything but the scene and the ray.

Semantics where the report leaves a choice:

* A viewer is behind a surface by the geometric normal, turned to the shading normal's side. A two-sided material
  turns its shading normal to such a viewer; refraction enters in front and leaves behind, whatever `two_sided`
  says.
* Total internal reflection sends the kt share along the mirror direction.
* `max_depth` counts bounces after the primary ray; what lies beyond is black. A bounce whose throughput, with the
  largest value of its attenuation, is below `min_throughput` in every channel is black, too.

Source: [farmer2019 eq. 9-18].
"""

from typing import Final

from tracer.accel.traverse import closest_hit, transmit
from tracer.geometry.vector import add, at, dot, is_black, largest, multiply, negate, scale
from tracer.integrators.scratch import PENDING_COLUMNS, PENDING_DEPTH, PENDING_MATERIAL, PENDING_SKIP, Scratch
from tracer.jit import inline, int64
from tracer.rays.spawn import offset_origin
from tracer.shading.lights import see_light, shadow_ray
from tracer.shading.phong import (
    attenuation,
    attenuation_bound,
    emit,
    half_vector,
    reflect_ambient,
    reflect_diffuse,
    reflect_direction,
    reflect_specular,
    refract_direction,
    weigh_reflected,
    weigh_transmitted,
)
from tracer.shading.surface import Surface, make_surface
from tracer.types import (
    COUNTERS,
    FLAG_TWO_SIDED,
    LIGHT_AMBIENT,
    LIGHT_DIFFUSE,
    LIGHT_SPECULAR,
    LIMIT_MIN_THROUGHPUT,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    MATERIAL_ETA,
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
    SETTING_MAX_DEPTH,
    SETTING_SHADOWS,
    SceneView,
    Vec3,
)

_SHADOW_RAYS: Final = COUNTERS.index("shadow_rays")
_REFLECTION_RAYS: Final = COUNTERS.index("reflection_rays")
_TRANSMISSION_RAYS: Final = COUNTERS.index("transmission_rays")
_SKIPPED_FACING: Final = COUNTERS.index("shadow_rays_skipped_facing")
_SKIPPED_BLACK: Final = COUNTERS.index("shadow_rays_skipped_black")
_CACHE_HITS: Final = COUNTERS.index("occluder_cache_hits")
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
def _attenuate(view: SceneView, material: int, distance: float) -> float:
    """Attenuation of a material over a distance."""
    i = N_MATERIAL * material
    return attenuation(
        view.materials[i + MATERIAL_A], view.materials[i + MATERIAL_B], view.materials[i + MATERIAL_C], distance
    )


@inline
def _light_surface(view: SceneView, surface: Surface, n: Vec3, v: Vec3, scratch: Scratch) -> Vec3:
    """Sum of Id and Is over the lights [farmer2019 eq. 11, 12], shadow rays traced."""
    i = N_MATERIAL * surface.material
    kd = multiply(at(view.materials, i + MATERIAL_KD), surface.tint)
    ks = at(view.materials, i + MATERIAL_KS)
    total = Vec3(0.0, 0.0, 0.0)
    for light in range(view.n_lights):
        kind = view.light_kind[light]
        sight = see_light(view.lights, kind, light, surface.position)
        n_dot_l = dot(n, sight.to_light)
        if not n_dot_l > 0.0:
            scratch.counters[_SKIPPED_FACING] += 1
            continue
        diffuse = multiply(kd, at(view.lights, N_LIGHT * light + LIGHT_DIFFUSE))
        specular = multiply(ks, at(view.lights, N_LIGHT * light + LIGHT_SPECULAR))
        strength = sight.cone * _attenuate(view, surface.material, sight.distance)
        if not strength > 0.0 or (is_black(diffuse) and is_black(specular)):
            scratch.counters[_SKIPPED_BLACK] += 1
            continue
        arriving = Vec3(strength, strength, strength)
        if view.settings[SETTING_SHADOWS] != 0:
            scratch.counters[_SHADOW_RAYS] += 1
            origin = offset_origin(surface.position, surface.error, surface.geometric, sight.to_light)
            direction, t_max = shadow_ray(view.lights, kind, light, origin)
            shadow = transmit(
                view, origin, direction, t_max, surface.skip, int64(scratch.occluders[light]), scratch.stack
            )
            scratch.occluders[light] = shadow.occluder
            if shadow.from_cache:
                scratch.counters[_CACHE_HITS] += 1
            arriving = Vec3(strength * shadow.red, strength * shadow.green, strength * shadow.blue)
            if is_black(arriving):
                continue
        total = add(
            total, multiply(reflect_diffuse(kd, at(view.lights, N_LIGHT * light + LIGHT_DIFFUSE), n_dot_l), arriving)
        )
        if not is_black(specular):
            n_dot_h = dot(n, half_vector(sight.to_light, v))
            highlight = reflect_specular(
                ks, at(view.lights, N_LIGHT * light + LIGHT_SPECULAR), n_dot_h, view.materials[i + MATERIAL_EXPONENT]
            )
            total = add(total, multiply(highlight, arriving))
    return total


@inline
def _push(
    view: SceneView, scratch: Scratch, top: int, surface: Surface, d: Vec3, throughput: Vec3, depth: int, counter: int
) -> int:
    """Put a bounce on the stack, unless it is too deep or too weak; return the new height."""
    if depth > view.settings[SETTING_MAX_DEPTH]:
        scratch.counters[_SKIPPED_DEPTH] += 1
        return top
    bound = attenuation_bound(view.materials[N_MATERIAL * surface.material + MATERIAL_A])
    if largest(throughput) * bound < view.limits[LIMIT_MIN_THROUGHPUT]:
        scratch.counters[_SKIPPED_THROUGHPUT] += 1
        return top
    scratch.counters[counter] += 1
    o = offset_origin(surface.position, surface.error, surface.geometric, d)
    i = PENDING_COLUMNS * top
    scratch.pending[i] = o.x
    scratch.pending[i + 1] = o.y
    scratch.pending[i + 2] = o.z
    scratch.pending[i + 3] = d.x
    scratch.pending[i + 4] = d.y
    scratch.pending[i + 5] = d.z
    scratch.pending[i + 6] = throughput.x
    scratch.pending[i + 7] = throughput.y
    scratch.pending[i + 8] = throughput.z
    scratch.pending[i + PENDING_DEPTH] = depth
    scratch.pending[i + PENDING_MATERIAL] = surface.material
    scratch.pending[i + PENDING_SKIP] = surface.skip
    return top + 1


@inline
def trace_radiance(view: SceneView, ambient: Vec3, origin: Vec3, direction: Vec3, scratch: Scratch) -> Vec3:
    """Find the colour I of a ray [farmer2019 eq. 9].

    Parameters
    ----------
    view
        The scene.
    ambient
        :func:`total_ambient` of it.
    origin, direction : Vec3
        World ray, direction unit.
    scratch
        Used and overwritten; counters are added to.

    Returns
    -------
    Vec3
        Linear RGB, not clamped.
    """
    total = Vec3(0.0, 0.0, 0.0)
    o = origin
    d = direction
    throughput = Vec3(1.0, 1.0, 1.0)
    depth = int64(0)
    skip = int64(-1)  # not literals: numba would compile a copy of what they are handed to
    from_material = int64(-1)
    top = int64(0)
    while True:
        hit = closest_hit(view, o, d, skip, scratch.stack, scratch.stack_t)
        if from_material >= 0:  # the distance travelled is known only now
            throughput = scale(throughput, _attenuate(view, from_material, hit.t))
        if hit.primitive < 0:
            total = add(total, multiply(throughput, at(view.background, 0)))
        else:
            surface = make_surface(view, hit, o, d)
            behind = dot(surface.geometric, d) > 0.0
            two_sided = view.material_flags[N_MATERIAL_FLAGS * surface.material + FLAG_TWO_SIDED] != 0
            n = negate(surface.shading) if behind and two_sided else surface.shading
            i = N_MATERIAL * surface.material
            ka = multiply(at(view.materials, i + MATERIAL_KA), surface.tint)
            local = add(reflect_ambient(ka, ambient), emit(at(view.materials, i + MATERIAL_KE)))
            local = add(local, _light_surface(view, surface, n, negate(d), scratch))
            total = add(total, multiply(throughput, local))
            # eq. 14 and 15: what comes back is weighted by kr or kt now and attenuated when the distance is known.
            kr = at(view.materials, i + MATERIAL_KR)
            kt = at(view.materials, i + MATERIAL_KT)
            mirrored = kr
            if not is_black(kt):
                eta = view.materials[i + MATERIAL_ETA]
                facing = negate(surface.shading) if behind else surface.shading
                through, u_t = refract_direction(d, facing, eta if behind else 1.0 / eta)
                if through:
                    weight = weigh_transmitted(kt, throughput, 1.0)
                    top = _push(view, scratch, top, surface, u_t, weight, depth + 1, int64(_TRANSMISSION_RAYS))
                else:
                    mirrored = add(kr, kt)
            if not is_black(mirrored):
                weight = weigh_reflected(mirrored, throughput, 1.0)
                u_r = reflect_direction(d, n)
                top = _push(view, scratch, top, surface, u_r, weight, depth + 1, int64(_REFLECTION_RAYS))
        if top == 0:
            return total
        top -= 1
        i = PENDING_COLUMNS * top
        o = at(scratch.pending, i)
        d = at(scratch.pending, i + 3)
        throughput = at(scratch.pending, i + 6)
        depth = int64(scratch.pending[i + PENDING_DEPTH])
        from_material = int64(scratch.pending[i + PENDING_MATERIAL])
        skip = int64(scratch.pending[i + PENDING_SKIP])
