"""Balls within closed meshes, and the shadows that they decide; the oracle is the picture with every ray traced."""

import numpy as np
import pytest
import trimesh

from tests.tracer.integrators.test_integrators_corners import NARROW, point, same_within_the_bound
from tests.tracer.render.hand_made import build, directional, material, settings
from tracer.render import get_backend, list_blocks
from tracer.render.compile import compile_scene
from tracer.render.solids import MOST_SOLIDS, find_solid, find_solids
from tracer.scene import parse_scene
from tracer.types import (
    COUNTERS,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    SETTING_SAMPLES,
    SETTING_SKIP,
    SOLID_BALL,
    SOLID_BOX,
    SOLID_CENTRE,
)


def arrays(mesh):
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32)


def solid_of(mesh):
    return find_solid(*arrays(mesh))


def test_ball_of_a_sphere_touches_its_faces():
    mesh = trimesh.creation.icosphere(3, radius=2.0)
    mesh.apply_translation([5.0, -3.0, 7.0])
    solid = solid_of(mesh)
    inradius = np.abs(((mesh.triangles_center - [5, -3, 7]) * mesh.face_normals).sum(1)).min()
    np.testing.assert_allclose(solid[SOLID_CENTRE : SOLID_CENTRE + 3], [5, -3, 7], atol=1e-12)
    np.testing.assert_allclose(1 / solid[SOLID_BALL : SOLID_BALL + 3], inradius, rtol=2e-6)
    assert (1 / solid[SOLID_BALL : SOLID_BALL + 3] < inradius).all()
    np.testing.assert_allclose(1 / solid[SOLID_BOX : SOLID_BOX + 3], 2.0)


def test_ellipsoid_of_a_box():
    solid = solid_of(trimesh.creation.box(extents=[2, 4, 10]))
    np.testing.assert_allclose(1 / solid[SOLID_BALL : SOLID_BALL + 3], [1, 2, 5], rtol=2e-6)


def test_star_shaped_meshes_hold_their_ball():
    """No point of any face is within the ellipsoid."""
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(20):
        mesh = trimesh.creation.icosphere(2)
        mesh.vertices = mesh.vertices * rng.uniform(0.5, 1.5, (len(mesh.vertices), 1)) * rng.uniform(0.1, 10, 3)
        solid = solid_of(mesh)
        if solid is None:
            continue
        found += 1
        weights = rng.dirichlet([0.3, 0.3, 0.3], (len(mesh.faces), 200))
        places = np.einsum("fwk,fkc->fwc", weights, mesh.triangles)
        off = (places - solid[SOLID_CENTRE : SOLID_CENTRE + 3]) * solid[SOLID_BALL : SOLID_BALL + 3]
        assert (off**2).sum(-1).min() > 1.0
        assert (off**2).sum(-1).min() < 1.3  # and it is not much smaller than it could be
    assert found >= 15


def test_where_there_is_none():
    sphere = trimesh.creation.icosphere(2)
    vertices, faces = arrays(sphere)
    assert find_solid(vertices, faces[:-1]) is None  # open
    assert find_solid(vertices, np.concatenate([faces, faces[:1]])) is None  # three triangles at an edge
    assert find_solid(vertices[:3], faces[:0]) is None
    assert solid_of(trimesh.creation.torus(2.0, 0.5)) is None  # its middle is outside
    inner = sphere.copy()
    inner.apply_scale(0.5)
    assert solid_of(trimesh.util.concatenate([sphere, inner])) is None  # a shell
    flat = vertices.copy()
    flat[:, 2] = 0.0
    assert find_solid(flat, faces) is None


def test_places_count_not_indices():
    """A mesh whose triangles share no vertex is closed all the same, whichever way these face."""
    vertices, faces = arrays(trimesh.creation.icosphere(2))
    apart, numbers = vertices[faces.reshape(-1)], np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    zeros = np.where(apart == 0.0, -0.0, apart)  # the same places
    apart[::2] = zeros[::2]
    np.testing.assert_array_equal(find_solid(apart, numbers), find_solid(vertices, faces))
    numbers[::3] = numbers[::3, ::-1]
    np.testing.assert_array_equal(find_solid(apart, numbers), find_solid(vertices, faces))


