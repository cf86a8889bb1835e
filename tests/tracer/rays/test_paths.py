"""Every path gives the same answers, bit for bit: t, primitive, u and v, whether anything is met, how often.

The paths are held against each other here; brute force is their oracle in tests/numerics.
"""

import numpy as np
import pytest

from tests.numerics.closed_meshes import cube
from tracer.rays import RayCaster
from tracer.rays.caster import CHUNK, Hits, checked_rays
from tracer.rays.leaf import ANY, CLOSEST, COUNT
from tracer.rays.single import trace_single
from tracer.rays.stream import IN_FLIGHT, follow_all, trace_stream

PATHS = {"single": trace_single, "stream": trace_stream}


def bumpy(n, dtype=np.float64):
    """A closed bumpy sphere of 4 n n triangles with shared poles' seams, in a box of twelve more."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    r = 1 + 0.2 * np.sin(5 * theta) * np.cos(7 * phi)
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    i, j = np.meshgrid(np.arange(n), np.arange(2 * n), indexing="ij")
    a = (i * (2 * n + 1) + j).ravel()
    below = a + 2 * n + 1
    faces = np.concatenate([np.stack([a, below, a + 1], -1), np.stack([a + 1, below, below + 1], -1)])
    corners, walls = cube()
    vertices = np.concatenate([2.0 * corners, (r[..., None] * points).reshape(-1, 3)])
    return vertices.astype(dtype), np.concatenate([walls, faces + 8])


def answers(path, caster, rays, start=0, end=None):
    """All that a path has to say about rays start..end; rows it must not touch are -7."""
    n = rays.n
    end = n if end is None else end
    found = []
    for mode in (CLOSEST, ANY, COUNT):
        hits = Hits(np.full(n, -7.0), np.full(n, -7, np.int32), np.full(n, -7.0), np.full(n, -7.0))
        path(caster.bvh.buffer, rays.packed, start, end, mode, *hits)
        found += hits if mode == CLOSEST else [hits.primitive]
    return found


def assert_paths_agree(caster, *given):
    rays = checked_rays(*given)
    plain = answers(trace_single, caster, rays)
    for one, other in zip(plain, answers(trace_stream, caster, rays), strict=True):
        np.testing.assert_array_equal(one, other)
    return plain


def adversarial(vertices, faces, n, rng):
    """Rays from inside, outside and the surface; at vertices, along edges and axes; and what is no ray."""
    face = faces[rng.integers(0, len(faces), n)]
    a, b, c = (vertices[face[:, k]].astype(np.float64) for k in range(3))
    weights = rng.dirichlet((1, 1, 1), n)
    on_surface = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
    origins = np.where(rng.random((n, 1)) < 0.5, on_surface, rng.normal(size=(n, 3)))
    target = np.choose(rng.integers(0, 4, n)[:, None], [a, (a + b) / 2, a * 0.3 + b * 0.7, rng.normal(size=(n, 3))])
    directions = target - origins
    kind = rng.integers(0, 20, n)
    axis = np.zeros((n, 3))
    axis[np.arange(n), rng.integers(0, 3, n)] = rng.choice([-1.0, 1.0], n)
    directions[kind < 3] = axis[kind < 3]
    origins[kind == 0] = a[kind == 0]
    origins[kind == 3] *= 10.0 ** rng.uniform(1, 90, (n, 1))[kind == 3]
    directions[kind == 4] *= 1e-200
    directions[kind == 5] *= 1e200
    directions[kind == 6] = 0.0
    origins[kind == 7] = np.nan
    directions[kind == 8, 1] = np.inf
    t_min = np.where(rng.random(n) < 0.8, 0.0, rng.normal(size=n))
    t_max = np.where(rng.random(n) < 0.8, np.inf, rng.normal(size=n) * 2)
    return origins, directions, t_min, t_max


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_on_adversarial_rays(dtype):
    vertices, faces = bumpy(24, dtype)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(41)
    t, primitive, _u, _v, any_met, counts = assert_paths_agree(caster, *adversarial(vertices, faces, 6000, rng))
    np.testing.assert_array_equal(any_met != 0, primitive >= 0)
    np.testing.assert_array_equal(counts > 0, primitive >= 0)
    np.testing.assert_array_equal(np.isfinite(t), primitive >= 0)
    assert 0.2 < any_met.mean() < 0.95


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1e-6), (1e5, 1.0), (1e9, 1e6), (0.0, 1e-80), (3.0, 1e60)])
def test_at_other_places_and_scales(offset, scale):
    """Where float32 sifts nothing out, and where its products leave its range."""
    vertices, faces = bumpy(10)
    rng = np.random.default_rng(42)
    origins, directions, t_min, t_max = adversarial(vertices, faces, 1500, rng)
    shift = np.array([1.0, -0.6, 0.3]) * offset
    caster = RayCaster((vertices + shift) * scale, faces)
    *_, counts = assert_paths_agree(caster, (origins + shift) * scale, directions * scale, t_min, t_max)
    assert counts.max() > 1


def test_coincident_triangles():
    vertices, faces = bumpy(8)
    doubled = np.concatenate([faces, faces[:, [2, 0, 1]], faces])
    rng = np.random.default_rng(43)
    _t, primitive, *_ = assert_paths_agree(RayCaster(vertices, doubled), *adversarial(vertices, faces, 2000, rng))
    assert primitive.max() < len(faces)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 8, IN_FLIGHT - 1, IN_FLIGHT, IN_FLIGHT + 1, 3 * IN_FLIGHT + 2])
def test_batches_of_any_size(n):
    """A ray's answer is its own, whatever else is in flight; rows that were not asked for are not touched."""
    vertices, faces = bumpy(12)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(44)
    origins, directions = rng.normal(size=(n + 5, 3)), rng.normal(size=(n + 5, 3))
    rays = checked_rays(origins, directions, 0.0, np.inf)
    whole = answers(trace_single, caster, rays)
    for path in PATHS.values():
        for one, part in zip(whole, answers(path, caster, rays, 2, n + 2), strict=True):
            np.testing.assert_array_equal(one[2 : n + 2], part[2 : n + 2])
            assert (part[:2] == -7).all()
            assert (part[n + 2 :] == -7).all()


