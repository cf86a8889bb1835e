"""The ray from a surface point to a light."""

import math
from typing import Any, Final

from tracer.geometry.rounding import gamma
from tracer.geometry.vector import at, subtract
from tracer.jit import inline
from tracer.types import (
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_POSITION,
    N_LIGHT,
    Vec3,
)

BEFORE_LIGHT: Final = 1.0 - gamma(64)


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
