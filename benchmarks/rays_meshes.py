"""The five meshes of `benchmarks.rays`, each in a box of twelve triangles, and the rays that are cast at them.

Invariant: the same arrays on every machine, but for what numpy's sine and random numbers round differently.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]
LIGHT = np.array([0.2, 1.2, -0.3])
EYE = np.array([0.0, 0.35, -1.55])


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Any, Any]:
    """Twelve triangles."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])


def lattice(n: int, m: int) -> NDArray[np.int64]:
    """Two triangles for each cell of a grid of (n + 1) x (m + 1) vertices."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a = (i * (m + 1) + j).ravel()
    return np.concatenate([np.stack([a, a + m + 1, a + 1], -1), np.stack([a + 1, a + m + 1, a + m + 2], -1)])


def bumpy_sphere(n: int) -> tuple[Any, Any]:
    """4 n**2 triangles."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    r = 1 + 0.03 * np.sin(17 * theta) * np.cos(23 * phi)
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    return (r[..., None] * points).reshape(-1, 3), lattice(n, 2 * n)


def terrain(n: int) -> tuple[Any, Any]:
    """2 n**2 triangles."""
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, n + 1), np.linspace(-1.5, 1.5, n + 1), indexing="ij")
    z = 0.15 * np.sin(5 * x) * np.cos(4 * y) + 0.04 * np.sin(23 * x + 1) * np.cos(31 * y)
    z += 0.01 * np.sin(97 * x) * np.sin(89 * y) - 0.5
    return np.stack([x, z, y], -1).reshape(-1, 3), lattice(n, n)


def soup(n: int) -> tuple[Any, Any]:
    """Draw n small random triangles."""
    rng = np.random.default_rng(1)
    centres = rng.uniform(-1.4, 1.4, (n, 1, 3))
    return (centres + rng.normal(size=(n, 3, 3)) * 0.02).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def in_a_box(*parts: tuple[Any, Any]) -> Mesh:
    """Join meshes with a box around them."""
    vertices, faces, count = [], [], 0
    for points, triangles in (box((-1.6, -1.6, -1.6), (1.6, 1.6, 1.6)), *parts):
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32)


MESHES: dict[str, Callable[[], Mesh]] = {
    "cornell": lambda: in_a_box(box((-0.6, -1.6, -0.5), (-0.1, 0.2, 0.1)), box((0.1, -1.6, -0.1), (0.6, -0.4, 0.5))),
    "sphere-80k": lambda: in_a_box(bumpy_sphere(142)),
    "sphere-1.3m": lambda: in_a_box(bumpy_sphere(572)),
    "terrain-1m": lambda: in_a_box(terrain(707)),
    "soup-200k": lambda: in_a_box(soup(200_000)),
}


def primary_rays(n: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Aim about n rays from the eye in scan order."""
    side = math.isqrt(n)
    y, x = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    u, v = (x + 0.5) / side * 2 - 1, 1 - (y + 0.5) / side * 2
    directions = np.stack([u * 0.75, v * 0.75 - 0.15, np.ones_like(u)], -1).reshape(-1, 3).astype(np.float32)
    return np.broadcast_to(EYE.astype(np.float32), directions.shape).copy(), directions


def secondary_rays(mesh: Mesh, caster: Any, origins: Any, directions: Any) -> tuple[Any, Any, Any]:
    """Return (points a little off where primary rays hit, cosine bounces, directions to the light).

    ``caster`` is a `tracer.rays.RayCaster` of the mesh.
    """
    vertices, faces = mesh
    hits = caster.closest_hit(origins, directions)
    met = hits.primitive >= 0
    points = (origins + hits.t[:, None] * directions)[met]
    a, b, c = (vertices[faces[hits.primitive[met], k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    normals[(normals * directions[met]).sum(1) > 0] *= -1
    points = (points + normals * 1e-4).astype(np.float32)
    on_sphere = np.random.default_rng(0).normal(size=points.shape)
    on_sphere /= np.linalg.norm(on_sphere, axis=1, keepdims=True)
    return points, (normals + 0.999 * on_sphere).astype(np.float32), (LIGHT - points).astype(np.float32)
