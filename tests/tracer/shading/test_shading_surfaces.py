"""What shading reads of 64 hits, against the equations in plain numpy."""

from fractions import Fraction

import numpy as np
import pytest

from tests.tracer.render.hand_made import material
from tests.tracer.shading.hits import Packet, meet
from tracer.geometry.vector import normalize
from tracer.rays.rows import PACKET
from tracer.render.tiny import make_scene
from tracer.shading.rows import (
    ATTENUATION,
    COLOR,
    DIFFUSE,
    ERROR,
    EXPONENT,
    GEOMETRIC,
    MATERIAL,
    NORMAL,
    POSITION,
    SPECULAR,
    START,
)
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    FILTER_BILINEAR,
    FILTER_NEAREST,
    SHAPE_SPHERE,
    WRAP_CLAMP,
    WRAP_REPEAT,
    Vec3,
)

WIDTH, HEIGHT = 5, 3
TEXELS = np.random.default_rng(1).random((WIDTH * HEIGHT, 3)).astype(np.float32)
N_FACES = 12


def unit(a):
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def scene_of(rng, **fields):
    """Twelve faces of all flags, three materials (one-sided, textured), a sphere and a plane."""
    given = {
        "vertex_positions": rng.standard_normal((20, 3)) * 3,
        "vertex_normals": rng.standard_normal((20, 3)) * 10.0 ** rng.uniform(-3, 3, (20, 1)),
        "vertex_uvs": rng.uniform(-2, 3, (20, 2)),
        "vertex_colors": rng.random((20, 3)),
        "face_vertices": np.array([rng.permutation(20)[:3] for _ in range(N_FACES)]),
        "face_material": np.arange(N_FACES) % 3,
        "face_flags": [k % 8 for k in range(N_FACES)],
        "shape_kind": [SHAPE_SPHERE],
        "shape_material": [1],
        "shape_origin": [[1.0, 2.0, 3.0]],
        "shape_to_world": [np.eye(3) * 0.5],
        "shape_to_local": [np.eye(3) * 2.0],
        "plane_point": [[0.0, -4.0, 0.0]],
        "plane_normal": [[0.0, 1.0, 0.0]],
        "plane_uv": np.zeros((1, 2, 3)),
        "plane_material": [0],
        "materials": [
            material(ka=[0.1, 0.2, 0.3], kd=[0.9, 0.5, 0.1], ks=0.4, ke=[0.0, 0.1, 0.0], exponent=7.0, a=1, b=2, c=3),
            material(ka=0.5, kd=[0.2, 0.3, 0.4], ks=[0.1, 0.2, 0.3], exponent=50.0),
            material(ka=1.0, kd=1.0, ke=0.25, a=0.5),
        ],
        "material_flags": [
            [-1, 0, 0, 1],
            [0, WRAP_REPEAT, FILTER_NEAREST, 0],
            [0, WRAP_CLAMP, FILTER_BILINEAR, 1],
        ],
        "textures": [[0, WIDTH, HEIGHT]],
        "texels": TEXELS,
    }
    return make_scene(**(given | fields))


def some_hits(rng, n, faces=range(N_FACES)):
    weights = rng.dirichlet([1, 1, 1], n)
    weights[::7] = np.eye(3)[rng.integers(0, 3, len(weights[::7]))]
    return {
        "origins": np.zeros(3),
        "directions": unit(rng.standard_normal((n, 3))),
        "primitives": rng.choice(list(faces), n),
        "u": weights[:, 1],
        "v": weights[:, 2],
    }


def texel(u, v, wrap, filtering):
    """Look a texture up in float64, v upwards: texel centres at half numbers."""
    image = TEXELS.reshape(HEIGHT, WIDTH, 3).astype(float)
    x, y = u * WIDTH, (1.0 - v) * HEIGHT
    place = (
        (lambda i, n: i % n) if wrap == WRAP_REPEAT else (lambda i, n: min(max(i, 0), n - 1))
    )  # the edge is repeated without end
    if filtering == FILTER_NEAREST:
        return image[place(int(np.floor(y)), HEIGHT), place(int(np.floor(x)), WIDTH)]
    i, j = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    fx, fy = x - 0.5 - i, y - 0.5 - j
    rows = [
        (1 - fx) * image[place(j + k, HEIGHT), place(i, WIDTH)] + fx * image[place(j + k, HEIGHT), place(i + 1, WIDTH)]
        for k in (0, 1)
    ]
    return (1 - fy) * rows[0] + fy * rows[1]


