"""Light that reaches 64 hits straight from the lamps, a lamp at a time [farmer2019 eq. 11, 12, 16].

Two steps with the shadow rays between them: `face_light` finds who faces a light and how strong it is, and makes their
shadow rays; `add_light` adds what arrives.
"""

import math
from typing import Any, Final

from tracer.geometry.vector import add, at, dot, multiply, negate, scale
from tracer.jit import inline, kernel
from tracer.rays.predicate import shear_of
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    LIGHT,
    LIGHT_REST,
    NIBBLE,
    ORIGIN,
    ROW,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    mask_of,
    shear_lanes,
    spread_shear,
)
from tracer.rays.spawn import offset_origin
from tracer.shading.lights import BEFORE_LIGHT
from tracer.shading.phong import LEAST_DENOMINATOR
from tracer.shading.rows import (
    ATTENUATION,
    COLOR,
    COSINE,
    DIFFUSE,
    DIRECTION,
    ERROR,
    EXPONENT,
    GEOMETRIC,
    NORMAL,
    POSITION,
    SPECULAR,
    START,
    STRENGTH,
    TO_LIGHT,
    put_vector,
    spread,
    vector_at,
)
from tracer.shading.solids import may_hide, pass_through
from tracer.simd import (
    all_lanes,
    any_lane,
    load,
    mask_to_bits,
    maximum,
    minimum,
    population_count,
    power,
    select,
    splat,
    sqrt,
    stand_alone,
    store,
    to_bits,
)
from tracer.simd.gateway import types
from tracer.types import (
    COUNTERS,
    LIGHT_DIFFUSE,
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPECULAR,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    N_LIGHT,
    SceneView,
    Vec3,
)

_int64: Final = types.int64
_SKIPPED_FACING: Final = COUNTERS.index("shadow_rays_skipped_facing")
_SKIPPED_BLACK: Final = COUNTERS.index("shadow_rays_skipped_black")
_SKIPPED_SOLID: Final = COUNTERS.index("shadow_rays_skipped_solid")
_FAINTEST: Final = 40.0 * math.log(2.0)
_MOST_SQUARED: Final = 1024.0  # exponent of highlights that are found by squaring
_INTEGER: Final = 2.0**52  # added to a number, shows its integer in the lowest bits


@inline
def offset_origins(ray: int, direction: Any) -> Any:
    """Origins of rays that leave four hits."""
    return offset_origin(vector_at(ray + POSITION), vector_at(ray + ERROR), vector_at(ray + GEOMETRIC), direction)


@inline
def attenuate(k: Any, distance: Any) -> Any:
    """Attenuation 1 / (a + b D + c D^2) over four finite distances; ``k`` holds a, b, c."""
    one = splat(VECTOR, 1.0)
    if all_lanes((k.x == one) & (k.y == splat(VECTOR, 0.0)) & (k.z == splat(VECTOR, 0.0))):  # mostly: saves a division
        return one
    denominator = k.x + distance * (k.y + distance * k.z)
    zero = splat(VECTOR, 0.0)
    return select(denominator > zero, one / maximum(denominator, splat(VECTOR, LEAST_DENOMINATOR)), zero)


@inline
def see_light(view: SceneView, kind: int, light: int, p: Any, k: Any) -> Any:
    """Return (unit direction to the light, attenuation times cone) of four points and their materials' a, b, c."""
    i = N_LIGHT * light
    zero, one = splat(VECTOR, 0.0), splat(VECTOR, 1.0)
    if kind == LIGHT_KIND_DIRECTIONAL:  # no distance: nothing but a counts
        return spread(negate(at(view.lights, i + LIGHT_DIRECTION))), select(k.x > zero, one / k.x, zero)
    position = spread(at(view.lights, i + LIGHT_POSITION))
    offset = Vec3(position.x - p.x, position.y - p.y, position.z - p.z)
    distance = sqrt(dot(offset, offset))
    away = distance > zero  # else the point is the light
    inverse = select(away, one / distance, zero)
    to_light = scale(offset, inverse)
    strength = select(away, attenuate(k, distance), zero)
    if kind == LIGHT_KIND_SPOT:  # glTF KHR_lights_punctual
        d = spread(at(view.lights, i + LIGHT_DIRECTION))
        cosine = -dot(to_light, d)
        cone = cosine * splat(VECTOR, view.lights[i + LIGHT_SPOT_SCALE])
        cone = minimum(maximum(cone + splat(VECTOR, view.lights[i + LIGHT_SPOT_OFFSET]), zero), one)
        strength = strength * cone * cone
    return to_light, strength