@pytest.mark.parametrize("n", [1, 9, 70, 600, 5000])
def test_every_box_is_met_on_the_way(n):
    """As many children wait on the stacks as ever can in a tree of that depth, in all stacks at once."""
    triangle = np.array([[-3.0, -3, 0], [3, -3, 0], [0, 3, 0]])
    vertices = (triangle + np.arange(n)[:, None, None] * [0, 0, 1.0 / n]).reshape(-1, 3)
    caster = RayCaster(vertices, np.arange(3 * n).reshape(n, 3))
    rng = np.random.default_rng(5)
    origins = np.column_stack([rng.uniform(-0.5, 0.5, (100, 2)), rng.choice([-1.0, 2.0], 100)])
    directions = np.column_stack([rng.uniform(-0.1, 0.1, (100, 2)), np.sign(0.5 - origins[:, 2])])
    found = assert_paths_agree(caster, origins, directions, 0.0, np.inf)
    assert (found[-1] == n).all()


def test_types_mixed_and_read_only():
    vertices, faces = bumpy(12)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(45)
    origins = rng.normal(size=(300, 3)).astype(np.float32)
    directions = rng.normal(size=(300, 3)).astype(np.float32)
    origins.flags.writeable = False
    reference = caster.closest_hit(origins, directions)
    for kinds in ((np.float32, np.float64), (np.float64, np.float32), (np.float64, np.float64)):
        hits = caster.closest_hit(origins.astype(kinds[0]), directions.astype(kinds[1]), np.zeros(300), [np.inf])
        for one, other in zip(reference, hits, strict=True):
            np.testing.assert_array_equal(one, other)
    packed = np.zeros(300 * 25 + 1, np.uint8)[1:].view(np.dtype([("skip", "u1"), ("o", "f8", 3)]))  # not aligned
    packed["o"] = origins
    np.testing.assert_array_equal(caster.closest_hit(packed["o"], directions).t, reference.t)


