"""Closed meshes, rays aimed at their weakest places, and brute force: for the tests of the ray caster."""

import math

import numpy as np

from tracer.accel.emit import sorted_order
from tracer.jit import kernel
from tracer.rays.predicate import intersect_triangle, shear_of, unit_of

LARGEST = 1.7976931348623157e308  # of float64


def sphere(n_theta=16, n_phi=16, seed=3, bumpy=5.0):
    """A star-shaped closed surface of radius 1 .. 1 + bumpy, its poles shared; the origin is inside."""
    rng = np.random.default_rng(seed)
    rows = [[0.0, 0.0, 1.0]]
    for i in range(1, n_theta):
        for j in range(n_phi):
            theta, phi, r = math.pi * i / n_theta, 2 * math.pi * j / n_phi, 1 + bumpy * rng.random()
            rows.append([r * math.sin(theta) * math.cos(phi), r * math.sin(theta) * math.sin(phi), r * math.cos(theta)])
    rows.append([0.0, 0.0, -1.0])
    ring = lambda i, j: 1 + (i - 1) * n_phi + j % n_phi  # noqa: E731
    last = len(rows) - 1
    faces = []
    for j in range(n_phi):
        faces.append([0, ring(1, j), ring(1, j + 1)])
        for i in range(1, n_theta - 1):
            a, b, c, d = ring(i, j), ring(i, j + 1), ring(i + 1, j), ring(i + 1, j + 1)
            faces += [[a, c, d], [a, d, b]]
        faces.append([ring(n_theta - 1, j), last, ring(n_theta - 1, j + 1)])
    return np.array(rows), np.array(faces, np.int32)


