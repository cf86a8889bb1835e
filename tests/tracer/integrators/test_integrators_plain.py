"""Pixels shaded from a plane's equation: against the report's equations in extended precision, sample by sample.

Counters show that the pixels were shaded so: nothing is traced.
"""

import numpy as np
import pytest

from tests.tracer.integrators.test_integrators_corners import NARROW, SCREEN, WALL, both, point, room, spot
from tests.tracer.render.hand_made import build, directional, material, settings
from tracer.render import get_backend, list_blocks
from tracer.sampling.sampler import sample_2d
from tracer.types import (
    COUNTERS,
    FLAG_TWO_SIDED,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    LIGHT_KIND_SPOT,
    SAMPLER_SOBOL,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
)

SIZE = 16
SAMPLES = 16
INNER, OUTER = 0.7, 0.9


def render(scene, first=0, end=None):
    end = end if end is not None else SAMPLES
    return get_backend().render(scene, list_blocks(scene), (first, end), np.zeros(1, np.int64))


def counted(film):
    return dict(zip(COUNTERS, film.counters.tolist(), strict=True))


def directions():
    """Unit directions of the samples through `NARROW`, long double (height, width, samples, 3)."""
    d = np.zeros((SIZE, SIZE, SAMPLES, 3), np.longdouble)
    for y in range(SIZE):
        for x in range(SIZE):
            for k in range(SAMPLES):
                u, v = sample_2d(SAMPLER_SOBOL, 0, x, y, k, SAMPLES, 0)
                d[y, x, k] = (x + u) / SIZE - 0.5, 0.5 - (y + v) / SIZE, -1.0
    return unit(d)


def unit(v):
    return v / np.sqrt((v * v).sum(-1, keepdims=True))


def shade(p, d, normal, row, lamps):
    """[farmer2019 eq. 9-13, 16] of points p met in directions d: R, G, B each."""
    colour = np.broadcast_to(row["ke"] + row["ka"] * np.longdouble(0.1), p.shape).copy()
    for kind, lamp in lamps:
        to_light = lamp["position"] - p if kind != "directional" else np.broadcast_to(-lamp["direction"], p.shape)
        distance = np.sqrt((to_light * to_light).sum(-1, keepdims=True))
        to_light = to_light / distance
        a, b, c = row["abc"]
        strength = 1 / (a + b * distance + c * distance**2) if kind != "directional" else 1 / np.longdouble(a)
        if kind == "spot":
            cosine = -(to_light * lamp["direction"]).sum(-1, keepdims=True)
            cone = (cosine - np.cos(OUTER)) / (np.cos(INNER) - np.cos(OUTER))
            strength = strength * np.clip(cone, 0, 1) ** 2
        highlight = np.maximum((normal * unit(to_light - d)).sum(-1, keepdims=True), 0) ** row["exponent"]
        diffuse = (normal * to_light).sum(-1, keepdims=True)
        colour += (row["kd"] * diffuse * lamp["diffuse"] + row["ks"] * highlight * lamp["specular"]) * strength
    return colour


LAMPS = {
    "point": {"position": np.array([0.5, 0.3, 1.0]), "diffuse": 0.9, "specular": 0.7},
    "spot": {
        "position": np.array([-0.5, 0.2, 0.5]),
        "direction": np.array([0.0, 0.0, -1.0]),
        "diffuse": 1,
        "specular": 1,
    },
    "directional": {"direction": np.array([0.0, 0.6, -0.8]), "diffuse": 0.5, "specular": 0.4},
}


def light_rows(kinds):
    rows = {
        "point": (point(LAMPS["point"]["position"], 0.9, 0.7), LIGHT_KIND_POINT),
        "spot": (spot(LAMPS["spot"]["position"], (0, 0, -1), INNER, OUTER), LIGHT_KIND_SPOT),
        "directional": (directional((0, 0.6, -0.8), diffuse=0.5, specular=0.4), LIGHT_KIND_DIRECTIONAL),
    }
    return {"lights": [rows[kind][0] for kind in kinds], "light_kind": [rows[kind][1] for kind in kinds]}


def check(scene, wanted, relative=2e-14):
    film = render(scene)
    halves = np.stack([wanted[:, :, k::2].sum(2) for k in (0, 1)])
    np.testing.assert_allclose(film.sums[0], halves.astype(float), rtol=relative)
    counters = counted(film)
    assert counters["primary_rays_skipped_shared"] == counters["primary_rays"] == SIZE * SIZE * SAMPLES
    assert counters["shadow_rays"] == 0
    return counters


