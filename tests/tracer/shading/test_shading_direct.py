"""Direct light of 64 hits, against equations 11, 12 and 16 and the attenuation in plain numpy."""

import math
from fractions import Fraction

import numpy as np
import pytest

from tests.tracer.rays.spawning import offset_origin
from tests.tracer.render.hand_made import material
from tests.tracer.shading.hits import Packet, add, face
from tracer.jit import kernel
from tracer.rays.predicate import shear_of
from tracer.rays.rows import AXIS, LIGHT, ORIGIN, PACKET, SHEAR, SKIP, SPEED, T_BEST, VECTOR
from tracer.render.tiny import make_scene
from tracer.shading.direct import raise_cosine
from tracer.shading.lights import BEFORE_LIGHT, shadow_ray
from tracer.shading.rows import (
    ATTENUATION,
    COLOR,
    DIFFUSE,
    DIRECTION,
    ERROR,
    EXPONENT,
    GEOMETRIC,
    NORMAL,
    POSITION,
    SPECULAR,
    START,
)
from tracer.simd import address_of, load, store
from tracer.types import (
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
    Vec3,
)

KINDS = (LIGHT_KIND_DIRECTIONAL, LIGHT_KIND_POINT, LIGHT_KIND_SPOT)
INNER, OUTER = math.cos(math.radians(20)), math.cos(math.radians(50))


@kernel
def _raise(values, exponents, results):
    for k in range(0, len(values), 4):
        store(
            address_of(results) + 8 * k,
            raise_cosine(load(VECTOR, address_of(values) + 8 * k), load(VECTOR, address_of(exponents) + 8 * k)),
        )


def test_highlights_by_squaring():
    """Against exact rationals where the exponent is an integer up to 1024, else within 2 units of what numpy gives."""
    rng = np.random.default_rng(3)
    x = np.concatenate([[0.0, 1.0, 0.5, 1.0 - 2.0**-53], 1.0 - 10.0 ** rng.uniform(-12, -0.3, 796)])
    s = np.concatenate(
        [[1.0, 1024.0, 3.0, 1023.0], rng.choice([0, 1, 2, 7, 120, 400, 1000, 1024, 0.5, 20.25, 3e4], 796)]
    )
    results = np.empty(len(x))
    _raise(x, s, results)
    for value, exponent, result in zip(x.tolist(), s.tolist(), results.tolist(), strict=True):
        if exponent == int(exponent) and exponent <= 1024:
            exact = Fraction(value) ** int(exponent)
            room = 2 * exponent * Fraction(2) ** -53 * exact + Fraction(2) ** -1070
            assert abs(Fraction(result) - exact) <= room, (value, exponent)
        else:
            np.testing.assert_allclose(result, value**exponent, rtol=2.0**-50)


def test_highlights_do_not_depend_on_their_neighbours():
    x, s = np.full(4, 0.9), np.array([120.0, 0.5, 7.0, 2000.0])
    together, alone = np.empty(4), np.empty(4)
    _raise(x, s, together)
    for k in range(4):
        _raise(x, np.full(4, s[k]), alone)
        assert alone[k] == together[k]


def unit(a):
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def scene_with(kind, **changes):
    """One light of a kind, at (0, 0, 3), shining down and a little aside, full to 20 degrees and none from 50."""
    row = np.zeros(N_LIGHT)
    values = {
        LIGHT_POSITION: [0.0, 0.0, 3.0],
        LIGHT_DIRECTION: unit(np.array([0.1, 0.2, -1.0])),
        LIGHT_DIFFUSE: [1.0, 0.8, 0.6],
        LIGHT_SPECULAR: [0.5, 0.0, 0.9],
    }
    for column, value in (values | changes.get("light", {})).items():
        row[column : column + 3] = value
    row[LIGHT_SPOT_SCALE] = 1.0 / (INNER - OUTER)
    row[LIGHT_SPOT_OFFSET] = -OUTER / (INNER - OUTER)
    return make_scene(lights=[row], light_kind=[kind], materials=[material()])


