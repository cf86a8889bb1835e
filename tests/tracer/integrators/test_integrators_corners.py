"""What four corner rays tell of a wave changes no picture, and is told where it can be.

The oracle is the same picture with SETTING_SKIP off, where every ray is traced: bit for bit the same sums, but for
pixels that are shaded from a plane's equation (`tracer.integrators.plain`), where the stated bound holds. Where only a
handful of triangles stand around, closed reasoning says what must have been shared.
"""

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, directional, material, settings
from tracer.render import get_backend, list_blocks
from tracer.types import (
    COUNTERS,
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    LIGHT_DIFFUSE,
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPECULAR,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    N_LIGHT,
    SETTING_SAMPLES,
    SETTING_SHADOWS,
    SETTING_SKIP,
)

WALL = [[-400, -100, -4], [400, -100, -4], [0, 400, -4], [-400, 400, -4]]  # all of it that is seen is one triangle
SCREEN = [[x, y, 1] for x, y, _ in WALL]  # behind the eye
NARROW = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -0.5, 0.5, -0.5, 0.5, 1]


def same_within_the_bound(film, oracle, scene):
    """The bound that `tracer.integrators.plain` states: of the lights' intensities, times the samples."""
    lights = scene.lights.reshape(-1, N_LIGHT)
    arriving = lights[:, LIGHT_DIFFUSE : LIGHT_DIFFUSE + 3] + lights[:, LIGHT_SPECULAR : LIGHT_SPECULAR + 3]
    bound = 1e-12 * arriving.sum(0) * scene.settings[SETTING_SAMPLES] / 2  # a half's samples, channel by channel
    assert (np.abs(film - oracle) <= bound + 1e-14 * np.abs(oracle)).all()


def both(scene):
    """Counters with and without sharing, after the pictures were compared."""
    counters = []
    films = []
    for skip in (1, 0):
        values = scene.settings.copy()
        values[SETTING_SKIP] = skip
        given = scene._replace(settings=values)
        film = get_backend().render(given, list_blocks(given), (0, int(values[SETTING_SAMPLES])), np.zeros(1, np.int64))
        films.append(film.sums)
        counters.append(dict(zip(COUNTERS, film.counters.tolist(), strict=True)))
    same_within_the_bound(films[0], films[1], given)
    shared, full = counters
    assert full["primary_rays_skipped_shared"] == full["shadow_rays_skipped_shared"] == 0
    assert full["reflection_rays_skipped_shared"] == 0
    assert shared["shadow_rays"] + shared["shadow_rays_skipped_shared"] == full["shadow_rays"]
    for name in ("reflection_rays", "transmission_rays", "shadow_rays_skipped_facing", "shadow_rays_skipped_black"):
        assert shared[name] == full[name]
    return shared


def point(position, diffuse=1.0, specular=1.0):
    row = np.zeros(N_LIGHT)
    row[LIGHT_POSITION : LIGHT_POSITION + 3] = position
    row[LIGHT_DIFFUSE : LIGHT_DIFFUSE + 3] = diffuse
    row[LIGHT_SPECULAR : LIGHT_SPECULAR + 3] = specular
    return row


def spot(position, direction, inner, outer):
    row = point(position)
    row[LIGHT_DIRECTION : LIGHT_DIRECTION + 3] = np.array(direction) / np.linalg.norm(direction)
    scale = 1.0 / max(1e-9, np.cos(inner) - np.cos(outer))
    row[[LIGHT_SPOT_SCALE, LIGHT_SPOT_OFFSET]] = scale, -np.cos(outer) * scale
    return row


