"""Meshes and brute force for the tests of the hierarchy."""

import numpy as np

from tracer.accel.traverse import _is_nearer
from tracer.geometry.triangle import intersect_triangle, shear_ray
from tracer.geometry.vector import at
from tracer.jit import kernel, pointer
from tracer.render.tiny import make_scene
from tracer.types import MATERIAL_A, MATERIAL_ETA, MATERIAL_KT, N_MATERIAL, SHAPE_SPHERE


def icosphere(subdivisions, rng=None, jitter=0.0):
    """Vertices (n, 3) and faces of a closed sphere; jitter moves vertices, which keeps it closed."""
    g = (1 + 5**0.5) / 2
    vertices = [(s * a, t * b, 0.0) for a, b in [(1.0, g)] for s in (-1, 1) for t in (-1, 1)]
    vertices = [v[k:] + v[:k] for k in range(3) for v in vertices]
    points = np.array(vertices)
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if all(abs(np.linalg.norm(points[a] - points[b]) - 2.0) < 1e-9 for a, b in [(i, j), (j, k), (k, i)])
    ]
    faces = [f if np.linalg.det(points[list(f)]) > 0 else f[::-1] for f in faces]
    vertices = [tuple(p) for p in points]
    for _ in range(subdivisions):
        middle, finer = {}, []

        def split(a, b, middle=middle, vertices=vertices):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(vertices)
                vertices.append(tuple((np.array(vertices[a]) + np.array(vertices[b])) / 2))
            return middle[key]

        for a, b, c in faces:
            ab, bc, ca = split(a, b), split(b, c), split(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    points = np.array(vertices)
    points /= np.linalg.norm(points, axis=1)[:, None]
    if rng is not None:
        points *= 1.0 + jitter * rng.random((len(points), 1))
    return points, np.array(faces, np.int32)


def scene_of(vertices, faces, *, kt=None, spheres=()):
    """A compiled scene of triangles and spheres; kt (n_faces + n_spheres, 3) gives each a material of its own."""
    n, m = len(faces), len(spheres)
    materials = np.zeros((n + m if kt is not None else 1, N_MATERIAL))
    materials[:, [MATERIAL_A, MATERIAL_ETA]] = 1.0
    if kt is not None:
        materials[:, MATERIAL_KT : MATERIAL_KT + 3] = kt
    own = np.arange(n + m) if kt is not None else np.zeros(n + m)
    radii = np.array([radius for _, radius in spheres]).reshape(-1, 1, 1)
    return make_scene(
        vertex_positions=np.reshape(vertices, (-1, 3)),
        face_vertices=np.reshape(faces, (-1, 3)),
        face_material=own[:n],
        face_flags=np.zeros(n),
        shape_kind=[SHAPE_SPHERE] * m,
        shape_material=own[n:],
        shape_origin=np.array([center for center, _ in spheres]).reshape(-1, 3),
        shape_to_world=np.eye(3) * radii,
        shape_to_local=np.eye(3) / radii,
        materials=materials,
        material_flags=np.tile([-1, 0, 0, 1], (len(materials), 1)),
    )


@kernel
def brute_force(vertices, ids, origins, directions, n_hits, t, primitive):
    """Every triangle for every ray, from the last to the first: the closest by (t, id), and how many have t > 0."""
    for k in range(origins.shape[0]):
        ray = shear_ray(at(pointer(origins), 3 * k), at(pointer(directions), 3 * k))
        best_t = np.inf
        best = np.int64(-1)
        count = 0
        for slot in range(ids.shape[0] - 1, -1, -1):
            found = intersect_triangle(pointer(vertices), slot, ray).t
            if found > 0.0:
                count += 1
            if _is_nearer(found, np.int64(ids[slot]), best_t, best):
                best_t = found
                best = np.int64(ids[slot])
        n_hits[k] = count
        t[k] = best_t
        primitive[k] = best


def trace_brute(scene, origins, directions):
    n = len(origins)
    n_hits, t, primitive = np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64)
    brute_force(scene.bvh_vertices, scene.bvh_slots, origins, directions, n_hits, t, primitive)
    return n_hits, t, primitive
