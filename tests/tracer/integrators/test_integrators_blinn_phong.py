"""The integrator in scenes whose colours are known in closed form."""

import numpy as np
import pytest

from tests.tracer.render.hand_made import build, directional, material, settings
from tracer.render import render_compiled
from tracer.types import LIMIT_MIN_THROUGHPUT, N_LIMITS, SHAPE_BOX

WALL = [[-99, -99, -4], [99, -99, -4], [99, 99, -4], [-99, 99, -4]]  # faces the eye, 4 away
BEHIND = [[-99, -99, 2], [-99, 99, 2], [99, 99, 2], [99, -99, 2]]  # behind the eye, 2 away, facing it


def centre(scene):
    """Colour of the one pixel in the middle, and the counters."""
    film = render_compiled(scene)
    h, w, _ = film.pixels.shape
    return film.pixels[h // 2, w // 2].astype(float), film.counters


def tiny(**options):
    """One pixel that looks straight ahead, its corners 1e-9 apart."""
    return {
        "settings": settings(width=1, height=1, samples=1, **options),
        "camera": [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, -1e-9, 1e-9, -1e-9, 1e-9, 1],
    }


def limit(value):
    limits = np.zeros(N_LIMITS)
    limits[LIMIT_MIN_THROUGHPUT] = value
    return limits


def test_all_local_terms():
    """Light from 60 degrees: ke + ka (ambients) + kd / 2 + ks (n.h)^e, n.h = cos 30."""
    light = directional((np.sin(np.pi / 3), 0, -np.cos(np.pi / 3)), diffuse=0.8, specular=0.6, ambient=0.05)
    row = material(ke=0.01, ka=0.2, kd=0.5, ks=0.9, exponent=4.0)
    color, _ = centre(build(quads=[(WALL, row)], lights=[light], ambient=[0.1, 0.2, 0.3], **tiny()))
    expected = 0.01 + 0.2 * (np.array([0.1, 0.2, 0.3]) + 0.05) + 0.5 * 0.8 * 0.5 + 0.9 * 0.6 * np.cos(np.pi / 6) ** 4
    assert color == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("depth", [0, 1, 2, 5, 32])
def test_two_mirrors_are_a_geometric_series(depth):
    """Each wall glows by 1 and reflects a half; attenuation 1 / (1 + D / 2) over the 6 between them: 1/4."""
    row = material(ke=1.0, kr=0.5, a=1.0, b=0.5)
    color, counters = centre(build(quads=[(WALL, row), (BEHIND, row)], **tiny(depth=depth)))
    q = 0.5 / (1.0 + 0.5 * 6.0)
    assert color == pytest.approx([sum(q**k for k in range(depth + 1))] * 3, rel=1e-6)
    assert counters["reflection_rays"] == depth
    assert counters["bounces_skipped_depth"] == 1


def test_throughput_limit():
    """Weights 0.5^k / 2^k by the bound 1/a = 1/2: the fifth bounce is below 1e-3 and left out."""
    row = material(ke=1.0, kr=0.5, a=2.0)
    scene = build(quads=[(WALL, row), (BEHIND, row)], limits=limit(1e-3), **tiny(depth=32))
    color, counters = centre(scene)
    assert counters["bounces_skipped_throughput"] == 1
    assert counters["reflection_rays"] == 4
    assert color == pytest.approx([sum(0.25**k for k in range(5))] * 3, rel=1e-6)


def test_background_is_attenuated_by_1_over_a():
    row = material(kr=1.0, a=4.0, b=3.0, c=2.0)
    color, _ = centre(build(quads=[(WALL, row)], background=[1.0, 2.0, 4.0], **tiny()))
    assert color == pytest.approx([0.25, 0.5, 1.0], rel=1e-6)


@pytest.mark.parametrize("eta", [1.0, 1.5])
def test_a_pane_passes_light_by_kt_of_both_faces(eta):
    pane = {
        "shape_kind": [SHAPE_BOX],
        "shape_to_world": [np.diag([9.0, 9.0, 0.1])],
        "shape_to_local": [np.diag([1 / 9.0, 1 / 9.0, 10.0])],
    }
    scene = build(
        quads=[(WALL, material(ke=[1.0, 2.0, 3.0]))],
        spheres=[((0, 0, -2), 1.0, material(kt=[0.5, 0.8, 1.0], eta=eta))],
        **tiny(),
        **pane,
    )
    color, counters = centre(scene)
    assert color == pytest.approx([0.25, 2 * 0.64, 3.0], rel=1e-6)
    assert counters["transmission_rays"] == 2


def test_shadows_through_glass_are_tinted():
    """The light comes from behind the eye through a pane: kt of both faces multiplies it."""
    light = directional((0, 0, -1))
    scene = build(
        quads=[(WALL, material(kd=1.0))],
        spheres=[((0, 0, 5), 1.0, material(kt=[0.5, 1.0, 0.0]))],
        lights=[light],
        **tiny(),
    )
    color, counters = centre(scene)
    assert color == pytest.approx([0.25, 1.0, 0.0], rel=1e-6)
    assert counters["shadow_rays"] == 1
    unshadowed, counters = centre(scene._replace(settings=tiny(shadows=0)["settings"]))
    assert unshadowed == pytest.approx([1.0, 1.0, 1.0], rel=1e-6)
    assert counters["shadow_rays"] == 0


def test_total_reflection_keeps_the_kt_share():
    """From inside glass at 45 degrees (critical: 41.8): all of kr + kt goes along the mirror direction."""
    # The plane y + z = -4, seen from its back side by the eye at 0: normal (0, -1, -1) outward.
    slope = [[-99, 99, -103], [99, 99, -103], [99, -99, 95], [-99, -99, 95]]
    row = material(kr=0.25, kt=0.5, eta=1.5)
    lamp = [[-99, -50, -99], [-99, -50, 99], [99, -50, 99], [99, -50, -99]]
    ceiling = [[-99, 50, -99], [99, 50, -99], [99, 50, 99], [-99, 50, 99]]
    quads = [(slope, row), (lamp, material(ke=1.0)), (ceiling, material(ke=2.0))]
    color, counters = centre(build(quads=quads, **tiny()))
    assert counters["reflection_rays"] == 1
    assert counters["transmission_rays"] == 0
    assert color == pytest.approx([1.5] * 3, rel=1e-6)  # upwards, 0.75 of the ceiling


def test_light_behind_the_surface_costs_no_ray():
    lights = [directional((0, 0, 1)), directional((0, 0, -1), diffuse=0.0, specular=0.0)]
    color, counters = centre(build(quads=[(WALL, material(kd=1.0, ks=1.0))], lights=lights, **tiny()))
    assert color.tolist() == [0.0, 0.0, 0.0]
    assert counters["shadow_rays"] == 0
    assert counters["shadow_rays_skipped_facing"] == 1
    assert counters["shadow_rays_skipped_black"] == 1


@pytest.mark.parametrize(("two_sided", "expected"), [(1, 1.0), (0, 0.0)])
def test_the_back_of_a_surface(two_sided, expected):
    """Seen and lit from behind: shaded like the front only where the material is two-sided."""
    scene = build(quads=[(WALL[::-1], material(kd=1.0))], lights=[directional((0, 0, -1))], **tiny())
    color, _ = centre(scene._replace(material_flags=np.array([[-1, 0, 0, two_sided]], np.int32)))
    assert color.tolist() == [expected] * 3
