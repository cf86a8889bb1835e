"""What a scene would take: tiles, samples, rays, memory; what it uses; which files.

Job: answer ``validate_only`` from the document alone, without compiling anything.
Invariant: bounds are upper bounds and sizes are computed; the one guess is the time, and it says so.
"""

import hashlib
import math
from collections import Counter
from collections.abc import Sequence

from service.schemas import Estimate, ImageView
from tracer.scene import AmbientLight, Mesh, MeshAsset, SceneDoc, transform_rows
from tracer.scene.limits import MAX_COORDINATE
from tracer.scene.transforms import determinant
from worker.contract import BLOCK_PX
from worker.grid import TileGrid, choose_tile_size

# Of a compiled scene, per inline triangle: 72 bytes of vertices and indices, about 2 BVH nodes of 64 bytes to three
# triangles, and 100 bytes of normals, UVs and colours where given; rounded up.
_TRIANGLE_BYTES = 320
_VERTEX_BYTES = 24 + 24 + 16 + 24
# Equal meshes share a tree from so many triangles on, and if so many are saved (`tracer.render.parts`). A use then
# takes its map, its part of the tree above (two nodes), and a material for each triangle.
_SHARED_TRIANGLES = 4_096
_SAVED_TRIANGLES = 2**18
_MOST_SKEW = 2.0**20
_PLACEMENT_BYTES = 1024
_MATERIAL_BYTES = 4
# Film of a tile in a worker: two halves of three float64 sums a pixel; in the store: three float32.
_FILM_BYTES_PER_PIXEL = 2 * 3 * 8
_TILE_BYTES_PER_PIXEL = 3 * 4
# Three float32 of the EXR, three bytes of the PNG; compression only makes it less.
_RESULT_BYTES_PER_PIXEL = 12 + 3
# Python, numpy, numba and its kernels in one worker, measured in the trial of the farm.
_WORKER_BYTES = 100 << 20
# About what one core of today traces, rays of all kinds together, where triangles are met in packets. Rough: shapes and
# glass, which are met ray by ray, take several times longer, an empty picture less.
_RAYS_PER_CORE_S = 30e6
# Beside its kernel, a tile costs this much (see `worker.grid`).
_TILE_S = 0.003


def assets_of(scene: SceneDoc) -> dict[str, tuple[str, ...]]:
    """Return the hashes of each asset that the scene uses: the file's first, then its companions'.

    A file without a hash does not occur: the scene was parsed with ``require_hashes``.
    """
    found = {}
    for name in sorted(_used_names(scene)):
        asset = scene.assets[name]
        hashes = [asset.sha256, *(asset.companions or {}).values()]
        found[name] = tuple(sha256 for sha256 in hashes if sha256 is not None)
    return found


def _used_names(scene: SceneDoc) -> set[str]:
    """Names in the assets table that an object or a material refers to; the others are never loaded."""
    used = {thing.asset for thing in scene.objects if isinstance(thing, MeshAsset)}
    textures = (material.diffuse_texture for material in scene.materials.values())
    return used | {texture.asset for texture in textures if texture is not None}


def estimate(scene: SceneDoc, scene_json: bytes, tile_size: int | None) -> Estimate:
    """Return what a scene would take; ``assets_missing`` is left empty, for only the store knows."""
    x, y, width, height = scene.image.rect
    samples_total = width * height * scene.sampling.samples
    tile_size = tile_size or choose_tile_size(x, y, width, height, scene.sampling.samples)
    n_tiles = TileGrid(x, y, width, height, tile_size).n_tiles
    traced = samples_total + _samples_to_decide(scene)
    films = 1 if scene.sampling.adaptive is None else 2  # of the first samples, and of all
    features, skipped = features_of(scene)
    used = _used_names(scene)
    return Estimate(
        scene_sha256=hashlib.sha256(scene_json).hexdigest(),
        image=ImageView(width=scene.image.width, height=scene.image.height),
        samples_per_pixel=scene.sampling.samples,
        samples_total=samples_total,
        rays_at_most=traced * _rays_of_a_path(scene),
        cpu_seconds=_cpu_seconds(traced * _rays_expected(scene), n_tiles),
        tiles=n_tiles,
        memory_bytes=_WORKER_BYTES
        + _mesh_bytes([thing for thing in scene.objects if isinstance(thing, Mesh)])
        + films * min(tile_size, width) * min(tile_size, height) * _FILM_BYTES_PER_PIXEL,
        result_bytes=width * height * _RESULT_BYTES_PER_PIXEL,
        store_bytes=width * height * (_TILE_BYTES_PER_PIXEL + _RESULT_BYTES_PER_PIXEL),
        features=features,
        skipped=skipped,
        assets_missing=[],
        assets_never_loaded=sorted(set(scene.assets) - used),
    )


def _mesh_bytes(meshes: Sequence[Mesh]) -> int:
    """Return the most that inline meshes take; those that certainly share a tree count once."""
    taken = 0
    alike: dict[tuple[int, int], list[Mesh]] = {}
    for mesh in meshes:
        sizes = len(mesh.positions), len(mesh.faces)
        taken += sizes[0] * _VERTEX_BYTES + sizes[1] * _TRIANGLE_BYTES
        alike.setdefault(sizes, []).append(mesh)
    for (n_vertices, n_faces), some in alike.items():
        if n_faces < _SHARED_TRIANGLES or (len(some) - 1) * n_faces < _SAVED_TRIANGLES:
            continue  # before anything is read: this is what nearly all documents are
        # a document's text has no -0.0 once it is canonical, so equal numbers are equal bits
        uses = Counter(_digest(mesh) for mesh in some if _may_move(mesh))
        for n in uses.values():
            if (n - 1) * n_faces >= _SAVED_TRIANGLES:
                taken += n * (_PLACEMENT_BYTES + n_faces * _MATERIAL_BYTES)
                taken -= (n - 1) * (n_vertices * _VERTEX_BYTES + n_faces * _TRIANGLE_BYTES)
    return taken