def torus(n=24, m=12):
    """A torus around z through (1, 0, 0), of tube radius 0.4; (1, 0, 0) is inside."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * i / n, 2 * np.pi * j / m
    r = 1 + 0.4 * np.cos(b)
    vertices = np.stack([r * np.cos(a), r * np.sin(a), 0.4 * np.sin(b)], -1).reshape(-1, 3)
    corner = lambda di, dj: (((i + di) % n) * m + (j + dj) % m).ravel()  # noqa: E731
    faces = [
        np.stack([corner(0, 0), corner(1, 0), corner(1, 1)], -1),
        np.stack([corner(0, 0), corner(1, 1), corner(0, 1)], -1),
    ]
    return vertices, np.concatenate(faces).astype(np.int32)


def needle():
    """A tetrahedron a million times longer than wide."""
    vertices = np.array([[0.0, 0, 1], [1e-6, 0, 0], [-1e-6, 1e-6, 0], [-1e-6, -1e-6, 0]]) - [0, 0, 0.25]
    return vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32)


def fan(n=256):
    """Two cones of 256 triangles each on one circle: vertices of very high valence."""
    a = 2 * np.pi * np.arange(n) / n
    rim = np.stack([np.cos(a), np.sin(a), 0 * a], -1)
    vertices = np.concatenate([rim, [[0, 0, 0.3], [0, 0, -0.3]]])
    k = np.arange(n)
    faces = [np.stack([k, (k + 1) % n, 0 * k + n], -1), np.stack([(k + 1) % n, k, 0 * k + n + 1], -1)]
    return vertices, np.concatenate(faces).astype(np.int32)


def flat_boxes():
    """Axis-aligned squares at many depths of the three axes: every box is flat, and many share planes with origins."""
    vertices, faces = [], []
    for axis in range(3):
        for depth in (-1.0, -0.5, 0.0, 0.5, 1.0):
            for u in (-1.0, 0.0):
                for v in (-1.0, 0.0):
                    corner = np.zeros((4, 3))
                    corner[:, axis] = depth
                    corner[:, (axis + 1) % 3] = [u, u + 1, u + 1, u]
                    corner[:, (axis + 2) % 3] = [v, v, v + 1, v + 1]
                    k = 4 * len(vertices)
                    vertices.append(corner)
                    faces += [[k, k + 1, k + 2], [k, k + 2, k + 3]]
    return np.concatenate(vertices), np.array(faces, np.int32)


def cube():
    """The cube from -1 to 1: its corners, x slowest, and two triangles for each side, one after the other."""
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.int32)


MESHES = {
    "sphere": (sphere, [0.0, 0.0, 0.0], 0.5),
    "torus": (torus, [1.0, 0.0, 0.0], 0.2),
    "needle": (needle, [0.0, 0.0, 0.0], 1e-8),
    "fan": (fan, [0.0, 0.0, 0.0], 0.05),
}


def mix(rng):
    """A few of these meshes, coarse and fine, large and tiny, among loose triangles in a box 10 wide, in random order."""
    loose = rng.uniform(-5, 5, (40, 1, 3)) + rng.uniform(-1, 1, (40, 3, 3)) * rng.choice([0.2, 1.0, 4.0], (40, 1, 1))
    pieces = [(loose.reshape(-1, 3), np.arange(120).reshape(-1, 3))]
    for limit in rng.choice([16, 64, 256], rng.integers(1, 4)):
        n, m = rng.integers(4, limit, 2)
        vertices, faces = torus(n, m) if limit > 64 or rng.random() < 0.5 else sphere(n, m, rng.integers(1000), 0.2)
        pieces.append((vertices * 10.0 ** rng.uniform(-4, 0.5, rng.choice([1, 3])) + rng.uniform(-5, 5, 3), faces))
    first = np.cumsum([0] + [len(vertices) for vertices, _ in pieces])
    faces = np.concatenate([faces + at for (_, faces), at in zip(pieces, first, strict=False)]).astype(np.int32)
    return np.concatenate([vertices for vertices, _ in pieces]), rng.permutation(faces)


AIMS = ("random", "vertex", "edge", "middle", "axis", "plane")


def rays_from_inside(vertices, faces, aim, n, rng, centre, reach):
    """Rays that start within ``reach`` of ``centre``, aimed where a mesh leaks."""
    origins = centre + (rng.random((n, 3)) * 2 - 1) * (reach / math.sqrt(3))
    face = faces[rng.integers(0, len(faces), n)]
    k = rng.integers(0, 3, n)
    a, b = vertices[face[np.arange(n), k]], vertices[face[np.arange(n), (k + 1) % 3]]
    if aim == "random":
        return origins, rng.normal(size=(n, 3))
    if aim == "vertex":
        return origins, a - origins
    if aim == "edge":
        w = rng.random((n, 1))
        return origins, (a * (1 - w) + b * w) - origins
    if aim == "middle":
        origins = np.broadcast_to(np.asarray(centre), (n, 3)).copy()
        return origins, (a * 0.5 + b * 0.5) - origins
    if aim == "axis":
        directions = rng.choice([0.0, -0.0], (n, 3))
        directions[np.arange(n), rng.integers(0, 3, n)] = rng.choice([-1.0, 1.0], n)
        return origins, directions
    # in the plane of a face: origin and target on the line through two of its edges' points, as far as floats go
    c = vertices[face[np.arange(n), (k + 2) % 3]]
    target = a + (b - a) * rng.random((n, 1)) + (c - a) * rng.random((n, 1))
    origins = origins + 0.0
    return origins, target - origins


@kernel
def brute_force(vertices, faces, origins, directions, t_min, t_max, times, primitives, counts):
    """Every face against every ray by the scalar predicate, in the order (t, id)."""
    for i in range(origins.shape[0]):
        unit = unit_of(directions[i, 0], directions[i, 1], directions[i, 2])
        d0, d1, d2 = directions[i, 0] * unit, directions[i, 1] * unit, directions[i, 2] * unit
        kx, ky, kz, sx, sy, sz = shear_of(d0, d1, d2)
        first = max(t_min[i], 0.0) / unit
        last = min(t_max[i], LARGEST) / unit  # a t beyond float64 is no hit
        best = last
        primitive = -1
        count = 0
        for f in range(faces.shape[0]):
            a, b, c, _ = sorted_order(vertices, faces[f, 0], faces[f, 1], faces[f, 2])
            met, t, _u, _v, _w = intersect_triangle(
                vertices[a, kx], vertices[a, ky], vertices[a, kz],
                vertices[b, kx], vertices[b, ky], vertices[b, kz],
                vertices[c, kx], vertices[c, ky], vertices[c, kz],
                origins[i, kx], origins[i, ky], origins[i, kz], sx, sy, sz,
            )  # fmt: skip
            if met and t > first and t < last:
                count += 1
                if t < best:
                    best = t
                    primitive = f
        times[i] = best * unit if primitive >= 0 else np.inf
        primitives[i] = primitive
        counts[i] = count


def by_brute_force(vertices, faces, origins, directions, t_min=0.0, t_max=np.inf):
    """(t, primitive, crossings) of each ray; limits are scalars or (n,)."""
    n = len(origins)
    limits = [np.ascontiguousarray(np.broadcast_to(np.asarray(limit, np.float64), n)) for limit in (t_min, t_max)]
    times, primitives, counts = np.empty(n), np.empty(n, np.int64), np.empty(n, np.int64)
    vertices, directions = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(directions, np.float64)
    origins = np.ascontiguousarray(origins, np.float64)
    brute_force(vertices, faces, origins, directions, *limits, times, primitives, counts)
    return times, primitives, counts