def test_from_far_away_with_a_long_direction():
    """So far off that boxes decide nothing: a direction of length 2 and more lost every hit once."""
    vertices, faces = bumpy(6)
    caster = RayCaster(vertices, faces)
    origins = np.array([[-1e20, 0.1, 0.2]] * 6)
    directions = np.zeros((6, 3))
    directions[:, 0] = [1.0, 2.0, 3.0, 1e9, 1e300, 1e-9]
    for mode in (CLOSEST, ANY, COUNT):
        rays = checked_rays(origins, directions, 0.0, np.inf)
        for path in PATHS.values():
            hits = Hits(np.empty(6), np.empty(6, np.int32), np.empty(6), np.empty(6))
            path(caster.bvh.buffer, rays.packed, 0, 6, mode, *hits)
            if mode == CLOSEST:
                assert (hits.primitive >= 0).all()
            else:
                assert (hits.primitive > 0).all()


def test_chunks_on_threads():
    """However the chunks are spread over threads: the same answers."""
    vertices, faces = bumpy(16)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(46)
    n = 3 * CHUNK + 100
    origins, directions = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    reference = caster.closest_hit(origins, directions)
    for one, other in zip(reference, caster.closest_hit(origins, directions, threads=2), strict=True):
        np.testing.assert_array_equal(one, other)


def test_listed_rays():
    """The stream answers those of a list, in its order, and touches no others."""
    vertices, faces = bumpy(16)
    caster = RayCaster(vertices, faces)
    rays = checked_rays(*adversarial(vertices, faces, 500, np.random.default_rng(47)))
    plain = answers(trace_single, caster, rays)
    listed = np.random.default_rng(48).permutation(500)[:333].astype(np.int64)
    hits = Hits(np.full(500, -7.0), np.full(500, -7, np.int32), np.full(500, -7.0), np.full(500, -7.0))
    outputs = tuple(array.ctypes.data for array in hits)
    follow_all(caster.bvh.buffer.ctypes.data, rays.packed, (0, 0, 0, 0), listed.ctypes.data, 3, 333, CLOSEST, outputs)
    for one, other in zip(plain[:4], hits, strict=True):
        np.testing.assert_array_equal(one[listed[3:]], other[listed[3:]])
        assert (np.delete(other, listed[3:]) == -7).all()


@pytest.mark.parametrize("mesh", ["tetrahedron", "bumpy"])
def test_any_power_of_two(mesh):
    """Lengths times 2^k change no bit of an answer, wherever float32 overflows or underflows on the way."""
    if mesh == "bumpy":
        vertices, faces = bumpy(16)
    else:
        vertices = np.array([[9.0, 0.0, -1.0], [-5.0, 8.0, -1.0], [-5.0, -8.0, -1.0], [0.0, 0.0, 9.0]])
        faces = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    rng = np.random.default_rng(49)
    n = 500
    origins, directions = 0.1 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    nearest = np.where(rng.random(n) < 0.5, 0.0, rng.uniform(0.0, 12.0, n))
    few = slice(0, 50)  # too few for other paths than the stream

    def ask(k):
        caster = RayCaster(vertices * 2.0**k, faces)
        o, tmin = origins * 2.0**k, nearest * 2.0**k
        found = caster.count_hits(o, directions, tmin=tmin), caster.count_hits(o, directions)
        for part in (slice(None), few):
            hits = caster.closest_hit(o[part], directions[part], tmin=tmin[part])
            found += hits.t * 2.0**-k, hits.primitive, hits.u, hits.v
            found += (caster.any_hit(o[part], directions[part], tmin=tmin[part]),)
        return found

    plain = ask(0)
    assert (plain[1] > 0).all()
    for k in range(-100, 101):
        for one, other in zip(plain, ask(k), strict=True):
            np.testing.assert_array_equal(one, other, err_msg=f"2^{k}")
