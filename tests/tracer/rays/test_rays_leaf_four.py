"""Several rays' triangles side by side: whatever the company, each ray's answer is that of the definition."""

import numpy as np
import pytest

from tests.numerics.closed_meshes import cube
from tracer.rays import RayCaster
from tracer.rays.caster import Hits, checked_rays
from tracer.rays.leaf import ANY, CLOSEST, COUNT
from tracer.rays.stream import IN_FLIGHT, trace_stream

COPIES = 6


def stacked(n_layers):
    """Lay COPIES of one triangle on each of the planes z = 0, 1, 2 ...; layer k has the rows from k * COPIES on."""
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]])
    layers = [np.column_stack([corners, np.full(3, float(z))]) for z in range(n_layers)]
    faces = [[3 * z, 3 * z + 1, 3 * z + 2] for z in range(n_layers) for _ in range(COPIES)]
    return np.concatenate(layers), np.array(faces)


def stream(caster, mode, origins, directions):
    rays = checked_rays(origins, directions, 0.0, np.inf)
    n = rays.n
    hits = Hits(np.full(n, -7.0), np.full(n, -7, np.int32), np.full(n, -7.0), np.full(n, -7.0))
    trace_stream(caster.bvh.buffer, rays.packed, 0, n, mode, *hits)
    return hits


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, IN_FLIGHT - 1, IN_FLIGHT + 1, 3 * IN_FLIGHT + 2])
def test_of_triangles_in_one_place_the_lowest_row_is_met_and_each_is_counted(n, dtype):
    vertices, faces = stacked(3)
    caster = RayCaster((vertices + (0.1 if dtype is np.float64 else 0.0)).astype(dtype), faces)
    k = np.arange(n)
    from_above = k % 3 == 0
    origins = np.stack([0.5 + 0.5 * (k % 4), 0.5 + 0.25 * (k % 5), np.where(from_above, 5.0, -1.0)], -1)
    directions = np.stack([np.zeros(n), np.zeros(n), np.where(from_above, -0.5, 2.0)], -1)
    beside = k % 7 == 6
    origins[beside, 0] = 9.0
    closest = stream(caster, CLOSEST, origins, directions)
    first_layer = np.where(from_above, 2 * COPIES, 0)
    np.testing.assert_array_equal(closest.primitive, np.where(beside, -1, first_layer))
    first = float(vertices[0, 2]) + (0.1 if dtype is np.float64 else 0.0)
    t = np.where(from_above, (5.0 - first - 2.0) * 2.0, (first + 1.0) / 2.0)
    np.testing.assert_allclose(closest.t, np.where(beside, np.inf, t), rtol=1e-15)
    np.testing.assert_array_equal(stream(caster, ANY, origins, directions).primitive, np.where(beside, 0, 1))
    np.testing.assert_array_equal(stream(caster, COUNT, origins, directions).primitive, np.where(beside, 0, 3 * COPIES))


def test_rays_at_corners_and_edges_are_decided_exactly_beside_plain_ones():
    signs, faces = cube()
    caster = RayCaster(signs, faces)
    rng = np.random.default_rng(5)
    edges = np.array([[a, b] for face in faces for a, b in zip(face, np.roll(face, 1), strict=True)])
    on_edges = signs[edges[rng.integers(0, len(edges), 300), 0]] + signs[edges[rng.integers(0, len(edges), 300), 1]]
    targets = np.concatenate([np.tile(signs, (40, 1)), on_edges, rng.normal(size=(400, 3))])
    targets = targets[np.abs(targets).sum(1) > 0]
    targets = targets[rng.permutation(len(targets))]
    inside = np.zeros_like(targets)
    assert (stream(caster, COUNT, inside, targets).primitive == 1).all()
    assert (stream(caster, CLOSEST, inside, targets).primitive >= 0).all()
    outside = np.tile([3.0, 5.0, 7.0], (len(targets), 1))
    assert (stream(caster, COUNT, outside, targets - outside).primitive % 2 == 0).all()
