"""The report's reflection model, one function an equation.

I = Ia + Id + Is + Ie + Ir + It [farmer2019 eq. 9]. Colours are linear RGB; directions point away from the surface
except the incident ray's d; n, l, v, h, d are unit. Scalars in, scalars out, nothing read from a scene.

Departs from the report's program, which uses the interpolated normal as it is in eq. 17: here it is unit.
"""

import math

from tracer.geometry.vector import add, dot, multiply, normalize, scale
from tracer.jit import inline
from tracer.types import Vec3


@inline
def sum_intensity(
    ambient: Vec3, diffuse: Vec3, specular: Vec3, emitted: Vec3, reflected: Vec3, transmitted: Vec3
) -> Vec3:
    """I = Ia + Id + Is + Ie + Ir + It [farmer2019 eq. 9]."""
    return add(add(add(ambient, diffuse), add(specular, emitted)), add(reflected, transmitted))


@inline
def attenuation(a: float, b: float, c: float, distance: float) -> float:
    """1 / (a + b D + c D^2), the factor of eq. 11, 12, 14 and 15; an infinite D has none but a.

    A light without a distance (directional) and a ray that meets nothing are attenuated by 1 / a. With a = 0 that
    would be infinite: such a material gets nothing from infinitely far away, the limit for D to infinity.
    """
    denominator = a + distance * (b + c * distance) if distance < math.inf else a
    return 1.0 / denominator if denominator > 0.0 else 0.0


@inline
def attenuation_bound(a: float) -> float:
    """Largest value of :func:`attenuation` over all distances: 1 / a."""
    return 1.0 / a if a > 0.0 else math.inf


@inline
def reflect_ambient(ka: Vec3, ambient: Vec3) -> Vec3:
    """Ia = ka (sum of the global and all lights' ambient intensities) [farmer2019 eq. 10].

    Neither attenuated nor shadowed.
    """
    return multiply(ka, ambient)


@inline
def reflect_diffuse(kd: Vec3, intensity: Vec3, n_dot_l: float) -> Vec3:
    """Id = kd L (n . l) for one light with n . l > 0, L the attenuated intensity that arrives [farmer2019 eq. 11]."""
    return scale(multiply(kd, intensity), n_dot_l)


@inline
def reflect_specular(ks: Vec3, intensity: Vec3, n_dot_h: float, exponent: float) -> Vec3:
    """Is = ks L max(0, n . h)^exponent for one light with n . l > 0 [farmer2019 eq. 12]."""
    return scale(multiply(ks, intensity), max(0.0, n_dot_h) ** exponent)


@inline
def emit(ke: Vec3) -> Vec3:
    """Ie = ke [farmer2019 eq. 13]."""
    return ke


@inline
def weigh_reflected(kr: Vec3, radiance: Vec3, factor: float) -> Vec3:
    """Ir = kr I_r / (a + b D + c D^2), D the distance that the reflected ray travels [farmer2019 eq. 14]."""
    return scale(multiply(kr, radiance), factor)


@inline
def weigh_transmitted(kt: Vec3, radiance: Vec3, factor: float) -> Vec3:
    """Compute It = kt I_t / (a + b D + c D^2), D the distance that the transmitted ray travels [farmer2019 eq. 15]."""
    return scale(multiply(kt, radiance), factor)


@inline
def half_vector(to_light: Vec3, to_viewer: Vec3) -> Vec3:
    """Return h = (l + v) / |l + v| [farmer2019 eq. 16]; zero when l = -v."""
    return normalize(add(to_light, to_viewer))


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
