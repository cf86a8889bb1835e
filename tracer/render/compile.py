"""Compile a scene document and its files into the arrays that the kernels read.

Invariants: the result is a pure function of the document and the files' contents; everything in it is finite and in
range, so that kernels need not look; a fault of the content is a `SceneError` or a `LoadError` with the place in the
document that names it. Files that no object needs are never opened.
"""

import time
from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel import build_tree, join_hierarchies
from tracer.loaders.mesh import MeshData, MeshGroup
from tracer.loaders.uses import flattened, separate
from tracer.render.geometry import (
    PlaneRecord,
    ShapeRecord,
    build_plane,
    build_shape,
    smooth_normals,
)
from tracer.render.materials import MaterialTable, TextureTable, build_lights
from tracer.render.parts import MeshRecord, build_parts
from tracer.render.settings import build_camera, build_limits, build_settings
from tracer.render.solids import find_solids
from tracer.render.sources import SceneFiles
from tracer.scene import (
    AssetResolver,
    Fault,
    Matrix,
    Mesh,
    MeshAsset,
    Plane,
    SceneDoc,
    SceneError,
    transform_rows,
)
from tracer.scene.faults import closest, one_of, pointer_of
from tracer.scene.transforms import multiplied
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    MATERIAL_KT,
    PLACEMENT_END,
    CompiledScene,
    check_layout,
)


class CompileStats(NamedTuple):
    """Figures of one compilation, for the report."""

    load_s: float = 0.0  # reading and checking files
    build_s: float = 0.0  # baking of transforms, and the hierarchies
    total_s: float = 0.0
    n_triangles: int = 0  # placed ones
    n_vertices: int = 0
    n_shapes: int = 0
    n_planes: int = 0
    n_materials: int = 0
    n_textures: int = 0
    n_trees: int = 0
    n_placements: int = 0  # uses of these trees
    n_bytes: int = 0  # of all arrays
    n_bytes_saved: int = 0  # what meshes that share a tree would take if each use were stored
    warnings: tuple[str, ...] = ()
    unused_assets: tuple[str, ...] = ()  # never opened, because nothing refers to them
    from_cache: bool = False


