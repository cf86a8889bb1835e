"""Hits on placements: point, normals and side are those of the same mesh with its transform baked."""

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere
from tests.tracer.rays.placements import place, random_turn, rows_of
from tests.tracer.shading.hits import meet
from tracer.shading.rows import ERROR, GEOMETRIC, NORMAL, POSITION, START


@pytest.mark.parametrize("smooth", [False, True])
def test_facts_of_hits(smooth):
    rng = np.random.default_rng(1)
    meshes = [icosphere(0), icosphere(1)]
    uses = [(1, None)]
    for k in range(12):
        linear = random_turn(rng) @ np.diag([1.0, 2.0, 0.3]) * (-1.0) ** k
        uses.append((k % 2, rows_of(linear, rng.uniform(-5, 5, 3))))
    normals = [vertices + 0.2 * rng.standard_normal(vertices.shape) for vertices, _ in meshes] if smooth else None
    placed = place(meshes, uses, normals=normals)
    mirrored = np.concatenate([np.full(len(meshes[mesh][1]), k % 2 == 0 and k > 0) for k, (mesh, _) in enumerate(uses)])
    for _ in range(10):
        primitives = rng.integers(0, len(placed.faces), 64)
        u, v = rng.dirichlet((1, 1, 1), 64)[:, 1:].T
        directions = rng.standard_normal((64, 3))
        facts, behind = meet(placed.scene, np.zeros(3), directions, primitives, u=u, v=v)
        # a baked mirror image has its winding swapped, and so its weights
        swap = mirrored[primitives]
        baked, baked_behind = meet(
            placed.baked, np.zeros(3), directions, primitives, u=np.where(swap, v, u), v=np.where(swap, u, v)
        )
        np.testing.assert_array_equal(behind, baked_behind)
        np.testing.assert_array_equal(facts.get(POSITION), baked.get(POSITION))
        for row in (GEOMETRIC, NORMAL):
            np.testing.assert_allclose(facts.get(row), baked.get(row), rtol=0, atol=1e-13)
        np.testing.assert_array_equal(facts.get(START, 1, words=True), primitives)
        as_is = primitives < len(meshes[1][1])
        more = facts.get(ERROR) - baked.get(ERROR)
        assert (more[as_is] == 0).all()
        assert (more[~as_is] > 0).all()
        assert (more < 1e-13).all()