def some_hits(rng, lanes=range(PACKET)):
    """A packet of hits about the origin and what it holds, by row."""
    n = len(lanes)
    values = {
        POSITION: rng.normal(size=(n, 3)),
        ERROR: np.full((n, 3), 1e-15),
        GEOMETRIC: unit(rng.normal(size=(n, 3))),
        NORMAL: unit(rng.normal(size=(n, 3))),
        DIRECTION: unit(rng.normal(size=(n, 3))),
        DIFFUSE: rng.random((n, 3)),
        SPECULAR: rng.random((n, 3)) * (rng.random((n, 1)) < 0.7),
        EXPONENT: 10.0 ** rng.uniform(0, 4, n),
        ATTENUATION: rng.random((n, 3)) * (rng.random((n, 3)) < 0.7),
        COLOR: rng.random((n, 3)),
    }
    packet = Packet(lanes, seed=3)
    for offset, value in values.items():
        packet.put(offset, value)
    packet.put(START, np.arange(n) - 1, words=True)
    return packet, values


def seen(scene, kind, values):
    """(Unit direction to the light, attenuation times cone) of each hit."""
    row = scene.lights[0]
    a, b, c = values[ATTENUATION].T
    aim = row[LIGHT_DIRECTION : LIGHT_DIRECTION + 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind == LIGHT_KIND_DIRECTIONAL:
            return np.tile(-aim, (len(a), 1)), np.where(a > 0, 1 / a, 0.0)
        offset = row[LIGHT_POSITION : LIGHT_POSITION + 3] - values[POSITION]
        distance = np.linalg.norm(offset, axis=1)
        to_light = np.where(distance[:, None] > 0, offset / distance[:, None], 0.0)
        denominator = a + b * distance + c * distance**2
        strength = np.where((denominator > 0) & (distance > 0), 1 / denominator, 0.0)
    if kind == LIGHT_KIND_SPOT:
        cosine = -to_light @ aim
        strength = strength * np.clip((cosine - OUTER) / (INNER - OUTER), 0, 1) ** 2
    return to_light, strength


def reflected(scene, kind, values, arriving):
    """Colour that a light adds to each hit that faces it: eq. 11 and 12, times the share that arrives."""
    to_light, strength = seen(scene, kind, values)
    row = scene.lights[0]
    half = to_light - values[DIRECTION]
    length = np.linalg.norm(half, axis=1, keepdims=True)
    half = np.divide(half, length, out=np.zeros_like(half), where=length > 0)
    n_dot_l = (values[NORMAL] * to_light).sum(1, keepdims=True)
    n_dot_h = np.maximum((values[NORMAL] * half).sum(1), 0.0)
    diffuse = values[DIFFUSE] * row[LIGHT_DIFFUSE : LIGHT_DIFFUSE + 3] * n_dot_l
    highlight = values[SPECULAR] * row[LIGHT_SPECULAR : LIGHT_SPECULAR + 3] * (n_dot_h ** values[EXPONENT])[:, None]
    return np.where(n_dot_l > 0, (diffuse + highlight) * strength[:, None] * arriving, 0.0)


@pytest.mark.parametrize("lanes", [range(PACKET), range(2, 61, 7), [63]], ids=["all", "some", "last"])
@pytest.mark.parametrize("kind", KINDS)
def test_light_is_added_as_the_equations_say(kind, lanes):
    rng = np.random.default_rng(kind)
    lit_in_all = 0
    for _ in range(8):
        scene = scene_with(kind)
        packet, values = some_hits(rng, lanes)
        lit, shadows, counters = face(scene, 0, packet)
        to_light, strength = seen(scene, kind, values)
        facing = (values[NORMAL] * to_light).sum(1) > 0
        np.testing.assert_array_equal(lit, facing & (strength > 0))
        assert counters["shadow_rays_skipped_facing"] == (~facing).sum()
        assert counters["shadow_rays_skipped_black"] == (facing & ~lit).sum()
        assert sum(counters.values()) == len(lit) - lit.sum()  # and no other counter
        arriving = rng.random((len(lit), 3))
        shadows.put(LIGHT, arriving)
        add(scene, 0, packet, shadows, lit)
        want = values[COLOR] + np.where(lit[:, None], reflected(scene, kind, values, arriving), 0.0)
        np.testing.assert_allclose(packet.get(COLOR), want, rtol=1e-11, atol=1e-13)
        np.testing.assert_array_equal(packet.get(COLOR)[~lit], values[COLOR][~lit])
        lit_in_all += lit.sum()
    assert lit_in_all > 0


@pytest.mark.parametrize("kind", KINDS)
def test_shadow_rays(kind):
    """From the offset origin to the light, bit for bit as the scalar functions have them; whole, and skipping START."""
    rng = np.random.default_rng(20 + kind)
    scene = scene_with(kind)
    packet, values = some_hits(rng)
    lit, shadows, _ = face(scene, 0, packet)
    assert lit.sum() > 5
    to_light, _ = seen(scene, kind, values)
    for k in np.flatnonzero(lit):
        facts = (Vec3(*values[row][k]) for row in (POSITION, ERROR, GEOMETRIC))
        origin = offset_origin(*facts, Vec3(*to_light[k]))
        direction, end = shadow_ray(scene.lights.ravel(), kind, 0, origin)
        *_, kz, sx, sy, sz = shear_of(*direction)
        assert shadows.get(ORIGIN)[k].tolist() == list(origin)
        assert shadows.get(SHEAR)[k].tolist() == [sx, sy, sz]
        assert shadows.get(SPEED, 1)[k] == abs(direction[kz])
        assert shadows.get(AXIS, 1, words=True)[k] == 2 * kz + (direction[kz] < 0)
        assert shadows.get(T_BEST, 1)[k] == end == (math.inf if kind == LIGHT_KIND_DIRECTIONAL else BEFORE_LIGHT)
        assert shadows.get(SKIP, 1, words=True)[k] == k - 1
        assert shadows.get(LIGHT)[k].tolist() == [1.0, 1.0, 1.0]
        outwards = np.array(origin) - values[POSITION][k]
        assert (outwards @ values[GEOMETRIC][k]) * (to_light[k] @ values[GEOMETRIC][k]) > 0


@pytest.mark.parametrize(
    ("changes", "given", "black"),
    [
        ({LIGHT_DIFFUSE: 0.0, LIGHT_SPECULAR: 0.0}, {}, True),  # a light of ambient alone
        ({}, {DIFFUSE: np.zeros((PACKET, 3)), SPECULAR: np.zeros((PACKET, 3))}, True),
        ({LIGHT_DIFFUSE: [1.0, 0.0, 0.0]}, {DIFFUSE: np.tile([0.0, 1.0, 1.0], (PACKET, 1)), SPECULAR: np.zeros((PACKET, 3))}, True),
        ({LIGHT_DIFFUSE: [0.0, 0.0, 1e-300]}, {SPECULAR: np.zeros((PACKET, 3))}, False),
        ({LIGHT_DIFFUSE: 0.0}, {SPECULAR: np.tile([1.0, 0.0, 0.0], (PACKET, 1))}, False),
    ],
)  # fmt: skip
def test_black_products_cost_no_ray(changes, given, black):
    rng = np.random.default_rng(31)
    normals = np.tile([0.0, 0.0, 1.0], (PACKET, 1))
    packet, _ = _hits_with(rng, given, normals)
    lit, _, counters = face(scene_with(LIGHT_KIND_POINT, light=changes), 0, packet)
    assert lit.any() == (not black)
    assert counters["shadow_rays_skipped_black"] == (PACKET if black else 0)
    assert counters["shadow_rays_skipped_facing"] == 0


def _hits_with(rng, given, normals):
    packet, values = some_hits(rng)
    changes = {NORMAL: normals, ATTENUATION: np.tile([1.0, 0.0, 0.0], (PACKET, 1)), **given}
    for offset, value in changes.items():
        packet.put(offset, value)
    position = values[POSITION].copy()
    position[:, 2] = -np.abs(position[:, 2])
    packet.put(POSITION, position)
    return packet, values | changes | {POSITION: position}


@pytest.mark.parametrize("kind", [LIGHT_KIND_POINT, LIGHT_KIND_SPOT])
def test_a_hit_at_the_light_itself_gets_nothing(kind):
    """Distance 0 has no direction; its neighbours in the vector are lit as ever."""
    rng = np.random.default_rng(32)
    packet, values = _hits_with(rng, {}, np.tile([0.0, 0.0, 1.0], (PACKET, 1)))
    position = values[POSITION]
    position[::2] = 0.0, 0.0, 3.0
    position[1::2, :2] *= 0.1
    packet.put(POSITION, position)
    lit, shadows, _ = face(scene_with(kind), 0, packet)
    assert lit.tolist() == [False, True] * 32
    add(scene_with(kind), 0, packet, shadows, lit)
    assert np.isfinite(packet.get(COLOR)).all()
    np.testing.assert_array_equal(packet.get(COLOR)[::2], values[COLOR][::2])


@pytest.mark.parametrize(
    ("angle", "cone"), [(0.0, 1.0), (19.9, 1.0), (35.0, None), (49.9, None), (50.1, 0.0), (90.0, 0.0), (180.0, 0.0)]
)
def test_cone_of_a_spot(angle, cone):
    """KHR_lights_punctual: full inside the inner angle, none outside the outer one, squared between."""
    a = math.radians(angle)
    scene = scene_with(LIGHT_KIND_SPOT, light={LIGHT_DIRECTION: [0.0, 0.0, -1.0]})
    place = np.array([[2.0 * math.sin(a), 0.0, 3.0 - 2.0 * math.cos(a)]])
    to_light = (np.array([[0.0, 0.0, 3.0]]) - place) / 2.0
    rng = np.random.default_rng(33)
    packet, values = some_hits(rng, [17])
    for offset, value in {
        POSITION: place,
        NORMAL: to_light,
        ATTENUATION: [[1.0, 0, 0]],
        SPECULAR: [[0.0, 0, 0]],
    }.items():
        packet.put(offset, value)
    lit, shadows, _ = face(scene, 0, packet)
    expected = ((math.cos(a) - OUTER) / (INNER - OUTER)) ** 2 if cone is None else cone
    assert lit[0] == (expected > 0)
    add(scene, 0, packet, shadows, lit)
    gained = (packet.get(COLOR) - values[COLOR])[0] / (values[DIFFUSE][0] * [1.0, 0.8, 0.6])
    np.testing.assert_allclose(gained, expected, rtol=0, atol=1e-12)


def test_the_viewer_opposite_to_the_light_has_no_half_vector():
    """l = -v: h is zero; an exponent of 0 still makes the whole highlight, any other none."""
    packet, _ = _hits_with(np.random.default_rng(34), {}, np.tile([0.0, 0.0, 1.0], (PACKET, 1)))
    changes = {
        POSITION: np.zeros((PACKET, 3)),
        DIRECTION: np.tile([0.0, 0.0, 1.0], (PACKET, 1)),
        EXPONENT: np.where(np.arange(PACKET) % 2, 5.0, 0.0),
        SPECULAR: np.ones((PACKET, 3)),
        DIFFUSE: np.zeros((PACKET, 3)),
        COLOR: np.zeros((PACKET, 3)),
    }
    for offset, value in changes.items():
        packet.put(offset, value)
    scene = scene_with(LIGHT_KIND_POINT)
    lit, shadows, _ = face(scene, 0, packet)
    assert lit.all()
    add(scene, 0, packet, shadows, lit)
    np.testing.assert_array_equal(packet.get(COLOR)[::2], np.tile([0.5, 0.0, 0.9], (32, 1)))
    np.testing.assert_array_equal(packet.get(COLOR)[1::2], 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_hit_gets_does_not_depend_on_its_company(kind):
    """Bit for bit the same in another lane and alone, beside hits without a highlight too."""
    rng = np.random.default_rng(35)
    scene = scene_with(kind)
    packet, values = some_hits(rng)
    lit, shadows, _ = face(scene, 0, packet)
    add(scene, 0, packet, shadows, lit)
    for k in range(0, PACKET, 3):
        alone = Packet([(5 * k + 1) % PACKET], seed=k)
        for offset, value in values.items():
            alone.put(offset, value[k : k + 1])
        alone.put(START, [k - 1], words=True)
        alone_lit, alone_shadows, _ = face(scene, 0, alone)
        assert alone_lit[0] == lit[k]
        add(scene, 0, alone, alone_shadows, alone_lit)
        np.testing.assert_array_equal(alone.get(COLOR)[0], packet.get(COLOR)[k])
        if lit[k]:
            for offset in (ORIGIN, SHEAR):
                np.testing.assert_array_equal(alone_shadows.get(offset)[0], shadows.get(offset)[k])
