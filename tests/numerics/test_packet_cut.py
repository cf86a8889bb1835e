"""What a beam covers for certain: beside the short edge of a sliver, certain of the edges is not certain of the predicate.

The predicate's bound counts the farthest vertex, so there it decides exactly, and the weights are the exact branch's. A
packet that skips the decision must not skip that: u and v have the bits that they have alone.
"""

import numpy as np
import pytest

from tests.numerics.closed_meshes import by_brute_force
from tests.tracer.rays.packets import follow, tree_of
from tracer.rays import RayCaster


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("one_origin", [True, False])
@pytest.mark.parametrize("edge", [2.0**-20, 2.0**-27])
def test_beside_the_short_edge_of_a_sliver(edge, one_origin):
    """64 rays go along 2^-42 to 2^-23 of a sliver's length inside its short edge."""
    rng = np.random.default_rng(55)
    differing = 0
    for _ in range(150):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        sliver = np.array([[1.0, 0.0, 0.1], [0.0, 0.5 * edge, 0.0], [0.0, -0.5 * edge, 0.0]]) @ turn.T
        vertices = np.concatenate([sliver, sliver + turn[:, 2] * 0.7])
        faces = np.array([[0, 1, 2], [3, 4, 5]])
        inside = 2.0 ** rng.uniform(-42, -23)
        share = rng.uniform(0.3, 0.7)
        target = np.array([inside, share * (1 - inside), (1 - share) * (1 - inside)]) @ sliver
        eye = target - 2.0 * unit(turn[:, 2] + 0.2 * rng.standard_normal(3))
        origins = np.repeat(eye[None], 64, 0)
        if not one_origin:
            origins = origins * (1.0 + rng.choice([0.0, 2.0**-52, -(2.0**-52)], origins.shape))
        directions = unit(target - eye) * (1.0 + rng.choice([0.0, 2.0**-52, -(2.0**-52)], (64, 3)))
        tree = tree_of(vertices, faces)
        found = follow(tree, origins, directions, way="packet")
        alone = RayCaster.from_bvh(tree).closest_hit(origins, directions)
        times, primitives, _ = by_brute_force(vertices, faces, origins, directions)
        assert (found.primitive == primitives).all()
        assert (found.t == times).all()
        met = primitives >= 0
        differing += int(((found.u != alone.u) | (found.v != alone.v))[met].sum())
    assert differing == 0