@inline
def raise_cosine(x: Any, exponent: Any) -> Any:
    """x**s of four numbers in [0, 1], s >= 0.

    Integers up to 1024 are raised by squaring, which takes a third of the time of `power`; the result is off by less
    than 2 s units of 2**-53 then.
    """
    shown = exponent + splat(VECTOR, _INTEGER)
    whole = (exponent <= splat(VECTOR, _MOST_SQUARED)) & (shown - splat(VECTOR, _INTEGER) == exponent)
    bits = select(whole, to_bits(shown) & splat(INTEGERS, _int64(2047)), splat(INTEGERS, _int64(0)))
    one, none = splat(INTEGERS, _int64(1)), splat(INTEGERS, _int64(0))
    raised, square = splat(VECTOR, 1.0), x
    while any_lane(bits != none):
        raised = select((bits & one) != none, raised * square, raised)
        square = square * square
        bits = bits >> 1
    if all_lanes(whole):
        return raised
    return select(whole, raised, power(x, exponent))


@inline
def find_highlight(exponent: Any, normal: Any, to_light: Any, viewing: Any) -> Any:
    """(n . h)^s of four points [farmer2019 eq. 12, 16]; parameters as `reflect_light`."""
    zero = splat(VECTOR, 0.0)
    half = add(to_light, negate(viewing))
    squared = dot(half, half)  # 0 when l = -v
    n_dot_h = dot(normal, half)
    n_dot_h = select(squared > zero, n_dot_h / sqrt(squared), zero)
    # x^s <= exp(-s (1 - x)): what is certainly below 2^-40 (1e-12 of the light) counts as nothing
    seen = exponent * (splat(VECTOR, 1.0) - n_dot_h) < splat(VECTOR, _FAINTEST)
    if not any_lane(seen):
        return zero
    return select(seen, raise_cosine(minimum(maximum(n_dot_h, zero), splat(VECTOR, 1.0)), exponent), zero)


@inline
def reflect_light(kd: Any, ks: Any, cosine: Any, exponent: Any, normal: Any, to_light: Any, viewing: Any) -> Any:
    """Share of a light's colour that four points reflect [farmer2019 eq. 11, 12, 16].

    Parameters
    ----------
    kd, ks
        Coefficients times the light's diffuse and specular colours.
    cosine
        n . l.
    exponent
        Of Blinn and Phong.
    normal, to_light, viewing
        Unit: shading normal, l, and the direction of the ray that came (-v).
    """
    zero = splat(VECTOR, 0.0)
    reflected = scale(kd, cosine)
    if any_lane((ks.x > zero) | (ks.y > zero) | (ks.z > zero)):
        reflected = add(reflected, scale(ks, find_highlight(exponent, normal, to_light, viewing)))
    return reflected