@pytest.mark.parametrize("kinds", [(), ("point",), ("spot",), ("directional",), ("point", "spot", "directional")])
@pytest.mark.parametrize("ks", [0.0, 0.6])
@pytest.mark.parametrize("abc", [(1.0, 0.0, 0.0), (0.7, 0.2, 0.1)])
def test_a_wall(kinds, ks, abc):
    a, b, c = abc
    look = {"ke": 0.05, "ka": 0.3, "kd": np.array([0.8, 0.5, 0.2]), "ks": ks, "exponent": 40, "abc": abc}
    row = material(ke=0.05, ka=0.3, kd=look["kd"], ks=ks, exponent=40.0, a=a, b=b, c=c)
    scene = build(
        quads=[(WALL, row)],
        settings=settings(width=SIZE, height=SIZE, samples=SAMPLES),
        camera=NARROW,
        ambient=[0.1] * 3,
        **light_rows(kinds),
    )
    d = directions()
    p = d * (-4 / d[..., 2:])
    check(scene, shade(p, d, np.array([0, 0, 1.0]), look, [(kind, LAMPS[kind]) for kind in kinds]))


@pytest.mark.parametrize("two_sided", [False, True])
def test_the_back_of_a_wall(two_sided):
    """Seen from behind, a two-sided wall is lit from the viewer's side, another one is not."""
    scene = build(
        quads=[(WALL[::-1], material(kd=0.7))],
        settings=settings(width=SIZE, height=SIZE, samples=SAMPLES),
        camera=NARROW,
        material_flags=[[int(two_sided) if k == FLAG_TWO_SIDED else (-1 if k == 0 else 0) for k in range(4)]],
        **light_rows(("point",)),
    )
    d = directions()
    p = d * (-4 / d[..., 2:])
    look = {"ke": 0, "ka": 0, "kd": 0.7, "ks": 0, "exponent": 1, "abc": (1, 0, 0)}
    lit = shade(p, d, np.array([0, 0, 1.0]), look, [("point", LAMPS["point"])])
    check(scene, lit if two_sided else np.zeros_like(lit))


def test_what_a_flat_mirror_shows():
    """A wall behind the eye, lit by a lamp that the mirror does not face; the mirror has a colour of its own."""
    scene = build(
        quads=[
            (WALL, material(ke=0.05, kr=[0.9, 0.6, 0.3], a=1.25)),
            (SCREEN, material(kd=0.6, ks=0.5, exponent=30.0, b=0.1)),
        ],
        settings=settings(width=SIZE, height=SIZE, samples=SAMPLES, depth=1),
        camera=NARROW,
        lights=[point((0.1, 0.1, -3.9))],
        light_kind=[LIGHT_KIND_POINT],
    )
    d = directions()
    on_mirror = d * (-4 / d[..., 2:])
    back = d * [1, 1, -1]
    p = on_mirror + back * (5 / back[..., 2:])
    lamp = ("point", {"position": np.array([0.1, 0.1, -3.9]), "diffuse": 1, "specular": 1})
    look = {"ke": 0, "ka": 0, "kd": 0.6, "ks": 0.5, "exponent": 30, "abc": (1, 0.1, 0)}
    shown = shade(p, back, np.array([0, 0, -1.0]), look, [lamp])
    own = {"ke": 0.05, "ka": 0, "kd": 0, "ks": 0, "exponent": 1, "abc": (1.25, 0, 0)}
    wanted = shade(on_mirror, d, np.array([0, 0, 1.0]), own, []) + np.array([0.9, 0.6, 0.3]) / 1.25 * shown
    # the walls' vertices are 400 away, the lamp's distance is 5: some roundings of 400 / 5
    counters = check(scene, wanted, relative=2e-13)
    assert counters["reflection_rays_skipped_shared"] == counters["reflection_rays"] == SIZE * SIZE * SAMPLES


def test_a_mirror_too_weak_to_follow():
    scene = build(
        quads=[(WALL, material(ke=0.5, kr=1e-5)), (SCREEN, material(ke=1.0))],
        settings=settings(width=SIZE, height=SIZE, samples=SAMPLES, depth=1),
        limits=[1e-4, 0.0],
        camera=NARROW,
    )
    counters = both(scene)
    assert counters["bounces_skipped_throughput"] == SIZE * SIZE * SAMPLES
    assert counters["reflection_rays"] == 0