def expected(scene, hit, ambient):
    """One hit on a triangle: (position, geometric, normal, diffuse, colour, behind)."""
    face, d = hit["primitive"], hit["direction"]
    corners, flags = scene.face_vertices[face], scene.face_flags[face]
    b = np.array([1 - hit["u"] - hit["v"], hit["u"], hit["v"]])
    p = scene.vertex_positions[corners]
    geometric = unit(np.cross(p[1] - p[0], p[2] - p[0]))
    shading = geometric
    if flags & FACE_HAS_NORMALS:
        raw = b @ scene.vertex_normals[corners]
        shading = unit(raw) if np.any(raw != 0) else geometric
        if geometric @ shading < 0:
            geometric = -geometric
    behind = geometric @ d > 0
    row, (texture, wrap, filtering, two_sided) = (
        scene.face_material[face],
        scene.material_flags[scene.face_material[face]],
    )
    if two_sided and behind:
        shading = -shading
    tint = np.ones(3)
    if flags & FACE_HAS_COLORS:
        tint = b @ scene.vertex_colors[corners]
    if texture >= 0:
        u, v = b @ scene.vertex_uvs[corners] if flags & FACE_HAS_UVS else (0.0, 0.0)
        tint = tint * texel(u, v, wrap, filtering)
    ka, kd, ke = (scene.materials[row, k : k + 3] for k in (0, 3, 9))
    return b @ p, geometric, shading, kd * tint, ka * ambient * tint + ke, behind


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("lanes", [range(PACKET), range(1, 62, 3), [5], [0, 63]], ids=["all", "some", "one", "ends"])
def test_triangles(seed, lanes):
    """Many rays on one face, faces of all flags and materials together; lanes apart."""
    rng = np.random.default_rng(seed)
    scene, ambient = scene_of(rng), np.array([0.3, 0.2, 0.1])
    hits = some_hits(rng, len(lanes), range(4) if seed == 0 else range(N_FACES))
    packet, behind = meet(scene, **hits, ambient=ambient, lanes=lanes, seed=seed)
    got = [packet.get(offset) for offset in (POSITION, GEOMETRIC, NORMAL, DIFFUSE, COLOR)]
    for k in range(len(lanes)):
        hit = {
            "primitive": hits["primitives"][k],
            "direction": hits["directions"][k],
            "u": hits["u"][k],
            "v": hits["v"][k],
        }
        *want, from_behind = expected(scene, hit, ambient)
        for name, one, other in zip(("position", "geometric", "normal", "diffuse", "colour"), got, want, strict=True):
            np.testing.assert_allclose(one[k], other, rtol=0, atol=3e-13, err_msg=name)
        assert behind[k] == from_behind
    rows = scene.face_material[hits["primitives"]]
    np.testing.assert_array_equal(packet.get(MATERIAL, 1, words=True), rows)
    np.testing.assert_array_equal(packet.get(START, 1, words=True), hits["primitives"])
    np.testing.assert_array_equal(packet.get(SPECULAR), scene.materials[rows, 6:9])
    np.testing.assert_array_equal(packet.get(EXPONENT, 1), scene.materials[rows, 18])
    np.testing.assert_array_equal(packet.get(ATTENUATION), scene.materials[rows, 20:23])


def test_what_a_hit_gives_does_not_depend_on_its_company():
    """Bit for bit the same in another lane, alone, or beside normals whose squares leave float64's range."""
    rng = np.random.default_rng(11)
    scene = scene_of(rng)
    normals = scene.vertex_normals.copy()
    normals[scene.face_vertices[1]] *= 1e-200
    normals[scene.face_vertices[3]] *= 1e200
    scene = scene._replace(vertex_normals=normals)
    hits = some_hits(rng, PACKET)
    together, behind = meet(scene, **hits)
    for k in range(0, PACKET, 5):
        one = {name: value if name == "origins" else value[k : k + 1] for name, value in hits.items()}
        alone, alone_behind = meet(scene, **one, lanes=[(7 * k + 2) % PACKET], seed=k)
        assert alone_behind[0] == behind[k]
        for offset in (POSITION, ERROR, GEOMETRIC, NORMAL, DIFFUSE, COLOR):
            np.testing.assert_array_equal(alone.get(offset)[0], together.get(offset)[k])


def test_normals_that_cancel_out():
    """The sum of opposite normals has no direction: the face's own stands for it; neighbours keep theirs."""
    rng = np.random.default_rng(12)
    scene = make_scene(
        vertex_positions=[[0, 0, 0], [2, 0, 0], [0, 2, 0]],
        vertex_normals=[[0, 1.0, 1.0], [0, -1.0, -1.0], [1e-170, 0, 1e-170]],
        vertex_uvs=np.zeros((3, 2)),
        vertex_colors=np.ones((3, 3)),
        face_vertices=[[0, 1, 2]],
        face_material=[0],
        face_flags=[FACE_HAS_NORMALS],
        materials=[material(kd=1.0)],
        material_flags=[[-1, 0, 0, 0]],
    )
    u = np.array([0.5, 0.25, 0.0, 0.5, 0.25, 0.4])
    v = np.array([0.0, 0.0, 1.0, 0.0, 0.5, 0.2])
    packet, _ = meet(scene, np.zeros(3), unit(rng.standard_normal(3)), np.zeros(6, int), u=u, v=v)
    half = 0.5**0.5
    want = [[0, 0, 1], [0, half, half], [half, 0, half], [0, 0, 1], None, None]
    for got, expect in zip(packet.get(NORMAL), want, strict=True):
        if expect is not None:
            np.testing.assert_allclose(got, expect, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(packet.get(NORMAL), axis=1), 1.0, rtol=1e-15)
    raw = Vec3(1e-170, 0.0, 1e-170)
    np.testing.assert_array_equal(packet.get(NORMAL)[2], np.array(normalize(raw)))