@kernel
def face_light(view: SceneView, light: int, packet: int, shadows: int, lanes: int, n_solids: int, counters: Any) -> Any:
    """Find which hits face a light, and make their shadow rays.

    Parameters
    ----------
    view, light
        The scene; row of the light.
    packet
        Address of the hits; TO_LIGHT, COSINE and STRENGTH are written.
    shadows
        Address of a packet for the shadow rays: ORIGIN, SHEAR, SPEED, AXIS, T_BEST, SKIP, LIGHT, LIGHT_REST are
        written. 0: none are wanted, all light arrives.
    lanes
        The hits.
    n_solids
        How many closed meshes shadow rays are held against; 0 where none are wanted.
    counters
        Flat, COUNTERS.

    Returns
    -------
    int64
        The hits that face the light and would reflect some of it, if no closed mesh hides it.
    """
    stand_alone()
    kind = view.light_kind[light]
    i = N_LIGHT * light
    zero, one = splat(VECTOR, 0.0), splat(VECTOR, 1.0)
    diffuse, specular = spread(at(view.lights, i + LIGHT_DIFFUSE)), spread(at(view.lights, i + LIGHT_SPECULAR))
    position = spread(at(view.lights, i + LIGHT_POSITION))
    end = splat(VECTOR, math.inf if kind == LIGHT_KIND_DIRECTIONAL else BEFORE_LIGHT)
    against = negate(at(view.lights, i + LIGHT_DIRECTION))
    shear = shear_of(against.x, against.y, against.z)
    speed = against.z if shear[2] == 2 else (against.y if shear[2] == 1 else against.x)
    hiding = _int64(0)
    for solid in range(n_solids):
        if may_hide(view, solid, light):
            hiding |= _int64(1) << solid
    lit = _int64(0)
    for k in range(VECTORS):
        bits = (lanes >> (LANES * k)) & NIBBLE
        if bits == 0:
            continue
        ray = packet + STEP * k
        to_light, strength = see_light(view, kind, light, vector_at(ray + POSITION), vector_at(ray + ATTENUATION))
        cosine = dot(vector_at(ray + NORMAL), to_light)
        facing = mask_to_bits(cosine > zero) & bits
        counters[_SKIPPED_FACING] += population_count(bits & ~facing)
        if facing == 0:
            continue
        kd, ks = multiply(vector_at(ray + DIFFUSE), diffuse), multiply(vector_at(ray + SPECULAR), specular)
        some = (kd.x > zero) | (kd.y > zero) | (kd.z > zero) | (ks.x > zero) | (ks.y > zero) | (ks.z > zero)
        useful = mask_to_bits(some & (strength > zero)) & facing
        counters[_SKIPPED_BLACK] += population_count(facing & ~useful)
        if useful == 0:
            continue
        wanted = useful
        for solid in range(n_solids):
            if (hiding >> solid) & 1:
                useful &= ~mask_to_bits(pass_through(view, solid, light, offset_origins(ray, to_light)))
        counters[_SKIPPED_SOLID] += population_count(wanted & ~useful)
        if useful == 0:
            continue
        lit |= useful << (LANES * k)
        store(ray + TO_LIGHT, to_light.x)
        store(ray + TO_LIGHT + ROW, to_light.y)
        store(ray + TO_LIGHT + 2 * ROW, to_light.z)
        store(ray + COSINE, cosine)
        store(ray + STRENGTH, strength)
        if shadows == 0:
            continue
        origin = offset_origins(ray, to_light)
        shadow = shadows + STEP * k
        store(shadow + ORIGIN, origin.x)
        store(shadow + ORIGIN + ROW, origin.y)
        store(shadow + ORIGIN + 2 * ROW, origin.z)
        if kind == LIGHT_KIND_DIRECTIONAL:
            spread_shear(shadows, k, shear, speed)
        else:
            shear_lanes(shadows, k, position.x - origin.x, position.y - origin.y, position.z - origin.z)
        store(shadow + T_BEST, end)
        store(shadow + SKIP, load(INTEGERS, ray + START))
        for channel in range(0, 3 * ROW, ROW):
            store(shadow + LIGHT + channel, one)
            store(shadow + LIGHT_REST + channel, zero)
    return lit


@kernel
def add_light(view: SceneView, light: int, packet: int, shadows: int, lanes: int) -> None:
    """Add to COLOR what arrives from a light and is reflected.

    Parameters
    ----------
    view, light, packet, shadows
        As `face_light`; LIGHT of the shadow rays is the share that arrives. ``shadows`` 0: all does.
    lanes
        The hits that get any.
    """
    stand_alone()
    i = N_LIGHT * light
    diffuse, specular = spread(at(view.lights, i + LIGHT_DIFFUSE)), spread(at(view.lights, i + LIGHT_SPECULAR))
    for k in range(VECTORS):
        bits = (lanes >> (LANES * k)) & NIBBLE
        if bits == 0:
            continue
        ray = packet + STEP * k
        strength = load(VECTOR, ray + STRENGTH)
        arriving = Vec3(strength, strength, strength)
        if shadows != 0:
            arriving = scale(vector_at(shadows + LIGHT + STEP * k), strength)
        reflected = reflect_light(
            multiply(vector_at(ray + DIFFUSE), diffuse),
            multiply(vector_at(ray + SPECULAR), specular),
            load(VECTOR, ray + COSINE),
            load(VECTOR, ray + EXPONENT),
            vector_at(ray + NORMAL),
            vector_at(ray + TO_LIGHT),
            vector_at(ray + DIRECTION),
        )
        gained = multiply(reflected, arriving)
        put_vector(ray + COLOR, mask_of(lanes, k), add(vector_at(ray + COLOR), gained))
