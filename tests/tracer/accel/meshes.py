"""Meshes and brute force for the tests of the hierarchy."""

import numpy as np

from tests.numerics.closed_meshes import by_brute_force
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


def trace_brute(scene, origins, directions):
    """(Triangles met with t > 0, least t, its id) of each ray, by the scalar predicate."""
    t, primitive, n_hits = by_brute_force(scene.vertex_positions, scene.face_vertices, origins, directions)
    return n_hits, t, primitive
