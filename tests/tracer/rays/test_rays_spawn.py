"""Rays that leave a surface do not meet it again, and do not pass what is next to it."""

import numpy as np
import pytest

from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.spawning import offset_origin
from tests.tracer.shading.hits import meet
from tracer.geometry.shapes import locate_on_shape
from tracer.render.tiny import make_scene
from tracer.shading.rows import ERROR, GEOMETRIC, POSITION
from tracer.types import MATERIAL_A, N_MATERIAL, SHAPE_BOX, SHAPE_CYLINDER_CAPPED, SHAPE_SPHERE, Vec3


def hemisphere(rng, normal, n):
    """Directions on the normal's side, half of them grazing it at 1e-8 to 1e-2 radians."""
    d = rng.standard_normal((n, 3))
    d -= np.outer(d @ normal, normal)
    d /= np.linalg.norm(d, axis=1)[:, None]
    angle = np.where(rng.random(n) < 0.5, 10.0 ** rng.uniform(-8, -2, n), rng.uniform(0.01, np.pi / 2, n))
    return np.cos(angle)[:, None] * d + np.sin(angle)[:, None] * normal


def test_origin_goes_to_the_side_of_the_direction():
    p, error, n = Vec3(1.0, 2.0, 3.0), Vec3(1e-10, 1e-10, 1e-10), Vec3(0.0, 0.6, 0.8)
    up = offset_origin(p, error, n, Vec3(0.0, 0.0, 1.0))
    down = offset_origin(p, error, n, Vec3(0.0, 0.0, -1.0))
    assert (np.array(up) - np.array(p)) @ np.array(n) == pytest.approx(1.4e-10, rel=1e-4)
    assert (np.array(down) - np.array(p)) @ np.array(n) == pytest.approx(-1.4e-10, rel=1e-4)
    assert up.x == down.x == 1.0  # no component along x to move by


def rays_that_leave_a_fan(rng, scale, offset, turn):
    """Rays from a flat fan of 40 coplanar triangles, and what they meet: (hits, sines over the plane)."""
    basis = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) @ basis
    vertices = (np.concatenate([np.zeros((1, 3)), rim]) + offset * rng.standard_normal(3)) * scale
    scene = make_scene(
        vertex_positions=vertices,
        vertex_normals=np.zeros_like(vertices),
        vertex_uvs=np.zeros((len(vertices), 2)),
        vertex_colors=np.ones_like(vertices),
        face_vertices=[(0, k, k % 40 + 1) for k in range(1, 41)],
        face_material=np.zeros(40),
        face_flags=np.zeros(40),
        materials=np.zeros((1, N_MATERIAL)),
        material_flags=[[-1, 0, 0, 1]],
    )
    face = rng.integers(0, 40, 150)
    weights = rng.dirichlet([0.3, 0.3, 0.3], 150)
    weights[:60, 0] = 0.0  # on an edge
    weights = rng.permuted(weights / weights.sum(1, keepdims=True), axis=1)
    origins, directions = [], []
    for start in range(0, 150, 50):
        k = slice(start, start + 50)
        packet, _ = meet(scene, np.zeros(3), basis[2], face[k], u=weights[k, 1], v=weights[k, 2])
        facts = (packet.get(row) for row in (POSITION, ERROR, GEOMETRIC))
        for position, error, normal in zip(*facts, strict=True):
            for d in hemisphere(rng, rng.choice([-1.0, 1.0]) * normal, 4):
                origins.append(offset_origin(Vec3(*position), Vec3(*error), Vec3(*normal), Vec3(*d)))
                directions.append(d)
    hits = find_closest(scene, np.array(origins), np.array(directions), np.repeat(face, 4))
    return hits, np.abs(np.array(directions) @ basis[2])


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1.0, 1e4])
def test_a_ray_does_not_meet_its_triangles_neighbours(scale, offset):
    """From faces, edges and corners, grazing too; the triangle itself is skipped, as the integrator does."""
    rng = np.random.default_rng(1)
    for _ in range(6):
        turn = (np.arange(40) + rng.random()) * (2 * np.pi / 40)
        hits, sine = rays_that_leave_a_fan(rng, scale, offset, turn)
        # The corners are rounded, so the fan is flat to 1e-16 of its offset only: leave out what grazes less than that.
        assert (hits.primitive[sine > 1e-14 * (1.0 + offset)] == -1).all()


def test_a_ray_does_not_meet_slim_neighbours():
    """Triangles down to 1e-4 as wide as long, left at the very edge: N9 asks for none of them to be met."""
    rng = np.random.default_rng(1)
    met = 0
    for _ in range(24):
        hits, sine = rays_that_leave_a_fan(rng, 1e-6, 0.0, np.sort(rng.random(40)) * 2 * np.pi)
        met += (hits.primitive[sine > 1e-14] >= 0).sum()
    assert met == 0


@pytest.mark.parametrize("kind", [SHAPE_SPHERE, SHAPE_BOX, SHAPE_CYLINDER_CAPPED])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_shapes_are_not_met_again_from_outside_nor_missed_from_inside(kind, scale, offset):
    rng = np.random.default_rng(kind)
    material = np.zeros((1, N_MATERIAL))
    material[0, MATERIAL_A] = 1.0
    matrix = np.linalg.qr(rng.standard_normal((3, 3)))[0] * scale * 1.7
    origin = rng.standard_normal(3) * offset * scale
    scene = make_scene(
        shape_kind=[kind],
        shape_material=[0],
        shape_origin=[origin],
        shape_to_world=[matrix],
        shape_to_local=[np.linalg.inv(matrix)],
        materials=material,
    )
    # Points of the surface, as hits of rays from far away.
    n = 1500
    aim = origin + (rng.uniform(-1, 1, (n, 3)) @ matrix.T)
    start = origin + 5.0 * scale * rng.standard_normal((n, 3))
    hits = find_closest(scene, start, aim - start)
    hit = np.flatnonzero(hits.primitive == 0)
    assert len(hit) > n // 4
    for inward in (False, True):
        origins, directions = [], []
        for k in hit:
            facts = locate_on_shape(
                kind,
                Vec3(*origin),
                scene.shape_to_world.ravel(),
                scene.shape_to_local.ravel(),
                np.int64(0),
                Vec3(*start[k]),
                Vec3(*(aim[k] - start[k])),
                hits.t[k],
            )
            normal = np.array(facts.normal)
            d = hemisphere(rng, -normal if inward else normal, 1)[0]
            origins.append(offset_origin(facts.position, facts.error, facts.normal, Vec3(*d)))
            directions.append(d)
        found = find_closest(scene, np.array(origins), np.array(directions))
        if inward:  # the other side, a chord away, is met; the surface itself is not
            assert (found.primitive == 0).all()
            depth = np.abs(np.einsum("ij,ij->i", directions, directions) - 1).max()
            assert depth < 1e-14
            assert (found.t > 1e-9 * scale).mean() > 0.95
        else:
            assert (found.primitive == -1).all()