def compile_scene(
    scene: SceneDoc,
    assets: AssetResolver,
    files: SceneFiles | None = None,
    build: Callable[..., NDArray[np.int64]] = build_tree,
) -> tuple[CompiledScene, CompileStats]:
    """Compile a scene.

    Parameters
    ----------
    scene : SceneDoc
    assets : AssetResolver
        Finds the files of the `assets` table.
    files : SceneFiles or None
        Where loaded files come from; a fresh one, without a cache on disk, by default.
    build : callable
        Makes a tree of (vertices, faces): `build_tree`, or a caching one.

    Returns
    -------
    CompiledScene, CompileStats

    Raises
    ------
    SceneError
        A name of the document is unknown in a file, or a transform leaves the range of coordinates.
    LoadError
        A file cannot be used.
    """
    start = time.perf_counter()
    files = files or SceneFiles()
    files.load(scene, assets)
    load_s = time.perf_counter() - start

    textures = TextureTable()
    materials = MaterialTable()
    meshes: list[MeshRecord] = []
    # assets with the normals that objects ask for, taken apart into what is drawn as it is and uses of meshes
    shaped: dict[tuple[str, str], list[tuple[MeshData, Matrix | None]]] = {}
    shapes: list[tuple[ShapeRecord, int]] = []
    planes: list[tuple[PlaneRecord, int]] = []
    for index, thing in enumerate(scene.objects):
        pointer = f"/objects/{index}"
        rows = transform_rows(thing.transform)
        if isinstance(thing, Mesh):
            data = _inline_mesh(thing)
            _check_groups(thing, data, pointer)
            chosen = _choose_materials(scene, thing, data, (), materials, textures, files)
            meshes.append(_mesh_record(data, chosen, rows, pointer))
        elif isinstance(thing, MeshAsset):
            data = files.mesh(thing.asset)
            _check_groups(thing, data, pointer)
            key = (thing.asset, thing.normals)
            if key not in shaped:
                shaped[key] = separate(_with_normals(data, thing.normals))
            for part, there in shaped[key]:
                chosen = _choose_materials(scene, thing, part, (thing.asset,), materials, textures, files)
                place = rows if there is None else multiplied(rows, there)
                meshes.append(_mesh_record(part, chosen, place, pointer))
        else:
            material = _scene_material(scene, thing.material, materials, textures, files)
            if isinstance(thing, Plane):
                planes.append((build_plane(thing, rows, pointer), material))
            else:
                shapes.append((build_shape(thing, rows, pointer), material))

    ambient, lights, light_kind = build_lights(scene.lights)
    finite = _join_shapes(shapes)
    build_start = time.perf_counter()
    parts = build_parts(meshes, build)
    bvh = join_hierarchies(
        parts.trees,
        parts.placements,
        finite["shape_kind"],
        finite["shape_origin"],
        finite["shape_to_world"],
    )
    build_s = time.perf_counter() - build_start
    material_rows, material_flags = materials.arrays()
    texture_rows, texels = textures.arrays()
    lets_through = (material_rows[:, MATERIAL_KT : MATERIAL_KT + 3] != 0.0).any(axis=1)
    opaque = [mesh for mesh in parts.baked if not lets_through[mesh.face_material].any()]
    compiled = CompiledScene(
        settings=build_settings(scene),
        limits=build_limits(scene),
        camera=build_camera(scene),
        background=np.array(scene.background, np.float64),
        ambient=ambient,
        **parts.arrays,
        **finite,
        **_join_planes(planes),
        materials=material_rows,
        material_flags=material_flags,
        textures=texture_rows,
        texels=texels,
        lights=lights,
        light_kind=light_kind,
        **bvh._asdict(),
        solids=find_solids((mesh.positions, mesh.faces) for mesh in opaque),
    )
    check_layout(compiled)
    stats = CompileStats(
        load_s=load_s,
        build_s=build_s,
        total_s=time.perf_counter() - start,
        n_triangles=int(compiled.placements[-1, PLACEMENT_END]),
        n_vertices=len(compiled.vertex_positions),
        n_shapes=len(compiled.shape_kind),
        n_planes=len(compiled.plane_material),
        n_materials=len(compiled.materials),
        n_textures=len(compiled.textures),
        n_trees=len(parts.trees),
        n_placements=len(parts.placements),
        n_bytes=sum(array.nbytes for array in compiled),
        n_bytes_saved=parts.saved_bytes,
        warnings=files.warnings(),
        unused_assets=tuple(sorted(set(scene.assets) - files.used)),
    )
    return compiled, stats


# --- materials --------------------------------------------------------------------------------------------------------


def _scene_material(
    scene: SceneDoc, name: str | None, materials: MaterialTable, textures: TextureTable, files: SceneFiles
) -> int:
    """Return the row of a material of the document; None is the default grey."""
    if name is None:
        return 0
    key: Hashable = ("scene", name)
    row = materials.find(key)
    if row is None:
        material = scene.materials[name]
        texture = -1
        if material.diffuse_texture is not None:
            asset = material.diffuse_texture.asset
            texture = textures.add(("asset", asset), files.image(asset), material.diffuse_texture.color_space)
        row = materials.add_scene_material(key, material, texture)
    return row


def _file_material(
    data: MeshData, index: int, key: tuple[str, ...], materials: MaterialTable, textures: TextureTable
) -> int:
    """Return the row of a file's own material; -1 is the default grey."""
    if index < 0:
        return 0
    full_key: Hashable = ("file", key, index)
    row = materials.find(full_key)
    if row is None:
        material = data.materials[index]
        texture = -1
        if material.image >= 0:
            texture = textures.add(("file", key, material.image), data.images[material.image], "srgb")
        row = materials.add_file_material(full_key, material, texture)
    return row


def _check_groups(thing: Mesh | MeshAsset, data: MeshData, pointer: str) -> None:
    """Refuse materials of groups that the mesh has not."""
    choices: Mapping[str, str] = thing.materials or {}
    known = dict.fromkeys(name for group in data.groups for name in group.names if name)
    unknown = [name for name in choices if name not in known]
    if unknown:
        raise SceneError(
            Fault(
                pointer + pointer_of("materials", name),
                f'names a group that the mesh has not, "{name}"{closest(name, known)}',
                one_of(known),
            )
            for name in unknown
        )


