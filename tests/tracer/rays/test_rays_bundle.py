"""Bundles: how rays are shared out changes no answer, and nothing is written for rays that are not asked for."""

import numpy as np
import pytest

from tests.numerics.closed_meshes import by_brute_force, sphere
from tests.tracer.rays.packets import clutter, follow, put_direction, tree_of
from tracer.jit import int64, kernel
from tracer.rays.bundle import trace_bundle
from tracer.rays.leaf import CLOSEST
from tracer.rays.rows import PACKET, PRIMITIVE, RAY_ROWS, ROW, SKIP, T_BEST
from tracer.simd import address_of, store
from tracer.simd.gateway import types

_int64 = types.int64


@pytest.fixture(scope="module")
def mesh():
    vertices, faces = sphere(20, 20)
    return vertices, faces, tree_of(vertices, faces)


def mixed_rays(rng, n):
    """Some in clusters, some alone, of all axes."""
    origins, directions = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    for k in range(0, n - 16, 32):
        origins[k : k + 16] = origins[k] + 1e-3 * rng.normal(size=(16, 3))
        directions[k : k + 16] = directions[k] + 1e-3 * rng.normal(size=(16, 3))
    return origins, directions / np.linalg.norm(directions, axis=1)[:, None]


@pytest.mark.parametrize("mode", ["closest", "any", "shade"])
def test_answers_do_not_depend_on_company_order_or_lane(mesh, mode):
    _, faces, tree = mesh
    rng = np.random.default_rng(61)
    n = 640
    origins, directions = mixed_rays(rng, n)
    ends = np.where(rng.random(n) < 0.5, np.inf, rng.uniform(0.5, 4, n))
    kt = 2.0 ** -rng.integers(0, 3, (len(faces), 3)) * (rng.random((len(faces), 3)) < 0.9)
    reference = follow(tree, origins, directions, ends, mode=mode, kt=kt)
    order = rng.permutation(n)
    for size, seed, way in (
        (64, 1, "bundle"),
        (1, 2, "bundle"),
        (50, 4, "packet"),
        (7, 5, "alone"),
        (60, 6, "given up"),
    ):
        found = follow(
            tree, origins[order], directions[order], ends[order], mode=mode, kt=kt, size=size, seed=seed, way=way
        )
        for one, other, name in zip(reference, found, reference._fields, strict=True):
            if name == "light" and mode != "shade":
                continue
            np.testing.assert_array_equal(one[order], other, err_msg=name)


def test_one_ray_of_each_kind(mesh):
    vertices, faces, tree = mesh
    rng = np.random.default_rng(62)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            direction = rng.uniform(-0.5, 0.5, (1, 3))
            direction[0, axis] = sign
            origin = rng.normal(size=(1, 3)) * 0.1
            times, primitives, _ = by_brute_force(vertices, faces, origin, direction)
            found = follow(tree, origin, direction, size=1, seed=axis)
            assert (found.t[0], found.primitive[0]) == (times[0], primitives[0])


@kernel
def _trace_some(tree, memory, directions, lanes):
    packet = (address_of(memory) + 63) & ~63
    for lane in range(PACKET):
        put_direction(packet, lane, directions[lane, 0], directions[lane, 1], directions[lane, 2])
        for axis in range(3):
            store(packet + axis * ROW + 8 * lane, 0.01 * axis)
        store(packet + T_BEST + 8 * lane, np.inf)
        store(packet + PRIMITIVE + 8 * lane, _int64(-1))
        store(packet + SKIP + 8 * lane, _int64(-1))
    before = memory.copy()
    ended = trace_bundle(address_of(tree), packet, lanes, int64(CLOSEST), int64(0), int64(0), int64(0))
    return ended, before, (packet - address_of(memory)) // 8


@pytest.mark.parametrize("lanes", [0, 1, 1 << 62, -(1 << 63), 0x0F0F, 0x5555555555555555, -1])
def test_only_the_chosen_rays_are_written(mesh, lanes):
    """Sets of lanes, the top bit among them; no rays at all leave everything as it is."""
    tree = mesh[2]
    directions = np.random.default_rng(63).normal(size=(PACKET, 3))
    memory = clutter()
    ended, before, start = _trace_some(tree.buffer, memory, directions, np.int64(lanes))
    assert ended == 0
    chosen = (np.int64(lanes) >> np.arange(PACKET)) & 1 == 1
    rows = memory[start : start + RAY_ROWS * PACKET].view(np.int64).reshape(RAY_ROWS, PACKET)
    old = before[start : start + RAY_ROWS * PACKET].view(np.int64).reshape(RAY_ROWS, PACKET)
    np.testing.assert_array_equal(rows[:, ~chosen], old[:, ~chosen])
    assert (rows[PRIMITIVE // ROW, chosen] >= 0).all()
    np.testing.assert_array_equal(rows[: T_BEST // ROW, chosen], old[: T_BEST // ROW, chosen])


@pytest.mark.parametrize(
    ("o", "d"),
    [
        ((np.nan, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, np.nan, 1)),
        ((0, 0, 0), (np.nan, np.nan, np.nan)),
        ((0, np.inf, 0), (0, 0, 1)),
        ((0, 0, 0), (0, 0, 0)),
    ],
)
@pytest.mark.parametrize("place", [0, 31, 63])
def test_what_is_no_ray_misses_and_does_no_harm(mesh, o, d, place):
    """N6, among 63 proper rays, as the first of them too."""
    vertices, faces, tree = mesh
    rng = np.random.default_rng(64)
    origins = np.array([0.1, 0.2, 0.3]) + 1e-3 * rng.normal(size=(64, 3))
    directions = np.array([0.2, 0.1, 1.0]) + 1e-3 * rng.normal(size=(64, 3))
    origins[place], directions[place] = o, d
    others = np.arange(64) != place
    found = follow(tree, origins, directions)
    assert found.primitive[place] == -1
    times, primitives, _ = by_brute_force(vertices, faces, origins[others], directions[others])
    np.testing.assert_array_equal(found.primitive[others], primitives)
    np.testing.assert_array_equal(found.t[others], times)
    met = follow(tree, origins, directions, mode="any").ended
    assert met.tolist() == others.tolist()
