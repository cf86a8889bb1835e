"""The slow and obvious oracle of the whole renderer.

Job: the report's equations, one after another, in numpy over arrays of rays and by brute force over primitives, so that
kernels can be compared with it ray by ray and image by image. Invariant: nothing of ``tracer`` is imported, no
acceleration, no shared formula: if the two agree, they agree for a reason. Source: Farmer 2019, equations 1 to 18
(``[farmer2019 eq. N]``), and the original program's habits as ``seed/README.md`` in the data folder has them.

Vectors are arrays of shape ``(3, n)``, one column per ray; rays are ``origin + t direction`` with a direction of any
length, and ``t`` counts in lengths of the direction. Colours are linear, unclamped ``(3, n)``.

Two habits of the original can be switched on with ``Scene(original=True)``: the interpolated normal enters the reflection formula
(eq. 17) as it is, not unit; and t_min is the given scene's. Everything else is the same code for the original and for us.
"""

import dataclasses
import math

import numpy as np

# Rays are traced in groups of this size only to bound memory and stay in cache: 32,768 doubles are 256 KiB.
CHUNK = 32768


# ---------------------------------------------------------------------------------------------------------------------
# small vector algebra


def vec(v):
    """Return a (3, 1) column that broadcasts against (3, n)."""
    return np.asarray(v, dtype=float).reshape(3, 1)


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(a):
    return np.sqrt(dot(a, a))


def unit(a):
    return a / length(a)


# ---------------------------------------------------------------------------------------------------------------------
# triangles: equations 3 to 8


def cramer(a, b, c, origin, direction, t_min=0.0, t_max=math.inf):
    """Scalar ray against triangle by Cramer's rule with early termination [farmer2019 eq. 3-8].

    Returns (t, beta, gamma), or None as soon as one of the three leaves its interval.
    """
    # eq. 4: the columns of the matrix are a - b, a - c and the ray's direction; the right side is a - origin
    a_, b_, c_ = (a[k] - b[k] for k in range(3))
    d_, e_, f_ = (a[k] - c[k] for k in range(3))
    g_, h_, i_ = direction
    j_, k_, l_ = (a[k] - origin[k] for k in range(3))
    ei_hf, gf_di, dh_eg = e_ * i_ - h_ * f_, g_ * f_ - d_ * i_, d_ * h_ - e_ * g_
    m = a_ * ei_hf + b_ * gf_di + c_ * dh_eg  # eq. 8
    if m == 0.0:
        return None
    ak_jb, jc_al, bl_kc = a_ * k_ - j_ * b_, j_ * c_ - a_ * l_, b_ * l_ - k_ * c_
    t = -(f_ * ak_jb + e_ * jc_al + d_ * bl_kc) / m  # eq. 7
    if t < t_min or t > t_max:
        return None
    gamma = (i_ * ak_jb + h_ * jc_al + g_ * bl_kc) / m  # eq. 6
    if gamma < 0.0 or gamma > 1.0:
        return None
    beta = (j_ * ei_hf + k_ * gf_di + l_ * dh_eg) / m  # eq. 5
    if beta < 0.0 or beta + gamma > 1.0:
        return None
    return t, beta, gamma