def test_points_lie_in_their_triangles_plane_within_the_error():
    """Exactly: the distance of the rounded point to the plane, in fractions, against the bound on its coordinates."""
    rng = np.random.default_rng(13)
    for _ in range(12):
        p = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-6, 6) + rng.standard_normal(3) * 10.0 ** rng.uniform(
            -6, 6
        )
        scene = scene_of(rng, vertex_positions=np.resize(p, (20, 3)), face_vertices=[[0, 1, 2]] * N_FACES)
        hits = some_hits(rng, PACKET)
        packet, _ = meet(scene, **hits)
        q = [[Fraction(x) for x in corner] for corner in p.tolist()]
        e1, e2 = ([a - b for a, b in zip(q[k], q[0], strict=True)] for k in (1, 2))
        n = [e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]]
        for position, error in zip(packet.get(POSITION).tolist(), packet.get(ERROR).tolist(), strict=True):
            off = sum(n[k] * (Fraction(position[k]) - q[0][k]) for k in range(3))
            assert abs(off) <= sum(abs(n[k]) * Fraction(error[k]) for k in range(3))
            assert max(error) < 1e-13 * (np.abs(p).max() + np.ptp(p, axis=0).max())


@pytest.mark.parametrize("two_sided", [0, 1])
def test_shapes_and_planes_among_triangles(two_sided):
    """A sphere from outside and from inside, a plane from both sides, triangles between them."""
    rng = np.random.default_rng(14)
    flags = [[-1, 0, 0, two_sided]] * 3
    scene = scene_of(rng, material_flags=flags)
    sphere, plane = N_FACES, N_FACES + 1
    centre = np.array([1.0, 2.0, 3.0])
    n = 60
    outward = unit(rng.standard_normal((n, 3)))
    primitives = np.array([sphere, sphere, plane, plane, 0] * 12)
    inside = np.arange(n) % 5 == 1
    directions = np.where(inside[:, None], outward, -outward)
    origins = np.where(inside[:, None], centre, centre + 3.0 * outward)
    t = np.where(inside, 0.5, 2.5)
    down = np.array([0.0, -1.0, 0.0])
    for k in range(n):
        if primitives[k] == plane:
            directions[k] = down if k % 5 == 2 else -down
            origins[k] = [k, -3.0 if k % 5 == 2 else -6.0, 1.0]
            t[k] = 1.0 if k % 5 == 2 else 2.0
    packet, behind = meet(scene, origins, directions, primitives, t=t, u=0.25, v=0.25, ambient=[1.0, 1.0, 1.0])
    for k in range(n):
        if primitives[k] == sphere:
            position, normal, row = centre + 0.5 * outward[k], outward[k], 1
        elif primitives[k] == plane:
            position, normal, row = np.array([k, -4.0, 1.0]), -down, 0
        else:
            continue
        np.testing.assert_allclose(packet.get(POSITION)[k], position, rtol=0, atol=1e-14)
        np.testing.assert_allclose(packet.get(GEOMETRIC)[k], normal, rtol=0, atol=1e-14)
        assert behind[k] == (normal @ directions[k] > 0)
        turned = -normal if behind[k] and two_sided else normal
        np.testing.assert_allclose(packet.get(NORMAL)[k], turned, rtol=0, atol=1e-14)
        assert packet.get(MATERIAL, 1, words=True)[k] == row
        assert packet.get(START, 1, words=True)[k] == (plane if primitives[k] == plane else -1)
        np.testing.assert_allclose(packet.get(DIFFUSE)[k], scene.materials[row, 3:6])
        np.testing.assert_allclose(packet.get(COLOR)[k], scene.materials[row, :3] + scene.materials[row, 9:12])
    assert behind[inside].all()


def test_other_lanes_are_left_alone():
    rng = np.random.default_rng(15)
    scene = scene_of(rng)
    lanes = np.array([1, 2, 33, 60])
    packet, _ = meet(scene, **some_hits(rng, 4), lanes=lanes)
    untouched = Packet()
    others = np.setdiff1d(np.arange(PACKET), lanes)
    np.testing.assert_array_equal(packet.words[:, others], untouched.words[:, others])