@pytest.mark.parametrize("seed", range(4))
def test_pixels_do_not_depend_on_crop_or_range(seed):
    """What is asked belongs to squares of the picture: a crop has the whole picture's bits, a range of samples shares as much."""
    rng = np.random.default_rng(seed)
    scene = room(rng, 1.0, settings=settings(width=64, height=64, samples=SAMPLES, depth=2), camera=NARROW)
    whole = render(scene)
    for x, y, w, h in ((0, 0, 9, 64), (3, 5, 30, 27), (33, 18, 5, 1), (20, 20, 1, 1)):
        values = scene.settings.copy()
        values[[SETTING_CROP_X, SETTING_CROP_Y, SETTING_CROP_WIDTH, SETTING_CROP_HEIGHT]] = x, y, w, h
        cut = scene._replace(settings=values)
        part = render(cut)
        numbers = {tuple(block): i for i, block in enumerate(list_blocks(scene).tolist())}
        for block, sums in zip(list_blocks(cut).tolist(), part.sums, strict=True):
            columns = [i for i in range(16) if x <= 16 * block[0] + i < x + w]
            rows = [i for i in range(16) if y <= 16 * block[1] + i < y + h]
            of_whole = whole.sums[numbers[tuple(block)]]
            np.testing.assert_array_equal(sums[:, rows][:, :, columns], of_whole[:, rows][:, :, columns])
    parts = [render(scene, 0, 4), render(scene, 4, 5), render(scene, 5, 16)]
    for name in ("primary_rays_skipped_shared", "reflection_rays_skipped_shared", "shadow_rays_skipped_shared"):
        assert sum(counted(part)[name] for part in parts) == counted(whole)[name]


@pytest.mark.parametrize("across", [1e3, 1e6, 1e9])
def test_walls_far_larger_than_the_way_to_the_lamp(across):
    wall = np.array(WALL) * [across / 400, across / 400, 1.0]
    for depth in (1.0, 1e-3, 1e-6):
        both(
            build(
                quads=[(wall, material(kd=0.7, ks=0.3, exponent=1000.0))],
                lights=[point((0.05, 0.03, -4.0 + depth))],
                light_kind=[LIGHT_KIND_POINT],
                settings=settings(width=SIZE, height=SIZE, samples=SAMPLES),
                camera=[*NARROW[:12], -0.02, 0.02, -0.02, 0.02, 1],
            )
        )


def test_slim_faces_grazing_views_and_near_lamps():
    """Where the plane's equation would be worse than the weights of vertices, it is not used; somewhere it is."""
    rng = np.random.default_rng(6)
    plain = 0
    for _ in range(80):
        slim, slant = 2.0 ** -rng.uniform(1, 20), 2.0 ** -rng.uniform(0, 10)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        face = np.array([[-0.5, -0.3 * slim, 0], [0.5, -0.37 * slim, 0], [0.13, 0.66 * slim, 0], [0, 0, 90]]) @ turn
        foot, angle = slim * 2.0 ** -rng.uniform(3, 6), rng.uniform(0, 6)
        flat = np.sqrt(1 - slant**2)
        back = np.array([flat * np.cos(angle), flat * np.sin(angle), slant])
        right = np.cross([0.3, 0.5, 0.7], back)
        right /= np.linalg.norm(right)
        distance = foot * 2.0 ** rng.uniform(0, 8) / slant
        lamp = np.array([*rng.normal(size=2) * foot, slim * 2.0 ** rng.uniform(-1, 8)])
        half = foot / distance / 2 * slant
        frame = [back * distance, right, np.cross(back, right), back]
        scene = build(
            quads=[(face, material(kd=0.7, ks=rng.choice([0, 0.5]), exponent=rng.choice([20.0, 1000.0])))],
            lights=[point(lamp @ turn)],
            light_kind=[LIGHT_KIND_POINT],
            settings=settings(width=SIZE, height=SIZE, samples=SAMPLES),
            camera=[*np.concatenate([v @ turn for v in frame]), -half, half, -half, half, 1],
        )
        plain += both(scene)["primary_rays_skipped_shared"] > 0
    assert plain > 20
