"""The oracle itself, against closed forms. ``test_naive_references.py`` holds it against the original program's pictures."""

import math

import numpy as np
import pytest

from tests import naive
from tests.naive_scenes import read_document, read_transform
from tests.naive_shapes import Box, Cylinder, Disk, Plane, Sphere


def test_arrays_and_scalars_agree_on_triangles():
    generator = np.random.default_rng(1)
    for _ in range(50):
        a, b, c = generator.normal(size=(3, 3)).tolist()
        # aim half of the rays at the triangle itself
        weights = generator.dirichlet([1, 1, 1], size=20)
        o = generator.normal(size=(40, 3)) * 3
        d = np.concatenate([weights @ np.array([a, b, c]), generator.normal(size=(20, 3))]) - o
        hit, t, _, beta, gamma = naive.Triangle(a, b, c, None).hit(o.T, d.T, 0.0, np.inf)
        assert hit[:20].all()
        for k in range(40):
            expected = naive.cramer(a, b, c, o[k], d[k])
            assert (expected is not None) == hit[k]
            if expected is not None:
                assert (t[k], beta[k], gamma[k]) == expected
                assert np.allclose(
                    o[k] + t[k] * d[k],
                    (1 - beta[k] - gamma[k]) * np.array(a) + beta[k] * np.array(b) + gamma[k] * np.array(c),
                )


def test_cramer_meets_the_weights_that_were_aimed_at():
    t, beta, gamma = naive.cramer([0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0.5, 2.0], [0, 0, -0.5])
    assert (t, beta, gamma) == (4.0, 0.25, 0.5)
    assert naive.cramer([0, 0, 0], [1, 0, 0], [0, 1, 0], [0.75, 0.5, 2.0], [0, 0, -0.5]) is None
    assert naive.cramer([0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0.5, 2.0], [0, 0, 0.5]) is None
    assert naive.cramer([0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0.5, 2.0], [1, 0, 0]) is None


