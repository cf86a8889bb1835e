"""The report's reflection model, as far as it is counted ray by ray: attenuation, mirrors and glass.

I = Ia + Id + Is + Ie + Ir + It [farmer2019 eq. 9]: the first four are summed in lanes, by
:mod:`tracer.shading.surfaces` (eq. 10, 13) and :mod:`tracer.shading.direct` (eq. 11, 12, 16). Colours are linear RGB;
n and d are unit, d points to the surface. Scalars in, scalars out, nothing read from a scene.

Departs from the report's program, which uses the interpolated normal as it is in eq. 17: here it is unit.
"""

import math
from typing import Final

from tracer.geometry.vector import dot, multiply, scale
from tracer.jit import inline
from tracer.types import Vec3

LEAST_DENOMINATOR: Final = 1e-200  # of attenuations: 1 / this, times colours and lights, stays finite


@inline
def attenuation(a: float, b: float, c: float, distance: float) -> float:
    """1 / (a + b D + c D^2), the factor of eq. 11, 12, 14 and 15; an infinite D has none but a.

    A light without a distance (directional) and a ray that meets nothing are attenuated by 1 / a. With a = 0 that
    would be infinite: such a material gets nothing from infinitely far away, the limit for D to infinity. Nor is the
    factor of a light at the point itself: 1 / `LEAST_DENOMINATOR` at most.
    """
    denominator = a + distance * (b + c * distance) if distance < math.inf else a
    return 1.0 / max(denominator, LEAST_DENOMINATOR) if denominator > 0.0 else 0.0


@inline
def attenuation_bound(a: float) -> float:
    """Largest value of :func:`attenuation` over all distances: 1 / a."""
    return 1.0 / a if a > 0.0 else math.inf


@inline
def weigh_reflected(kr: Vec3, radiance: Vec3, factor: float) -> Vec3:
    """Ir = kr I_r / (a + b D + c D^2), D the distance that the reflected ray travels [farmer2019 eq. 14]."""
    return scale(multiply(kr, radiance), factor)


@inline
def weigh_transmitted(kt: Vec3, radiance: Vec3, factor: float) -> Vec3:
    """Compute It = kt I_t / (a + b D + c D^2), D the distance that the transmitted ray travels [farmer2019 eq. 15]."""
    return scale(multiply(kt, radiance), factor)


@inline
def reflect_direction(d: Vec3, n: Vec3) -> Vec3:
    """u_r = d - 2 (d . n) n [farmer2019 eq. 17]."""
    k = 2.0 * dot(d, n)
    return Vec3(d.x - k * n.x, d.y - k * n.y, d.z - k * n.z)


@inline
def refract_direction(d: Vec3, n: Vec3, ratio: float) -> tuple[bool, Vec3]:
    """u_t [farmer2019 eq. 18]; False and the mirror direction of eq. 17 under total internal reflection.

    Parameters
    ----------
    d : incident direction, unit
    n : normal on the side that d comes from, unit
    ratio : index of refraction on that side over that on the other
    """
    cosine = -dot(d, n)
    # 1 - ratio^2 (1 - cosine^2), written so that nothing cancels at grazing angles and a ratio of 1 goes straight
    # on exactly.
    along = ratio * cosine
    square = (1.0 - ratio) * (1.0 + ratio) + along * along
    if square < 0.0:
        return False, reflect_direction(d, n)
    k = along - math.sqrt(square)
    return True, Vec3(ratio * d.x + k * n.x, ratio * d.y + k * n.y, ratio * d.z + k * n.z)