def test_the_largest_are_kept():
    boxes = [trimesh.creation.box(extents=[size] * 3) for size in range(1, MOST_SOLIDS + 4)]
    solids = find_solids(arrays(box) for box in boxes)
    assert np.round(2 / solids[:, SOLID_BALL]).tolist() == list(range(MOST_SOLIDS + 3, 3, -1))


def on_a_floor(mesh, lights, kinds):
    """A mesh above a floor, seen from above."""
    return with_mesh(
        arrays(mesh), [[-40, -40, -9], [40, -40, -9], [40, 40, -9], [-40, 40, -9]], lights, kinds, NARROW, 96
    )


def with_mesh(mesh, floor, lights, kinds, camera, size):
    """A mesh and a floor, which are two objects."""
    vertices, faces = mesh
    scene = build(
        quads=[(floor, material(kd=0.8)), ([[0, 0, 90]] * 4, material(kd=0.8))],
        lights=lights,
        light_kind=kinds,
        settings=settings(width=size, height=size, samples=16),
    )
    n = len(scene.vertex_positions)
    fields = {
        "vertex_positions": np.concatenate([scene.vertex_positions, vertices]),
        "vertex_normals": np.zeros((n + len(vertices), 3)),
        "vertex_uvs": np.zeros((n + len(vertices), 2)),
        "vertex_colors": np.ones((n + len(vertices), 3)),
        "face_vertices": np.concatenate([scene.face_vertices, faces + n]),
        "face_material": np.concatenate([scene.face_material, np.full(len(faces), 1)]),
        "face_flags": np.zeros(len(scene.face_flags) + len(faces)),
    }
    kept = {name: getattr(scene, name) for name in ("materials", "material_flags", "lights", "light_kind", "settings")}
    return build(**kept, camera=camera, solids=find_solids([(vertices, faces)]), **fields)


def both(scene):
    films = []
    for skip in (1, 0):
        values = scene.settings.copy()
        values[SETTING_SKIP] = skip
        given = scene._replace(settings=values)
        films.append(
            get_backend().render(given, list_blocks(given), (0, int(values[SETTING_SAMPLES])), np.zeros(1, np.int64))
        )
    same_within_the_bound(films[0].sums, films[1].sums, scene)
    counters, full = (dict(zip(COUNTERS, film.counters.tolist(), strict=True)) for film in films)
    skipped = counters["shadow_rays_skipped_solid"] + counters["shadow_rays_skipped_shared"]
    assert counters["shadow_rays"] + skipped == full["shadow_rays"]
    assert full["shadow_rays_skipped_solid"] == 0
    return counters


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("kind", [LIGHT_KIND_POINT, LIGHT_KIND_DIRECTIONAL])
def test_shadow_of_a_bumpy_ball(kind, inside_out):
    """A fine mesh between lamp and floor: most of its shadow is told by its ball."""
    rng = np.random.default_rng(kind)
    mesh = trimesh.creation.icosphere(4)
    mesh.vertices *= rng.uniform(0.95, 1.05, (len(mesh.vertices), 1))
    mesh.apply_translation([0.4, 0.2, -5.0])
    if inside_out:
        mesh.invert()
    light = point((2.5, 0.2, -2.0)) if kind == LIGHT_KIND_POINT else directional((-0.8, 0.0, -1.0))
    counters = both(on_a_floor(mesh, [light], [kind]))
    assert counters["shadow_rays_skipped_solid"] > 0
    assert counters["shadow_rays"] < 0.45 * counters["primary_rays"]


@pytest.mark.parametrize("lamp", [(0.4, 0.2, -5.0), (0.4, 0.9, -4.3), (1.3, 1.1, -4.1), (1.39, 0.2, -5.0)])
def test_a_lamp_within_the_mesh_or_its_box(lamp):
    """From there the argument does not hold: nothing is taken for hidden."""
    mesh = trimesh.creation.icosphere(3)
    mesh.apply_translation([0.4, 0.2, -5.0])
    assert both(on_a_floor(mesh, [point(lamp)], [LIGHT_KIND_POINT]))["shadow_rays_skipped_solid"] == 0


