"""The mirror box: five walls, a tall block that is a mirror and a low one, with or without a bumpy sphere above it.

Job: one description for us (a scene document, the sphere as a PLY file) and for a peer (arrays in an .npz file).
Invariant: both have the same triangles, camera, light and colours: flat facets seen from both sides, one point light
that does not fall off, an ambient share, planar mirrors. 32 triangles without the sphere.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.rays_meshes import bumpy_sphere

EYE, TARGET, FOV_DEG = (0.0, 1.0, 3.4), (0.0, 1.0, 0.0), 40.0
LIGHT, INTENSITY, AMBIENT = (0.2, 1.85, 0.3), 0.8, 0.1
DEPTH = 3  # mirrors one after another
BIG = 1_308_736  # triangles of the sphere: 4 x 572 x 572
PLY = "sphere.ply"


class Part(NamedTuple):
    """Triangles of one material."""

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    diffuse: tuple[float, float, float]
    mirror: float


def quads(*corners: Any) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Make two triangles for each four corners."""
    points = np.array(corners, np.float32).reshape(-1, 3)
    first = 4 * np.arange(len(points) // 4)[:, None, None]
    return points, (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.int32)


def block(x: float, z: float, half: float, height: float, turn_deg: float, *, bottom: bool) -> Any:
    """Return a turned box on the floor, with its bottom or without."""
    c, s = half * math.cos(math.radians(turn_deg)), half * math.sin(math.radians(turn_deg))
    ring = [(x + c - s, z + s + c), (x - c - s, z - s + c), (x - c + s, z - s - c), (x + c + s, z + s - c)]
    sides = []
    for (x0, z0), (x1, z1) in zip(ring, ring[1:] + ring[:1], strict=True):
        sides += [(x0, 0, z0), (x1, 0, z1), (x1, height, z1), (x0, height, z0)]
    faces = [*sides, *((a, height, b) for a, b in ring)]
    return quads(*faces, *((a, 0.0, b) for a, b in ring)) if bottom else quads(*faces)


def parts(sphere_triangles: int = 0, *, sphere_mirror: float = 0.0, mirror_walls: bool = False) -> list[Part]:
    """Return the scene's parts; ``mirror_walls`` closes the box behind the eye and makes mirrors of its four walls."""
    white, grey = (0.73, 0.73, 0.73), (0.02, 0.02, 0.02)
    side, front = (0.9, 3.6) if mirror_walls else (0.0, 1)
    found = [
        Part(
            "white",
            *quads(
                *((-1, 0, front), (1, 0, front), (1, 0, -1), (-1, 0, -1)),
                *((-1, 2, -1), (1, 2, -1), (1, 2, front), (-1, 2, front)),
            ),
            white,
            0.0,
        ),
        Part("back", *quads((-1, 0, -1), (1, 0, -1), (1, 2, -1), (-1, 2, -1)), white, side),
        Part("red", *quads((-1, 0, front), (-1, 0, -1), (-1, 2, -1), (-1, 2, front)), (0.65, 0.05, 0.05), side),
        Part("green", *quads((1, 0, -1), (1, 0, front), (1, 2, front), (1, 2, -1)), (0.12, 0.45, 0.15), side),
        Part("mirror", *block(-0.42, -0.3, 0.28, 1.2, 18, bottom=True), grey, 0.9),
        Part("low", *block(0.42, 0.25, 0.28, 0.55, -17, bottom=False), (0.7, 0.6, 0.3), 0.0),
    ]
    if mirror_walls:
        found.append(Part("front", *quads((-1, 0, front), (1, 0, front), (1, 2, front), (-1, 2, front)), white, side))
    if sphere_triangles:
        points, faces = bumpy_sphere(max(2, round(math.sqrt(sphere_triangles / 4))))
        points = (0.38 * points + np.array([0.35, 1.1, 0.1])).astype(np.float32)
        found.append(Part("sphere", points, faces.astype(np.int32), (0.3, 0.45, 0.7), sphere_mirror))
    return found


def document(scene: list[Part], size: int, samples: int, *, depth: int = DEPTH, lights: int = 1) -> dict[str, Any]:
    """Return the scene document; a part named "sphere" is the file `PLY` beside it.

    With several lights they stand in a ring below the ceiling and share the intensity.
    """
    ring = [2 * math.pi * k / lights for k in range(lights)]
    places = [LIGHT] if lights == 1 else [(0.7 * math.cos(a), LIGHT[1], 0.7 * math.sin(a)) for a in ring]
    objects: list[dict[str, Any]] = []
    for part in scene:
        if part.name == "sphere":
            objects.append({"type": "mesh_asset", "asset": "sphere", "normals": "flat", "material": "sphere"})
        else:
            positions, faces = part.vertices.astype(float).tolist(), part.faces.tolist()
            objects.append({"type": "mesh", "positions": positions, "faces": faces, "material": part.name})
    return {
        "version": 1,
        "camera": {
            "type": "perspective",
            "fov_deg": FOV_DEG,
            "look_at": {"eye": list(EYE), "target": list(TARGET), "up": [0, 1, 0]},
        },
        "image": {"width": size, "height": size},
        "integrator": {"type": "blinn_phong", "max_depth": depth, "shadows": True},
        "sampling": {"samples": samples},
        "materials": {
            part.name: {"type": "blinn_phong", "ka": list(part.diffuse), "kd": list(part.diffuse), "kr": part.mirror}
            for part in scene
        },
        "lights": [
            {"type": "ambient", "intensity": AMBIENT},
            *({"type": "point", "position": list(p), "diffuse": INTENSITY / lights, "specular": 0} for p in places),
        ],
        "objects": objects,
        "assets": {"sphere": {"file": PLY}} if any(part.name == "sphere" for part in scene) else {},
    }


def write_ply(path: Path, part: Part) -> None:
    """Write a part as a binary PLY file."""
    rows = np.empty(len(part.faces), [("n", "u1"), ("face", "<i4", 3)])
    rows["n"], rows["face"] = 3, part.faces
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(part.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(part.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + part.vertices.astype("<f4").tobytes() + rows.tobytes())


def write_arrays(path: Path, scene: list[Part], size: int, samples: int) -> None:
    """Write the scene for a peer: `vertices0`, `faces0`, ... and what the document says."""
    arrays: dict[str, Any] = {}
    for i, part in enumerate(scene):
        arrays[f"vertices{i}"], arrays[f"faces{i}"] = part.vertices, part.faces
    np.savez(
        path,
        diffuse=np.array([part.diffuse for part in scene], np.float32),
        mirror=np.array([part.mirror for part in scene], np.float32),
        eye=np.array(EYE),
        target=np.array(TARGET),
        light=np.array(LIGHT),
        numbers=np.array([FOV_DEG, INTENSITY, AMBIENT, size, samples, DEPTH], np.float64),
        **arrays,
    )
