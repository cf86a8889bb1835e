"""RayCaster's door: what it takes, what it returns, what it refuses. Exactness is tested in tests/numerics."""

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere
from tracer.accel.wide import build_wide, load_wide
from tracer.rays import Hits, RayCaster

VERTICES = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 2], [4, 0, 2], [0, 4, 2]])
FACES = np.array([[0, 1, 2], [3, 4, 5]])
ORIGINS = np.array([[1.0, 1, 5], [1, 1, -1], [9, 9, 9]])
DOWN = np.array([[0.0, 0, -1], [0, 0, 2], [0, 0, 1]])


def test_answers():
    caster = RayCaster(VERTICES, FACES)
    hits = caster.closest_hit(ORIGINS, DOWN)
    assert isinstance(hits, Hits)
    assert hits.t.tolist() == [3.0, 0.5, np.inf]
    assert hits.primitive.tolist() == [1, 0, -1]
    assert hits.u.tolist() == [0.25, 0.25, 0.0]
    assert hits.v.tolist() == [0.25, 0.25, 0.0]
    assert caster.any_hit(ORIGINS, DOWN).tolist() == [True, True, False]
    assert caster.count_hits(ORIGINS, DOWN).tolist() == [2, 2, 0]


def test_limits_per_ray_and_for_all():
    caster = RayCaster(VERTICES, FACES)
    assert caster.closest_hit(ORIGINS, DOWN, tmin=3.0).t.tolist() == [5.0, np.inf, np.inf]
    assert caster.closest_hit(ORIGINS, DOWN, tmax=[3.0, 0.6, 1]).primitive.tolist() == [-1, 0, -1]
    assert caster.count_hits(ORIGINS, DOWN, [0, 1, 0], [4, 9, 9]).tolist() == [1, 1, 0]


@pytest.mark.parametrize("vertex_type", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("face_type", [np.int32, np.uint8, np.int64])
def test_types(vertex_type, face_type):
    caster = RayCaster(VERTICES.astype(vertex_type), FACES.astype(face_type))
    for kind in (np.float32, np.float64, np.int32):
        hits = caster.closest_hit(ORIGINS.astype(kind), DOWN.astype(kind))
        assert hits.t.tolist() == [3.0, 0.5, np.inf]
        assert [column.dtype.name for column in hits] == ["float64", "int32", "float64", "float64"]


def test_lists_and_strided_arrays():
    caster = RayCaster(VERTICES[::1].tolist(), np.asfortranarray(FACES))
    both = np.concatenate([ORIGINS, DOWN], 1)
    assert caster.any_hit(both[:, :3], both[:, 3:]).tolist() == [True, True, False]
    assert caster.any_hit(ORIGINS.tolist(), DOWN.tolist()).tolist() == [True, True, False]


def test_no_rays():
    caster = RayCaster(VERTICES, FACES)
    nothing = np.zeros((0, 3))
    assert [len(column) for column in caster.closest_hit(nothing, nothing)] == [0, 0, 0, 0]
    assert len(caster.any_hit(nothing, nothing, threads=2)) == 0


def test_results_are_never_written_to_again_while_any_of_them_is_held():
    caster = RayCaster(VERTICES, FACES)
    hits = caster.closest_hit(ORIGINS, DOWN)
    held, address = hits.u[1:], hits.t.ctypes.data
    del hits
    other = caster.closest_hit(ORIGINS + np.array([0.5, 0, 0]), DOWN)  # as many rays
    assert held.tolist() == [0.25, 0.0]
    assert other.u.tolist() == [0.375, 0.375, 0.0]
    del held
    assert caster.closest_hit(ORIGINS, DOWN).t.ctypes.data == address


def test_two_casters_of_one_tree_do_not_share_results():
    first, second = (RayCaster.from_bvh(build_wide(VERTICES, FACES)) for _ in range(2))
    hits = first.closest_hit(ORIGINS, DOWN)
    second.closest_hit(-ORIGINS, DOWN)
    assert hits.t.tolist() == [3.0, 0.5, np.inf]


def test_a_mapped_tree_answers_the_same(tmp_path):
    build_wide(VERTICES, FACES).save(tmp_path / "tree")
    caster = RayCaster.from_bvh(load_wide(tmp_path / "tree"))
    assert caster.closest_hit(ORIGINS, DOWN).t.tolist() == [3.0, 0.5, np.inf]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((ORIGINS[:, :2], DOWN), r"origins: shape \(3, 2\)"),
        ((ORIGINS, DOWN[0]), r"directions: shape \(3,\)"),
        ((ORIGINS, DOWN[:2]), "directions: 2 rows, expected 3"),
        ((ORIGINS, DOWN, [0.0, 0.0]), r"tmin: shape \(2,\)"),
        ((ORIGINS, DOWN, 0.0, np.ones((3, 1))), r"tmax: shape \(3, 1\)"),
    ],
)
def test_shapes_that_do_not_fit(arguments, message):
    caster = RayCaster(VERTICES, FACES)
    for method in (caster.closest_hit, caster.any_hit, caster.count_hits):
        with pytest.raises(ValueError, match=message):
            method(*arguments)


def test_the_package_loads_lazily():
    import tracer.rays

    with pytest.raises(AttributeError):
        _ = tracer.rays.nothing


def test_every_triangle_of_a_fine_mesh_among_large_ones_is_met():
    """A ray to the middle of each triangle meets that one: none is lost where few large ones share the top of the tree."""
    rng = np.random.default_rng(8)
    fine, fine_faces = icosphere(6)
    large = rng.uniform(-3, 3, (40, 1, 3)) + rng.uniform(-1, 1, (40, 3, 3)) * rng.choice([0.5, 2.0], (40, 1, 1))
    far = np.linalg.norm(large.mean(1), axis=1) > 0
    vertices = np.concatenate([fine, large[far].reshape(-1, 3)])
    faces = np.concatenate([fine_faces, len(fine) + np.arange(3 * far.sum()).reshape(-1, 3)]).astype(np.int32)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hits = RayCaster(vertices, faces).closest_hit(corners.mean(1) + 1e-7 * normals, -normals, 0.0, 2e-7)
    np.testing.assert_array_equal(hits.primitive, np.arange(len(faces)))