SHAPES = {
    "sphere": (Sphere(None, np.eye(4), [1.0, 2.0, 3.0], 0.5), lambda p: np.linalg.norm(p - [1, 2, 3]) - 0.5),
    "box": (
        Box(None, np.eye(4), [0.0, 1.0, 2.0], [1.5, 2.5, 3.5]),
        lambda p: np.abs((p - [0.75, 1.75, 2.75]) / 0.75).max() - 1,
    ),
    "cylinder": (
        Cylinder(None, np.eye(4), [1.0, 2.0, 3.0], [1.0, 2.0, 4.0], 0.5),
        lambda p: max(np.hypot(p[0] - 1, p[1] - 2) - 0.5, abs(p[2] - 3.5) - 0.5),
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_closed_shapes(name):
    """Rays at a point inside: the hit lies on the surface, normals look outwards, a line crosses twice."""
    shape, implicit = SHAPES[name]
    inside = np.array([1.05, 2.02, 3.1])
    generator = np.random.default_rng(2)
    o = (inside + 5 * generator.normal(size=(200, 3)) * [1, 1, 1]).T
    o = o[:, [implicit(p) > 0.1 for p in o.T]]
    d = inside[:, None] - o
    hit, t, part, u, v = shape.hit(o, d, 1e-9, np.inf)
    assert hit.all()
    assert (t < 1).all()
    at = shape.surface(o, d, t, part, u, v)
    assert max(abs(implicit(p)) for p in at.point.T) < 1e-12
    assert (naive.dot(at.normal, d) < 0).all()
    step = 1e-4 * naive.unit(at.normal)
    assert all(implicit(p) > 0 for p in (at.point + step).T)
    assert (shape.crossings(o, d, 1e-9, np.inf) == 2).all()
    assert (shape.crossings(o, d, 1e-9, 1.0) == 1).all()
    assert not shape.hit(o, -d, 1e-9, np.inf)[0].any()


def test_flat_shapes():
    o, d = np.array([[0.3, 2.0], [0.4, 0.0], [5.0, 5.0]]), np.array([[0.0, 0.0], [0.0, 0.0], [-2.0, -2.0]])
    hit, t, _, _, _ = Plane(None, np.eye(4), [9, 9, 1], [0, 0, 2]).hit(o, d, 0.0, np.inf)
    assert hit.all()
    assert t.tolist() == [2.0, 2.0]
    assert Disk(None, np.eye(4), [0, 0, 1], [0, 0, -1], 0.5).hit(o, d, 0.0, np.inf)[0].tolist() == [True, False]
    half_up = read_transform([{"type": "translate", "by": [0, 0, 0.5]}])
    assert Disk(None, half_up, [0, 0, 1], [0, 0, -1], 2.0).hit(o, d, 0.0, np.inf)[1].tolist() == [1.75, 1.75]


def test_transforms_apply_first_to_last():
    turn = {"type": "rotate", "axis": [0, 0, 2], "angle_deg": 90}
    matrix = read_transform([{"type": "scale", "by": 2}, turn, {"type": "translate", "by": [1, 0, 0]}])
    assert np.allclose(matrix @ [1, 0, 0, 1], [1, 2, 0, 1])


# --- equation 1 ------------------------------------------------------------------------------------------------------


def document(**changes):
    """Return a document: camera at the origin, looking down -z at a quad at z = -1, one material "m".

    The quad reaches from x = -1 to 1.5, so that its diagonal is not in the middle of the picture.
    """
    quad = {
        "type": "mesh",
        "positions": [[-1, -1, -1], [1.5, -1, -1], [1.5, 1, -1], [-1, 1, -1]],
        "faces": [[0, 1, 2], [0, 2, 3]],
        "material": "m",
    }
    doc = {
        "version": 1,
        "camera": {"type": "perspective", "fov_deg": 60.0},
        "image": {"width": 4, "height": 2},
        "materials": {"m": {"type": "blinn_phong", "ka": 0.0, "kd": 0.0}},
        "lights": [],
        "objects": [quad],
    }
    return doc | changes


def material(**values):
    return {"m": {"type": "blinn_phong", "ka": 0.0, "kd": 0.0} | values}


def center(doc, **options):
    """Return the colour of the middle of the picture."""
    scene = read_document(doc, **options)
    return naive.trace(scene, [scene.width / 2], [scene.height / 2])[0]


def test_perspective_and_view_plane():
    scene = read_document(document())
    _, d = scene.camera.rays(np.array([4.0, 2.0]), np.array([1.0, 2.0]), 4, 2)
    right, top = d.T
    assert math.degrees(math.atan2(top[1], -top[2])) == pytest.approx(30)
    assert right[0] / -right[2] == pytest.approx(2 * math.tan(math.radians(30)))
    wide = read_document(document(camera={"type": "perspective", "fov_deg": 60.0, "fov_axis": "horizontal"}))
    _, d = wide.camera.rays(np.array([4.0]), np.array([1.0]), 4, 2)
    assert math.degrees(math.atan2(d[0, 0], -d[2, 0])) == pytest.approx(30)
    _, d = wide.camera.rays(np.array([2.0]), np.array([2.0]), 4, 2)
    assert d[1, 0] / -d[2, 0] == pytest.approx(math.tan(math.radians(30)) / 2)
    plane = {"type": "view_plane", "left": -1, "right": 3, "bottom": -2, "top": 2, "distance": 0.5}
    _, d = read_document(document(camera=plane)).camera.rays(np.array([0.0, 4.0]), np.array([0.0, 2.0]), 4, 2)
    assert d.T.tolist() == [[-1, -2, -0.5], [3, 2, -0.5]]


def test_orthographic_and_look_at():
    look = {"eye": [5, 0, 0], "target": [0, 0, 0], "up": [0, 0, 1]}
    camera = {"type": "orthographic", "height": 2.0, "look_at": look}
    o, d = read_document(document(camera=camera)).camera.rays(np.array([4.0]), np.array([2.0]), 4, 2)
    assert np.allclose(d.T, [[-1, 0, 0]])
    assert np.allclose(o.T, [[5, 2, 1]])  # +y is to the right of somebody at +x with z upwards


# --- equation 9, term by term ----------------------------------------------------------------------------------------

SUN = {"type": "directional", "direction": [0, 0, -1]}


def test_ambient_and_emission():
    lights = [
        {"type": "ambient", "intensity": 0.25},
        {"type": "ambient", "intensity": [0, 0.5, 0]},
        SUN | {"ambient": 0.125},
    ]
    doc = document(lights=lights, materials=material(ka=[1, 0.5, 0], ke=[0, 0, 3]))
    assert center(doc).tolist() == [0.375, 0.4375, 3.0]


def test_lambert_and_one_over_a():
    slanted = {"type": "directional", "direction": [0, -math.sin(1.0) * 7, -math.cos(1.0) * 7], "diffuse": [1, 2, 3]}
    doc = document(lights=[slanted], materials=material(kd=0.5, attenuation={"a": 4, "b": 5, "c": 6}))
    assert center(doc) == pytest.approx(np.array([1, 2, 3]) * 0.5 * math.cos(1.0) / 4, rel=1e-14)


def test_without_a_constant_term_nothing_comes_from_infinity():
    doc = document(
        lights=[SUN], background=1.0, materials=material(kd=1.0, kr=1.0, attenuation={"a": 0, "b": 1, "c": 0})
    )
    assert center(doc).tolist() == [0, 0, 0]


def test_point_light_attenuation():
    lamp = {"type": "point", "position": [0, 3, 3]}  # distance 5 from (0, 0, -1), cosine 4/5
    doc = document(lights=[lamp], materials=material(kd=1.0, attenuation={"a": 1, "b": 2, "c": 3}))
    assert center(doc) == pytest.approx(np.full(3, 0.8 / (1 + 10 + 75)), rel=1e-14)


def test_spot_light_falloff():
    for angle, expected in [(10, 1.0), (35, 0.0)]:
        where = [0, math.tan(math.radians(angle)), 0]
        spot = {
            "type": "spot",
            "position": [0, 0, 0],
            "direction": [0, 0, -1],
            "inner_angle_deg": 20,
            "outer_angle_deg": 30,
        }
        doc = document(
            lights=[spot],
            materials=material(kd=1.0),
            camera={"type": "orthographic", "height": 1e-9, "look_at": {"eye": where, "target": [*where[:2], -1]}},
        )
        assert center(doc) == pytest.approx(np.full(3, expected * math.cos(math.radians(angle))), abs=1e-12)
    middle = math.acos((math.cos(math.radians(20)) + math.cos(math.radians(30))) / 2)
    where = [0, math.tan(middle), 0]
    doc["camera"]["look_at"] = {"eye": where, "target": [*where[:2], -1]}
    assert center(doc) == pytest.approx(np.full(3, 0.25 * math.cos(middle)), rel=1e-12)


def test_highlight():
    """With the light mirrored into the eye the half-way vector is the normal; 2 x 0.5 rad apart it is cos(0.5)^e."""
    for angle, cosine in [(0.0, 1.0), (1.0, math.cos(0.5))]:
        sun = {"type": "directional", "direction": [0, -math.sin(angle), -math.cos(angle)], "specular": [1, 0.5, 0]}
        doc = document(lights=[sun], materials=material(ks=[0.5, 0.5, 1], exponent=20))
        assert center(doc) == pytest.approx(np.array([0.5, 0.25, 0]) * cosine**20, rel=1e-13)


def test_light_from_behind_adds_nothing():
    doc = document(
        lights=[SUN | {"direction": [0, 0.1, 1]}], materials=material(kd=1, ks=1), integrator={"shadows": False}
    )
    assert center(doc).tolist() == [0, 0, 0]


def test_two_sided():
    """The quad of the document seen from behind, lit from the viewer's side."""
    back = {"type": "perspective", "fov_deg": 60, "look_at": {"eye": [0, 0, -3], "target": [0, 0, 0]}}
    sun = {"type": "directional", "direction": [0, 0, 1]}
    doc = document(camera=back, lights=[sun], materials=material(kd=1.0))
    assert center(doc).tolist() == [1, 1, 1]
    assert center(doc | {"materials": material(kd=1.0, two_sided=False)}).tolist() == [0, 0, 0]


def test_mirror_pair_is_a_geometric_series():
    """Between two facing mirrors that glow with 1: 1 + k + k^2 + ... as many terms as bounces allow, and one."""
    other = document()["objects"][0] | {"transform": [{"type": "translate", "by": [0, 0, 3]}]}
    for depth in (0, 1, 5):
        doc = document(integrator={"max_depth": depth}, materials=material(ke=1.0, kr=[0.5, 1, 0]))
        doc["objects"] = [*doc["objects"], other]
        assert center(doc) == pytest.approx([2 - 0.5**depth, depth + 1, 1], rel=1e-14)


def test_reflection_is_attenuated_by_the_distance_of_the_bounced_ray():
    glow = document()["objects"][0] | {"transform": [{"type": "translate", "by": [0, 0, 3]}], "material": "glow"}
    materials = material(kr=1.0, attenuation={"a": 2, "b": 1, "c": 0.5}) | {
        "glow": {"type": "blinn_phong", "ka": 0, "kd": 0, "ke": 1.0}
    }
    doc = document(materials=materials, background=[8, 4, 2])
    assert center(doc) == pytest.approx([4, 2, 1], rel=1e-14)  # 1/a of the background
    doc["objects"] = [*doc["objects"], glow]
    assert center(doc) == pytest.approx(np.full(3, 1 / (2 + 3 + 4.5)), rel=1e-14)


def test_window():
    """Transmission shows what is behind, kt of it; a shadow ray through two panes loses kt twice."""
    pane = document()["objects"][0] | {"material": "pane"}
    up = [pane | {"transform": [{"type": "translate", "by": [0, 0, z]}]} for z in (0.25, 0.5)]
    glass = {"pane": {"type": "blinn_phong", "ka": 0, "kd": 0, "kt": [0.5, 1, 0]}}
    doc = document(lights=[SUN], materials=material(kd=1.0) | glass)
    doc["objects"] = [*doc["objects"], *up]
    assert center(doc) == pytest.approx([0.25 * 0.25, 1, 0], rel=1e-14)
    assert center(doc | {"integrator": {"shadows": False}}) == pytest.approx([0.25, 1, 0], rel=1e-14)


def test_the_light_ends_shadow_rays():
    lamp = {"type": "point", "position": [0, 0, 1]}
    block = document()["objects"][0]
    for z, expected in [(1.5, 0.0), (2.5, 1.0)]:
        doc = document(lights=[lamp], materials=material(kd=1.0))
        doc["objects"] = [*doc["objects"], block | {"transform": [{"type": "translate", "by": [0.9, 0, z]}]}]
        doc["camera"] = {"type": "perspective", "fov_deg": 1, "look_at": {"eye": [0, 0, -0.5], "target": [0, 0, -1]}}
        assert center(doc) == pytest.approx(np.full(3, expected))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_snell(angle):
    d, n = np.array([[math.sin(angle)], [0.0], [-math.cos(angle)]]), np.array([[0.0], [0.0], [1.0]])
    into = naive.refract(d, n, np.array([1 / 1.5]))
    assert into[0, 0] == pytest.approx(math.sin(angle) / 1.5, abs=1e-15)
    assert float(naive.length(into)[0]) == pytest.approx(1)
    out = naive.refract(into, n, np.array([1.5]))
    assert out == pytest.approx(d, abs=1e-14)
    total = naive.refract(d, n, np.array([1.5]))
    if angle > math.asin(1 / 1.5):
        assert total.ravel() == pytest.approx([d[0, 0], 0, -d[2, 0]])
    else:
        assert total[0, 0] == pytest.approx(1.5 * math.sin(angle))


def test_a_ball_of_glass_bends_the_view():
    """A ray through a sphere of index n at height h leaves turned by 2 (asin(h) - asin(h/n)), whichever way it came in."""
    eta, h = 1.5, 0.5
    ball = {"type": "sphere", "center": [0, 0, -3], "radius": 1.0, "material": "m"}
    scene = read_document(document(objects=[ball], materials=material(kt=1.0, eta=eta), integrator={"max_depth": 2}))
    scene.background = [1.0, 1.0, 1.0]
    o, d = np.array([[h], [0.0], [0.0]]), np.array([[0.0], [0.0], [-1.0]])
    for inwards in (True, False):
        index, t, part, u, v = naive.closest_hit(scene, o, d)
        assert index[0] == 0
        at = scene.primitives[0].surface(o, d, t, part, u, v)
        facing = naive.unit(at.normal if inwards else -at.normal)
        d = naive.refract(d, facing, np.array([1 / eta if inwards else eta]))
        o = at.point
    assert math.atan2(-d[0, 0], -d[2, 0]) == pytest.approx(2 * (math.asin(h) - math.asin(h / eta)))
    # and radiance() takes the same way: a light-giving wall where that ray ends
    x_wall = o[0, 0] + d[0, 0] / d[2, 0] * (-9 - o[2, 0])
    wall = naive.Triangle(
        [x_wall - 0.01, -1, -9], [x_wall + 0.01, -1, -9], [x_wall, 1, -9], naive.Material(ke=[5.0] * 3, ka=[0.0] * 3)
    )
    scene.primitives.append(wall)
    color, _ = naive.radiance(scene, np.array([[h], [0.0], [0.0]]), np.array([[0.0], [0.0], [-2.0]]))
    assert color.ravel() == pytest.approx([5, 5, 5])


def test_depth_beyond_the_limit_is_black():
    doc = document(integrator={"max_depth": 0}, materials=material(kr=1.0, kt=1.0), background=1.0)
    assert center(doc).tolist() == [0, 0, 0]


# --- textures, colours -----------------------------------------------------------------------------------------------


def test_texture_lookup():
    levels = np.zeros((2, 2, 3), dtype=np.uint8)
    levels[0, 0], levels[0, 1], levels[1, 0] = [255, 0, 0], [0, 255, 0], [0, 0, 255]  # top left, top right, bottom left

    def at(u, v, **options):
        return naive.Texture(levels, srgb=False, **options).lookup(np.array([[u], [v]])).ravel().tolist()

    assert at(0.25, 0.75) == [1, 0, 0]
    assert at(0.75, 0.75) == [0, 1, 0]
    assert at(0.25, 0.25) == [0, 0, 1]
    assert at(0.5, 0.75) == [0.5, 0.5, 0]
    assert at(0.5, 0.5) == [0.25, 0.25, 0.25]
    assert at(1.0, 0.75) == [0.5, 0.5, 0]
    assert at(1.0, 0.75, repeat=False) == [0, 1, 0]
    assert at(-0.75, 1.75, bilinear=False) == [1, 0, 0]
    grey = np.full((1, 1, 3), 128, dtype=np.uint8)
    assert naive.Texture(grey).lookup(np.zeros((2, 1)))[0, 0] == pytest.approx(((128 / 255 + 0.055) / 1.055) ** 2.4)


def test_texture_and_vertex_colors_tint_ambient_and_diffuse():
    doc = document(lights=[SUN | {"ambient": 1.0}], materials=material(ka=0.5, kd=0.25, ks=0.125))
    doc["objects"][0] |= {"colors": [[1, 0.5, 0]] * 4, "uvs": [[0, 0]] * 4}
    doc["materials"]["m"]["diffuse_texture"] = {"asset": "white", "color_space": "linear"}
    grey = {"white": np.full((1, 1, 3), 51, dtype=np.uint8)}
    assert center(doc, textures=grey) == pytest.approx(0.75 * 0.2 * np.array([1, 0.5, 0]) + 0.125, rel=1e-14)


def test_groups_choose_materials():
    doc = document(materials=material(ke=1.0) | {"n": {"type": "blinn_phong", "ka": 0, "kd": 0, "ke": 2.0}})
    doc["objects"][0] |= {"groups": {"First": [0, 1], "Second": [1, 2]}, "materials": {"Second": "n"}}
    scene = read_document(doc)
    assert [t.material.ke[0] for t in scene.primitives] == [1.0, 2.0]


def test_normals_are_interpolated_as_given():
    """2/5 of the way between normals of different length, as the original has them: not the mean of the angles."""
    doc = document(lights=[SUN], materials=material(kd=1.0))
    left, right = [-1, 0, 1], [3, 0, 4]
    doc["objects"][0] |= {"normals": [left, right, right, left]}
    mean = 0.6 * np.array(left) + 0.4 * np.array(right)
    assert center(doc) == pytest.approx(np.full(3, mean[2] / np.linalg.norm(mean)), rel=1e-14)


def test_mirroring_keeps_the_winding_outward():
    doc = document(objects=[document()["objects"][0] | {"transform": [{"type": "scale", "by": [-1, 1, 1]}]}])
    (first, *_) = read_document(doc).primitives
    assert np.cross(np.subtract(first.b, first.a), np.subtract(first.c, first.a))[2] > 0