def solve(a, b, c, o, d, t_min, t_max):
    """Same as cramer(), for arrays: masks stand for the early returns.

    Each of the five has three members, x, y and z, that broadcast: numbers and arrays of rays, or columns of triangles against them.
    """
    a_, b_, c_ = (a[k] - b[k] for k in range(3))
    d_, e_, f_ = (a[k] - c[k] for k in range(3))
    g_, h_, i_ = d
    j_, k_, l_ = (a[k] - o[k] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ei_hf, gf_di, dh_eg = e_ * i_ - h_ * f_, g_ * f_ - d_ * i_, d_ * h_ - e_ * g_
        m = a_ * ei_hf + b_ * gf_di + c_ * dh_eg  # eq. 8
        ak_jb, jc_al, bl_kc = a_ * k_ - j_ * b_, j_ * c_ - a_ * l_, b_ * l_ - k_ * c_
        t = -(f_ * ak_jb + e_ * jc_al + d_ * bl_kc) / m  # eq. 7
        gamma = (i_ * ak_jb + h_ * jc_al + g_ * bl_kc) / m  # eq. 6
        beta = (j_ * ei_hf + k_ * gf_di + l_ * dh_eg) / m  # eq. 5
        inside = (m != 0.0) & (t >= t_min) & (t <= t_max) & (gamma >= 0.0) & (beta >= 0.0) & (beta + gamma <= 1.0)
    return inside, t, beta, gamma


# ---------------------------------------------------------------------------------------------------------------------
# primitives: each has hit(o, d, t_min, t_max) -> (mask, t, part, u, v), where a mesh tells in part which triangle it is,
# and surface(o, d, t, part, u, v) -> the facts that shading needs


@dataclasses.dataclass
class Surface:
    """What is known of the hit points of n rays, (3, n) each but uv, which is (2, n)."""

    point: np.ndarray
    normal: np.ndarray  # shading normal as interpolated: of any length
    geometric: np.ndarray  # perpendicular to the surface, of any length and sign
    uv: np.ndarray
    color: np.ndarray  # vertex colour, 1 where there is none


@dataclasses.dataclass
class Triangle:
    """One triangle, in world space; ``normals``, ``uvs``, ``colors`` are those of the three vertices."""

    a: list
    b: list
    c: list
    material: "Material"
    normals: list | None = None
    uvs: list | None = None
    colors: list | None = None

    def hit(self, o, d, t_min, t_max):
        inside, t, beta, gamma = solve(self.a, self.b, self.c, o, d, t_min, t_max)
        return inside, t, np.zeros(t.shape, dtype=int), beta, gamma

    def crossings(self, o, d, t_min, t_max):
        """Return how often each ray goes through the surface between t_min and t_max."""
        return self.hit(o, d, t_min, t_max)[0].astype(int)

    def surface(self, o, d, t, _part, beta, gamma):
        def interpolate(v):
            v = np.asarray(v, dtype=float)
            return (1.0 - beta - gamma) * v[0][:, None] + beta * v[1][:, None] + gamma * v[2][:, None]

        n = t.size
        geometric = np.cross(np.subtract(self.b, self.a), np.subtract(self.c, self.a))
        geometric = np.repeat(vec(geometric), n, axis=1)
        return Surface(
            point=interpolate([self.a, self.b, self.c]),
            normal=interpolate(self.normals) if self.normals is not None else geometric,
            geometric=geometric,
            uv=interpolate(self.uvs) if self.uvs is not None else np.zeros((2, n)),
            color=interpolate(self.colors) if self.colors is not None else np.ones((3, n)),
        )


# ---------------------------------------------------------------------------------------------------------------------
# materials, lights, scene


@dataclasses.dataclass
class Material:
    """The coefficients of eq. 9 and what they are multiplied by."""

    ka: list = dataclasses.field(default_factory=lambda: [0.8] * 3)
    kd: list = dataclasses.field(default_factory=lambda: [0.8] * 3)
    ks: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    exponent: float = 100.0
    ke: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    kr: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    kt: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    eta: float = 1.0
    attenuation: tuple = (1.0, 0.0, 0.0)
    texture: "Texture | None" = None
    two_sided: bool = True

    def attenuate(self, distance):
        """1 / (a + b D + c D^2); what comes from infinitely far away has no distance: 1/a, and with a = 0 nothing."""
        a, b, c = self.attenuation
        with np.errstate(divide="ignore", invalid="ignore"):
            near = 1.0 / (a + b * distance + c * distance * distance)
        return np.where(np.isinf(distance), 1.0 / a if a > 0.0 else 0.0, near)


@dataclasses.dataclass
class Texture:
    """An image as 8-bit levels (height, width, 3), row 0 on top; v grows upwards."""

    levels: np.ndarray
    repeat: bool = True
    srgb: bool = True
    bilinear: bool = True

    def texel(self, column, row):
        height, width, _ = self.levels.shape
        if self.repeat:
            column, row = column % width, row % height
        else:
            column, row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
        value = self.levels[row, column].T / 255.0
        if self.srgb:  # IEC 61966-2-1
            value = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        return value

    def lookup(self, uv):
        height, width, _ = self.levels.shape
        x, y = uv[0] * width, (1.0 - uv[1]) * height
        if not self.bilinear:
            return self.texel(np.floor(x).astype(int), np.floor(y).astype(int))
        x, y = x - 0.5, y - 0.5  # texel centres are at half numbers
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - column, y - row
        top = (1.0 - fx) * self.texel(column, row) + fx * self.texel(column + 1, row)
        bottom = (1.0 - fx) * self.texel(column, row + 1) + fx * self.texel(column + 1, row + 1)
        return (1.0 - fy) * top + fy * bottom


@dataclasses.dataclass
class Light:
    kind: str  # "directional", "point", "spot"
    position: list | None = None
    direction: list | None = None  # the way the light travels
    ambient: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    diffuse: list = dataclasses.field(default_factory=lambda: [1.0] * 3)
    specular: list = dataclasses.field(default_factory=lambda: [1.0] * 3)
    inner_angle_deg: float = 20.0
    outer_angle_deg: float = 30.0

    def towards(self, p):
        """Return the (not unit) vectors from points to the light, the largest t of a shadow ray, and the distance."""
        if self.kind == "directional":
            n = p.shape[1]
            return np.repeat(-vec(self.direction), n, axis=1), math.inf, np.full(n, math.inf)
        to_light = vec(self.position) - p
        return to_light, 1.0, length(to_light)

    def cone(self, to_light):
        """Return the falloff of a spot light (glTF KHR_lights_punctual), 1 for the others."""
        if self.kind != "spot":
            return np.ones(to_light.shape[1])
        cosine = dot(-unit(to_light), unit(vec(self.direction)))
        inner = math.cos(math.radians(self.inner_angle_deg))
        outer = math.cos(math.radians(self.outer_angle_deg))
        return np.clip((cosine - outer) / max(0.001, inner - outer), 0.0, 1.0) ** 2


@dataclasses.dataclass
class Camera:
    """Eye, basis (u right, v up, w backwards) and view plane of eq. 1; ``distance`` None means orthographic."""

    eye: np.ndarray
    u: np.ndarray
    v: np.ndarray
    w: np.ndarray
    left: float
    right: float
    bottom: float
    top: float
    distance: float | None

    def rays(self, x, y, width, height):
        """Return rays through picture positions x from the left and y from the BOTTOM, in pixels [farmer2019 eq. 1, 2]."""
        pu = self.left + (self.right - self.left) * x / width
        pv = self.bottom + (self.top - self.bottom) * y / height
        if self.distance is None:
            origin = vec(self.eye) + pu * vec(self.u) + pv * vec(self.v)
            return origin, np.repeat(-vec(self.w), x.size, axis=1)
        direction = -self.distance * vec(self.w) + pu * vec(self.u) + pv * vec(self.v)
        return np.repeat(vec(self.eye), x.size, axis=1), direction


@dataclasses.dataclass
class Scene:
    camera: Camera
    width: int
    height: int
    primitives: list
    lights: list
    ambient: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    background: list = dataclasses.field(default_factory=lambda: [0.0] * 3)
    shadows: bool = True
    max_depth: int = 3
    samples: int = 16
    t_min: float = 1e-8
    original: bool = False  # eq. 17 with the interpolated normal as it is


# ---------------------------------------------------------------------------------------------------------------------
# equation 9


def closest_hit(scene, o, d):
    """Brute force: index of the nearest primitive (-1: none; the first one wins a tie), t, its part and the two coordinates."""
    n = d.shape[1]
    index, t_hit, part_hit = np.full(n, -1), np.full(n, np.inf), np.zeros(n, int)
    u_hit, v_hit = np.zeros(n), np.zeros(n)
    for k, primitive in enumerate(scene.primitives):
        hit, t, part, u, v = primitive.hit(o, d, scene.t_min, np.inf)
        nearer = hit & (t < t_hit)
        index[nearer], t_hit[nearer] = k, t[nearer]
        part_hit[nearer], u_hit[nearer], v_hit[nearer] = part[nearer], u[nearer], v[nearer]
    return index, t_hit, part_hit, u_hit, v_hit


def transmittance(scene, o, d, t_max):
    """How much light comes through between here and the light: each surface crossed multiplies by its kt."""
    light = np.ones((3, d.shape[1]))
    if not scene.shadows:
        return light
    for primitive in scene.primitives:
        (lit,) = np.nonzero(light.any(axis=0))  # what is black stays black
        crossings = primitive.crossings(o[:, lit], d[:, lit], scene.t_min, t_max)
        light[:, lit] *= np.power(vec(primitive.material.kt), crossings)
    return light


def radiance(scene, o, d, depth=0):
    """Return the colours I of n rays [farmer2019 eq. 9] and the distances that they travelled (infinite: background)."""
    n = d.shape[1]
    color = np.repeat(vec(scene.background), n, axis=1)
    distance = np.full(n, np.inf)
    index, t, part, u, v = closest_hit(scene, o, d)
    for k, primitive in enumerate(scene.primitives):
        (rays,) = np.nonzero(index == k)
        if rays.size:
            at = primitive.surface(o[:, rays], d[:, rays], t[rays], part[rays], u[rays], v[rays])
            distance[rays] = t[rays] * length(d[:, rays])
            color[:, rays] = shade(scene, primitive.material, at, d[:, rays], depth)
    return color, distance


def shade(scene, material, at, d, depth):
    """I = Ia + Id + Is + Ie + Ir + It [farmer2019 eq. 9] at the hit points of n rays with directions d."""
    view = -unit(d)
    # The viewer is behind the surface by the geometric normal, which is turned to the shading normal's side.
    geometric = np.where(dot(at.geometric, at.normal) < 0.0, -at.geometric, at.geometric)
    behind = dot(geometric, view) < 0.0
    raw = np.where(behind & material.two_sided, -at.normal, at.normal)
    normal = unit(raw)

    tint = at.color * (1.0 if material.texture is None else material.texture.lookup(at.uv))
    ka, kd, ks = vec(material.ka) * tint, vec(material.kd) * tint, vec(material.ks)

    color = np.repeat(vec(material.ke), d.shape[1], axis=1)  # eq. 13
    color = color + ka * vec(scene.ambient)  # eq. 10
    for light in scene.lights:
        color = color + ka * vec(light.ambient)  # eq. 10
        to_light, t_max, light_distance = light.towards(at.point)
        n_dot_l = dot(normal, unit(to_light))
        (lit,) = np.nonzero(n_dot_l > 0.0)
        strength = np.zeros_like(color)
        strength[:, lit] = transmittance(scene, at.point[:, lit], to_light[:, lit], t_max)
        strength = strength * material.attenuate(light_distance) * light.cone(to_light)
        to_light = unit(to_light)
        half_way = unit(to_light + view)  # eq. 16
        highlight = np.maximum(0.0, dot(normal, half_way)) ** material.exponent
        reflected = kd * vec(light.diffuse) * n_dot_l  # eq. 11
        reflected = reflected + ks * vec(light.specular) * highlight  # eq. 12
        color = color + strength * reflected

    if depth < scene.max_depth:
        if any(material.kr):  # eq. 14
            n17 = raw if scene.original else normal
            child, child_distance = radiance(scene, at.point, reflect(d, n17), depth + 1)
            color = color + vec(material.kr) * material.attenuate(child_distance) * child
        if any(material.kt):  # eq. 15
            facing = unit(np.where(behind, -at.normal, at.normal))
            ratio = np.where(behind, material.eta, 1.0 / material.eta)
            child, child_distance = radiance(scene, at.point, refract(unit(d), facing, ratio), depth + 1)
            color = color + vec(material.kt) * material.attenuate(child_distance) * child
    return color


def reflect(d, n):
    """u_r = d - 2 (d . n) n [farmer2019 eq. 17]."""
    return d - 2.0 * dot(d, n) * n


def refract(d, n, ratio):
    """u_t [farmer2019 eq. 18] for unit d and n, n on the side that d comes from; ratio is eta outside over inside seen from d.

    Where Snell's law has no solution all light is reflected: total internal reflection.
    """
    cosine = -dot(d, n)
    square = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    through = ratio * d + (ratio * cosine - np.sqrt(np.maximum(square, 0.0))) * n
    return np.where(square < 0.0, reflect(d, n), through)


# ---------------------------------------------------------------------------------------------------------------------
# pictures


def trace(scene, x, y):
    """Return linear colours (n, 3) at picture positions x from the left and y from the bottom, in pixels."""
    x, y = np.ravel(x).astype(float), np.ravel(y).astype(float)
    result = np.empty((x.size, 3))
    for first in range(0, x.size, CHUNK):
        part = slice(first, first + CHUNK)
        o, d = scene.camera.rays(x[part], y[part], scene.width, scene.height)
        result[part] = radiance(scene, o, d)[0].T
    return result