def test_floor_between_ball_and_lamp():
    """What lies behind the ray's start, or beyond the lamp, hides nothing."""
    mesh = trimesh.creation.icosphere(3)
    mesh.apply_translation([0.0, 0.0, -14.0])  # below the floor
    counters = both(
        on_a_floor(mesh, [point((0, 0, -3.0)), directional((0, 0, -1))], [LIGHT_KIND_POINT, LIGHT_KIND_DIRECTIONAL])
    )
    assert counters["shadow_rays_skipped_solid"] == 0
    mesh.apply_translation([0.0, 0.0, 20.0])  # above the lamp
    assert both(on_a_floor(mesh, [point((0, 0, -3.0))], [LIGHT_KIND_POINT]))["shadow_rays_skipped_solid"] == 0


@pytest.mark.parametrize(("kt", "n"), [(0.0, 1), ([0.0, 0.0, 0.5], 0)])
def test_only_opaque_meshes_count(kt, n):
    vertices, faces = arrays(trimesh.creation.icosphere(1))
    mesh = {"type": "mesh", "positions": vertices.tolist(), "faces": faces.tolist(), "material": "m"}
    scene = {
        "version": 1,
        "camera": {"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 0, 9], "target": [0, 0, 0]}},
        "image": {"width": 16, "height": 16},
        "materials": {"m": {"type": "blinn_phong", "kt": kt}},
        "objects": [{**mesh, "transform": [{"type": "translate", "by": [1, 2, 3]}]}],
    }
    solids = compile_scene(parse_scene(scene), lambda asset: None)[0].solids
    assert len(solids) == n
    if n:
        np.testing.assert_allclose(solids[0, SOLID_CENTRE : SOLID_CENTRE + 3], [1, 2, 3], atol=1e-12)


@pytest.mark.parametrize(("reach", "wide"), [(1e6, 2e-8), (1e9, 1e-5), (1e11, 1e-3), (1e12, 1e-3)])
def test_shadows_on_a_floor_whose_vertices_are_far_away(reach, wide):
    """Hits there are off by far more than they lie from the world's origin: corner rays must not speak for others."""
    rng = np.random.default_rng(4)
    box = arrays(trimesh.creation.box(extents=[2, 2, 2]))
    for _ in range(6):
        far = reach * rng.uniform(0.5, 1)
        floor = [
            [-1.1 * far, -0.97 * far, -9],
            [1.03 * far, -0.9 * far, -9],
            [far, 1.07 * far, -9],
            [-far, 1.2 * far, -9],
        ]
        edge = 1.0 + rng.uniform(-0.4, 0.4) * wide
        scene = with_mesh(
            (box[0] + [0, 0, -5.0], box[1]),
            floor,
            [directional((0, 0, -1))],
            [LIGHT_KIND_DIRECTIONAL],
            [
                0.3,
                0,
                -7.0,
                *NARROW[3:12],
                *((np.array([edge - wide / 2, edge + wide / 2]) - 0.3) / 2),
                -wide / 4,
                wide / 4,
                1,
            ],
            32,
        )
        both(scene)


def test_solids_take_no_square_from_a_face_that_hides_it():
    """Before a cube's face, a square half of whose rays pass the ball is dark by the face."""
    box = arrays(trimesh.creation.box(extents=[2, 2, 2]))
    floor = [[-10, -400, -9], [790, -400, -9], [790, 400, -9], [-10, 400, -9]]
    camera = [0.3, 0, -7.0, *NARROW[3:12], -0.65, 0.35, -0.5, 0.5, 1]
    scene = with_mesh(
        (box[0] + [0, 0, -5.0], box[1]), floor, [directional((0, 0, -1))], [LIGHT_KIND_DIRECTIONAL], camera, 128
    )
    shared = [
        both(scene._replace(solids=solids))["shadow_rays_skipped_shared"] for solids in (scene.solids, scene.solids[:0])
    ]
    assert shared[0] >= shared[1] > 0
