"""Lights as a surface point sees them."""

import math
from typing import Any, Final, NamedTuple

from tracer.geometry.rounding import gamma
from tracer.geometry.vector import at, length, scale, subtract
from tracer.jit import inline
from tracer.types import (
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    N_LIGHT,
    Vec3,
)

BEFORE_LIGHT: Final = 1.0 - gamma(64)


class LightSight(NamedTuple):
    """A light from a point."""

    to_light: Vec3  # unit
    distance: float  # world units, infinite for a directional light
    cone: float  # falloff of a spot, 1 for others


@inline
def see_light(lights: Any, kind: int, light: int, p: Vec3) -> LightSight:
    """Direction, distance and cone falloff of a light from a point.

    Spots fall off as glTF KHR_lights_punctual says: clamp(cos(angle) scale + offset, 0, 1)^2.
    """
    i = N_LIGHT * light
    if kind == LIGHT_KIND_DIRECTIONAL:
        d = at(lights, i + LIGHT_DIRECTION)
        return LightSight(Vec3(-d.x, -d.y, -d.z), math.inf, 1.0)
    offset = subtract(at(lights, i + LIGHT_POSITION), p)
    distance = length(offset)
    if not distance > 0.0:  # the point is the light
        return LightSight(Vec3(0.0, 0.0, 0.0), 0.0, 0.0)
    to_light = scale(offset, 1.0 / distance)
    if kind != LIGHT_KIND_SPOT:
        return LightSight(to_light, distance, 1.0)
    d = at(lights, i + LIGHT_DIRECTION)
    cosine = -(to_light.x * d.x + to_light.y * d.y + to_light.z * d.z)
    falloff = min(max(cosine * lights[i + LIGHT_SPOT_SCALE] + lights[i + LIGHT_SPOT_OFFSET], 0.0), 1.0)
    return LightSight(to_light, distance, falloff * falloff)


@inline
def shadow_ray(lights: Any, kind: int, light: int, origin: Vec3) -> tuple[Vec3, float]:
    """Direction and end of the shadow ray from ``origin``.

    A surface that the light itself touches does not shadow it: the ray ends by its hits' rounding (16 eps of the
    depth, and the shear's) before the light.
    """
    if kind == LIGHT_KIND_DIRECTIONAL:
        d = at(lights, N_LIGHT * light + LIGHT_DIRECTION)
        return Vec3(-d.x, -d.y, -d.z), math.inf
    return subtract(at(lights, N_LIGHT * light + LIGHT_POSITION), origin), BEFORE_LIGHT