def _choose_materials(
    scene: SceneDoc,
    thing: Mesh | MeshAsset,
    data: MeshData,
    key: tuple[str, ...],
    materials: MaterialTable,
    textures: TextureTable,
    files: SceneFiles,
) -> NDArray[np.int32]:
    """Return each face's row: the object's choice for the group, for the object, the file's own, the default grey."""
    choices: Mapping[str, str] = thing.materials or {}

    def row_of(group: MeshGroup) -> int:
        for name in group.names:
            if name in choices:
                return _scene_material(scene, choices[name], materials, textures, files)
        if thing.material is not None:
            return _scene_material(scene, thing.material, materials, textures, files)
        return _file_material(data, group.material, key, materials, textures)

    in_use = np.bincount(data.face_group, minlength=len(data.groups)) > 0
    rows = [row_of(group) if in_use[index] else 0 for index, group in enumerate(data.groups)]
    return np.array(rows, np.int32)[data.face_group]


# --- meshes -----------------------------------------------------------------------------------------------------------


def _inline_mesh(mesh: Mesh) -> MeshData:
    """Return a mesh of the document in the form of a loaded one; the document has been checked."""
    faces = np.array(mesh.faces, np.int32).reshape(-1, 3)
    groups = [MeshGroup(())]
    face_group = np.zeros(len(faces), np.int32)
    for name, (first, end) in (mesh.groups or {}).items():
        face_group[first:end] = len(groups)
        groups.append(MeshGroup((name,)))
    flags = FACE_HAS_NORMALS * (mesh.normals is not None)
    flags |= FACE_HAS_UVS * (mesh.uvs is not None)
    flags |= FACE_HAS_COLORS * (mesh.colors is not None)
    return MeshData(
        positions=np.array(mesh.positions, np.float64).reshape(-1, 3),
        faces=faces,
        normals=None if mesh.normals is None else np.array(mesh.normals, np.float64).reshape(-1, 3),
        uvs=None if mesh.uvs is None else np.array(mesh.uvs, np.float64).reshape(-1, 2),
        colors=None if mesh.colors is None else np.array(mesh.colors, np.float64).reshape(-1, 3),
        face_flags=np.full(len(faces), flags, np.uint8),
        face_group=face_group,
        groups=tuple(groups),
        materials=(),
        images=(),
        warnings=(),
    )


def _with_normals(data: MeshData, normals_from: str) -> MeshData:
    """Give a loaded mesh the normals that an object asks for."""
    if normals_from == "file":
        return data
    flags = data.face_flags & np.uint8(0xFF ^ FACE_HAS_NORMALS)
    if normals_from == "flat":
        return data._replace(normals=None, face_flags=flags)
    if data.uses:  # what meets at a place is smoothed there, whichever uses it belongs to
        data = flattened(data)
        flags = data.face_flags & np.uint8(0xFF ^ FACE_HAS_NORMALS)
    normals = smooth_normals(data.positions, data.faces)
    has_normal = (normals[data.faces] != 0.0).any(axis=2).all(axis=1)
    flags[has_normal] |= np.uint8(FACE_HAS_NORMALS)
    return data._replace(normals=normals, face_flags=flags)


def _mesh_record(data: MeshData, face_material: NDArray[np.int32], rows: Matrix, pointer: str) -> MeshRecord:
    """Take what rendering needs of a mesh."""
    return MeshRecord(
        data.positions, data.normals, data.uvs, data.colors, data.faces, data.face_flags, face_material, rows, pointer
    )


def _join_shapes(shapes: list[tuple[ShapeRecord, int]]) -> dict[str, NDArray[Any]]:
    """Stack the finite shapes."""
    return {
        "shape_kind": np.array([shape.kind for shape, _ in shapes], np.int32),
        "shape_material": np.array([material for _, material in shapes], np.int32),
        "shape_origin": np.array([shape.origin for shape, _ in shapes], np.float64).reshape(-1, 3),
        "shape_to_world": np.array([shape.to_world for shape, _ in shapes], np.float64).reshape(-1, 3, 3),
        "shape_to_local": np.array([shape.to_local for shape, _ in shapes], np.float64).reshape(-1, 3, 3),
    }


def _join_planes(planes: list[tuple[PlaneRecord, int]]) -> dict[str, NDArray[Any]]:
    """Stack the infinite planes."""
    return {
        "plane_point": np.array([plane.point for plane, _ in planes], np.float64).reshape(-1, 3),
        "plane_normal": np.array([plane.normal for plane, _ in planes], np.float64).reshape(-1, 3),
        "plane_uv": np.array([plane.uv for plane, _ in planes], np.float64).reshape(-1, 2, 3),
        "plane_material": np.array([material for _, material in planes], np.int32),
    }