def _digest(mesh: Mesh) -> bytes:
    """Name a mesh's geometry by its content; materials and transform apart."""
    geometry = (mesh.positions, mesh.faces, mesh.normals, mesh.uvs, mesh.colors)
    return hashlib.sha256(repr(geometry).encode()).digest()


def _may_move(mesh: Mesh) -> bool:
    """Whether a mesh certainly is within what the renderer places instead of baking it.

    The renderer asks for the largest row sum of abs(M) abs(M^-1); an entry of M^-1 is at most 2 m^2 / abs(det M),
    with m the largest of M's, so 6 norm^3 / abs(det M) bounds it.
    """
    rows = transform_rows(mesh.transform)
    norm = max(sum(map(abs, row[:3])) for row in rows[:3])
    sizes = math.prod(max(map(abs, row[:3])) / norm for row in rows[:3])
    farthest = norm * max(abs(x) for point in mesh.positions for x in point) + max(abs(row[3]) for row in rows[:3])
    return _MOST_SKEW * abs(determinant(rows)[0]) * sizes > 6.0 and farthest <= MAX_COORDINATE


def _samples_to_decide(scene: SceneDoc) -> int:
    """Return how many samples adaptive sampling takes to decide: in whole blocks, also where a crop cuts them."""
    if scene.sampling.adaptive is None:
        return 0
    x, y, width, height = scene.image.rect
    ends = (x + width, scene.image.width), (y + height, scene.image.height)
    right, bottom = (min(side, -(-end // BLOCK_PX) * BLOCK_PX) for end, side in ends)
    left, top = x // BLOCK_PX * BLOCK_PX, y // BLOCK_PX * BLOCK_PX
    return (right - left) * (bottom - top) * scene.sampling.adaptive.min_samples


def _rays_of_a_path(scene: SceneDoc) -> int:
    """Return the most rays that one primary ray can cause, itself included.

    At each point a shadow ray to each light, then one reflected and, through a transparent material, one transmitted.
    """
    branches = _branches(scene)
    points: int = sum(branches**level for level in range(scene.integrator.max_depth + 1))
    return points * (1 + _shadow_lights(scene))


def _rays_expected(scene: SceneDoc) -> float:
    """Return how many rays one primary ray causes as a rule, itself included.

    Each bounce is thought to be taken at half of the points: the others are dull, or the ray has left the scene.
    """
    points = sum((_branches(scene) / 2) ** level for level in range(scene.integrator.max_depth + 1))
    return points * (1 + _shadow_lights(scene))


def _branches(scene: SceneDoc) -> int:
    """Return how many rays at most go on from a point: one reflected, one transmitted."""
    materials = scene.materials.values()
    return int(any(any(material.kr) for material in materials)) + int(any(any(material.kt) for material in materials))


def _shadow_lights(scene: SceneDoc) -> int:
    """Return how many lights are asked for at a point."""
    return sum(not isinstance(light, AmbientLight) for light in scene.lights) if scene.integrator.shadows else 0


def _cpu_seconds(rays: float, n_tiles: int) -> float:
    """Return the CPU seconds of this work in two digits: more would promise too much."""
    return float(f"{rays / _RAYS_PER_CORE_S + n_tiles * _TILE_S:.2g}")


def features_of(scene: SceneDoc) -> tuple[list[str], list[str]]:
    """Return the names of what the scene uses and of what it does not, each sorted."""
    materials = scene.materials.values()
    lights = {light.type for light in scene.lights}
    kinds = {thing.type for thing in scene.objects}
    directed = lights - {"ambient"}
    has = {
        "camera:perspective": scene.camera.type == "perspective",
        "camera:view_plane": scene.camera.type == "view_plane",
        "camera:orthographic": scene.camera.type == "orthographic",
        "crop": scene.image.crop is not None,
        "adaptive_sampling": scene.sampling.adaptive is not None,
        "shadows": scene.integrator.shadows and bool(directed),
        "reflection": scene.integrator.max_depth > 0 and any(any(material.kr) for material in materials),
        "transmission": scene.integrator.max_depth > 0 and any(any(material.kt) for material in materials),
        "emission": any(any(material.ke) for material in materials),
        "specular": any(any(material.ks) for material in materials),
        "textures": any(material.diffuse_texture is not None for material in materials),
        "vertex_normals": any(isinstance(thing, Mesh) and thing.normals is not None for thing in scene.objects),
        "vertex_colors": any(isinstance(thing, Mesh) and thing.colors is not None for thing in scene.objects),
        "transforms": any(bool(thing.transform) for thing in scene.objects),
        **{f"light:{name}": name in lights for name in ("ambient", "directional", "point", "spot")},
        **{
            f"object:{name}": name in kinds
            for name in ("mesh", "mesh_asset", "plane", "sphere", "box", "disk", "cylinder")
        },
    }
    return sorted(name for name, used in has.items() if used), sorted(name for name, used in has.items() if not used)