def room(rng, scale, **fields):
    """A box around the eye with panels in it: flat and smooth, dull and mirroring, glass, coloured, some coincident."""
    corner = np.array(
        [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
    )
    corner = corner * [4.0, 3.0, 6.0]
    sides = [(0, 1, 2, 3), (5, 4, 7, 6), (4, 0, 3, 7), (1, 5, 6, 2), (3, 2, 6, 7), (4, 5, 1, 0)]
    looks = [
        material(ka=0.1, kd=0.8),
        material(ka=0.2, kd=[0.9, 0.3, 0.2], ks=0.6, exponent=60.0),
        material(kd=0.4, kr=0.5, ks=0.3),
        material(kd=0.2, kt=[0.7, 0.8, 0.6]),
        material(ke=[0.3, 0.2, 0.1], kd=0.5, a=1.0, b=0.1),
    ]
    quads = [(corner[list(side)] * scale, looks[rng.integers(2)]) for side in sides]
    for _ in range(4):
        middle, along, up = rng.uniform(-1, 1, 3) * [2.5, 2, 2] + [0, 0, -3.0], rng.normal(size=3), rng.normal(size=3)
        size = rng.choice([0.3, 1.0, 2.0])
        panel = np.array([middle - along - up, middle + along - up, middle + along + up, middle - along + up])
        panel = (middle + (panel - middle) * size * 0.5) * scale
        row = looks[rng.integers(len(looks))]
        quads.append((panel, row))
        if rng.random() < 0.3:
            quads.append((panel[[1, 2, 3, 0]], looks[rng.integers(len(looks))]))
    n = 4 * len(quads)
    flags = rng.choice([0, FACE_HAS_NORMALS, FACE_HAS_COLORS | FACE_HAS_UVS], len(quads)).repeat(2)
    lights = [
        point(rng.uniform(-1, 1, 3) * [3, 2, 4] * scale),
        directional(rng.normal(size=3), diffuse=0.5),
        spot(rng.uniform(-1, 1, 3) * [3, 2, 4] * scale, rng.normal(size=3), 0.3, 0.6),
    ]
    return build(
        quads=quads,
        lights=lights,
        light_kind=[LIGHT_KIND_POINT, LIGHT_KIND_DIRECTIONAL, LIGHT_KIND_SPOT],
        vertex_normals=rng.normal(size=(n, 3)) * 0.3 + rng.normal(size=(n // 4, 3)).repeat(4, 0),
        vertex_colors=rng.uniform(0, 1, (n, 3)),
        vertex_uvs=rng.uniform(-2, 2, (n, 2)),
        face_flags=flags,
        ambient=[0.1, 0.1, 0.1],
        **fields,
    )


@pytest.mark.parametrize("scale", [1.0, 2.0**-30, 1e4 / 3])
def test_pictures_are_the_same(scale):
    """Rooms of all sorts of panels; and much is shared in them."""
    rng = np.random.default_rng(int(scale * 2**30) % 1000)
    primary = shadows = 0
    for _ in range(12):
        scene = room(rng, scale, settings=settings(width=160, height=160, samples=16, depth=2), camera=NARROW)
        counters = both(scene)
        primary += counters["primary_rays_skipped_shared"] / counters["primary_rays"]
        shadows += counters["shadow_rays_skipped_shared"] / (
            counters["shadow_rays_skipped_shared"] + counters["shadow_rays"]
        )
    assert primary > 0.25 * 12
    assert shadows > 0.08 * 12


@pytest.mark.parametrize("samples", [1, 3, 5, 12, 24, 100])
def test_any_number_of_samples(samples):
    """Packets hold whole pixels, so 12 samples make packets of 5 pixels, which must not straddle what was asked about."""
    rng = np.random.default_rng(samples)
    size = 320 if samples == 1 else 96  # fewer samples make waves of more pixels, which see less often one face
    for _ in range(3):
        picture = settings(width=size, height=size, samples=samples, depth=2)
        counters = both(room(rng, 1.0, settings=picture, camera=NARROW))
        assert counters["primary_rays_skipped_shared"] > 0


def test_a_wall_alone_is_shared_by_all():
    """One wall, a lamp in front, one behind: nothing is traced."""
    lights = [point((0.5, 0.3, 1.0)), directional((0, 0, 1))]
    scene = build(
        quads=[(WALL, material(kd=0.7, ks=0.4))],
        lights=lights,
        light_kind=[LIGHT_KIND_POINT, LIGHT_KIND_DIRECTIONAL],
        settings=settings(width=64, height=64, samples=16),
        camera=NARROW,
    )
    counters = both(scene)
    assert counters["primary_rays_skipped_shared"] == counters["shadow_rays_skipped_shared"] == counters["primary_rays"]
    assert counters["shadow_rays_skipped_facing"] == counters["primary_rays"]


@pytest.mark.parametrize(("kt", "dark"), [(0.0, True), (0.5, False)])
def test_what_hides_the_lamp_from_all(kt, dark):
    """A screen between wall and lamp: opaque, it speaks for all; of glass it does not."""
    scene = build(
        quads=[(WALL, material(kd=0.7)), (SCREEN, material(kt=kt))],
        lights=[point((0.5, 0.3, 2.0))],
        light_kind=[LIGHT_KIND_POINT],
        settings=settings(width=64, height=64, samples=16),
        camera=NARROW,
    )
    counters = both(scene)
    assert (counters["shadow_rays_skipped_shared"] > 0.7 * counters["primary_rays"]) == dark
    assert counters["shadow_rays_skipped_shared"] in range(counters["primary_rays"]) or dark


def test_a_twin_is_no_second_triangle():
    """Two walls at one place: the one of lower id is seen, by all."""
    quads = [(WALL, material(ke=0.25)), (WALL, material(ke=0.5))]
    counters = both(build(quads=quads, settings=settings(width=64, height=64, samples=16), camera=NARROW))
    assert counters["primary_rays_skipped_shared"] == counters["primary_rays"]


def test_a_hair_in_the_wave_is_seen():
    """A triangle a thousandth of a pixel wide, between the corners, before the wall or between wall and lamp."""
    for z, lamp in ((-2.0, (0.0, 0.0, 1.0)), (1.0, (0.0, 0.0, 2.0))):
        hair = [[0.11, -9, z], [0.11001, -9, z], [0.11001, 9, z], [0.11, 9, z]]
        scene = build(
            quads=[(WALL, material(kd=0.7)), (hair, material(ke=100.0))],
            lights=[point(lamp)],
            light_kind=[LIGHT_KIND_POINT],
            settings=settings(width=64, height=64, samples=64),
            camera=NARROW,
        )
        both(scene)


def test_without_shadows_every_lamp_reaches_all():
    scene = build(
        quads=[(WALL, material(kd=0.7)), (SCREEN, material(kd=1.0))],
        lights=[point((0.5, 0.3, 2.0))],
        light_kind=[LIGHT_KIND_POINT],
        settings=settings(width=64, height=64, samples=16, shadows=0),
        camera=NARROW,
    )
    assert scene.settings[SETTING_SHADOWS] == 0
    counters = both(scene)
    assert counters["shadow_rays_skipped_shared"] == counters["shadow_rays"] == 0
    assert counters["primary_rays_skipped_shared"] == counters["primary_rays"]


def test_a_flat_mirror_sends_all_on_to_one_wall():
    """All that the mirror shows is one wall behind the eye, lit by one lamp."""
    scene = build(
        quads=[(WALL, material(kd=0.0, kr=0.8)), (SCREEN, material(kd=0.7, ke=0.1))],
        lights=[point((0.5, 0.3, -1.0))],
        light_kind=[LIGHT_KIND_POINT],
        settings=settings(width=64, height=64, samples=16, depth=2),
        camera=NARROW,
    )
    counters = both(scene)
    assert counters["reflection_rays"] == counters["primary_rays"]
    assert counters["reflection_rays_skipped_shared"] == counters["reflection_rays"]
    assert counters["shadow_rays_skipped_shared"] > 0.5 * counters["reflection_rays"]


def test_a_mirror_with_a_normal_of_its_own_is_asked_ray_by_ray():
    """Its shading normal is the same all over, but not the plane's: mirrored rays do not come from one point."""
    normals = np.tile([0.1, 0.0, 1.0], (8, 1))
    scene = build(
        quads=[(WALL, material(kd=0.0, kr=0.8)), (SCREEN, material(ke=0.1))],
        vertex_normals=normals,
        face_flags=np.array([FACE_HAS_NORMALS, FACE_HAS_NORMALS, 0, 0], np.uint8),
        settings=settings(width=64, height=64, samples=16, depth=2),
        camera=NARROW,
    )
    counters = both(scene)
    assert counters["reflection_rays"] > 0
    assert counters["reflection_rays_skipped_shared"] == 0


def test_an_eye_on_the_face():
    """Rounding decides which rays meet a face that the eye lies on, be it at distance 0: nothing tells for all of them."""
    rng = np.random.default_rng(6)
    for _ in range(40):
        corners = rng.uniform(-1, 1, (4, 3))
        eye = corners[:3].mean(0)
        scene = build(
            quads=[(corners, material(ke=0.4))],
            settings=settings(width=64, height=64, samples=4),
            camera=[*eye, *NARROW[3:]],
        )
        both(scene)


def test_a_floor_that_goes_on_behind_does_not_count():
    """The floor's box and outline hold the beam; where the beam meets its plane is behind the panel."""
    floor = [[-400, -1, 90], [400, -1, 90], [0, -1, -900], [-400, -1, -900]]
    panel = [[-300, -0.9, -3], [300, -0.9, -3], [300, 90, -3], [-300, 90, -3]]
    below = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -0.2, 0.2, -0.28, -0.05, 1]
    scene = build(
        quads=[(floor, material(kd=0.7)), (panel, material(kd=0.7))],
        settings=settings(width=64, height=64, samples=16),
        camera=below,
    )
    counters = both(scene)
    assert counters["primary_rays_skipped_shared"] > 0.8 * counters["primary_rays"]


def test_shadow_by_a_block_of_several_faces():
    """None of the block's faces hides the lamp from all of the floor; where one hides it from a wave, it speaks for it."""
    low, high = np.array([-2.0, -2.0, -3.5]), np.array([2.0, 2.0, -2.5])
    block = []
    for axis in range(3):
        for side in (low, high):
            corner = np.array([[low[0], low[1], low[2]]] * 4)
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corner[:, axis] = side[axis]
            corner[1:3, u], corner[2:, v] = high[u], high[v]
            block.append((corner, material()))
    eye = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.9, 1.4, -0.25, 0.25, 1]
    scene = build(
        quads=[(WALL, material(kd=0.7)), *block],
        lights=[point((-4.5, 0.3, -2.0))],
        light_kind=[LIGHT_KIND_POINT],
        settings=settings(width=96, height=96, samples=16),
        camera=eye,
    )
    counters = both(scene)
    assert counters["shadow_rays_skipped_shared"] > 0.5 * counters["primary_rays"]


def test_a_mesh_finer_than_pixels():
    """Samples travel in another order there; their sums do not tell."""
    rng = np.random.default_rng(5)
    n = 96
    x, y = np.meshgrid(np.linspace(-2.2, 2.2, n + 1), np.linspace(-2.2, 2.2, n + 1), indexing="ij")
    points = np.stack([x, y, -4 + 0.05 * rng.random(x.shape)], -1)
    cells = [
        [points[i, j], points[i + 1, j], points[i + 1, j + 1], points[i, j + 1]] for i in range(n) for j in range(n)
    ]
    for samples in (16, 20, 64):
        scene = build(
            quads=[(cell, material(kd=0.6, kr=0.3)) for cell in cells] + [(SCREEN, material(kd=0.5))],
            lights=[point((0.5, 0.3, -1.0))],
            light_kind=[LIGHT_KIND_POINT],
            settings=settings(width=24, height=24, samples=samples, depth=2),
            camera=NARROW,
        )
        both(scene)
