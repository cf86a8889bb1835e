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

from tracer.accel import build_bvh
from tracer.loaders.mesh import MeshData, MeshGroup
from tracer.render.geometry import (
    PlaneRecord,
    ShapeRecord,
    build_plane,
    build_shape,
    check_range,
    is_mirroring,
    smooth_normals,
    transform_normals,
    transform_points,
)
from tracer.render.materials import MaterialTable, TextureTable, build_lights
from tracer.render.settings import build_camera, build_limits, build_settings
from tracer.render.sources import SceneFiles
from tracer.scene import (
    IDENTITY,
    AssetResolver,
    Fault,
    Mesh,
    MeshAsset,
    Plane,
    SceneDoc,
    SceneError,
    transform_rows,
)
from tracer.scene.faults import closest, one_of, pointer_of
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    Bvh,
    CompiledScene,
    check_layout,
)


class CompileStats(NamedTuple):
    """Figures of one compilation, for the report."""

    load_s: float = 0.0  # reading and checking files
    build_s: float = 0.0  # the hierarchy
    total_s: float = 0.0
    n_triangles: int = 0
    n_vertices: int = 0
    n_shapes: int = 0
    n_planes: int = 0
    n_materials: int = 0
    n_textures: int = 0
    n_bytes: int = 0  # of all arrays
    warnings: tuple[str, ...] = ()
    unused_assets: tuple[str, ...] = ()  # never opened, because nothing refers to them
    from_cache: bool = False


class _MeshRecord(NamedTuple):
    """One object's triangles in world space."""

    positions: NDArray[np.float64]
    normals: NDArray[np.float64] | None
    uvs: NDArray[np.float64] | None
    colors: NDArray[np.float64] | None
    faces: NDArray[np.int32]
    flags: NDArray[np.uint8]
    face_material: NDArray[np.int32]


def compile_scene(
    scene: SceneDoc,
    assets: AssetResolver,
    files: SceneFiles | None = None,
    build: Callable[..., Bvh] = build_bvh,
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
        Builds the hierarchy: `build_bvh`, or a caching one.

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
    meshes: list[_MeshRecord] = []
    shapes: list[tuple[ShapeRecord, int]] = []
    planes: list[tuple[PlaneRecord, int]] = []
    for index, thing in enumerate(scene.objects):
        pointer = f"/objects/{index}"
        rows = transform_rows(thing.transform)
        if isinstance(thing, Mesh):
            data = _inline_mesh(thing)
            chosen = _choose_materials(scene, thing, data, (), pointer, materials, textures, files)
            meshes.append(_place_mesh(thing, data, "file", chosen, pointer))
        elif isinstance(thing, MeshAsset):
            data = files.mesh(thing.asset)
            chosen = _choose_materials(scene, thing, data, (thing.asset,), pointer, materials, textures, files)
            meshes.append(_place_mesh(thing, data, thing.normals, chosen, pointer))
        else:
            material = _scene_material(scene, thing.material, materials, textures, files)
            if isinstance(thing, Plane):
                planes.append((build_plane(thing, rows, pointer), material))
            else:
                shapes.append((build_shape(thing, rows, pointer), material))

    ambient, lights, light_kind = build_lights(scene.lights)
    triangles = _join_meshes(meshes)
    finite = _join_shapes(shapes)
    build_start = time.perf_counter()
    bvh = build(
        triangles["vertex_positions"],
        triangles["face_vertices"],
        finite["shape_kind"],
        finite["shape_origin"],
        finite["shape_to_world"],
    )
    build_s = time.perf_counter() - build_start
    material_rows, material_flags = materials.arrays()
    texture_rows, texels = textures.arrays()
    compiled = CompiledScene(
        settings=build_settings(scene),
        limits=build_limits(scene),
        camera=build_camera(scene),
        background=np.array(scene.background, np.float64),
        ambient=ambient,
        **triangles,
        **finite,
        **_join_planes(planes),
        materials=material_rows,
        material_flags=material_flags,
        textures=texture_rows,
        texels=texels,
        lights=lights,
        light_kind=light_kind,
        **bvh._asdict(),
    )
    check_layout(compiled)
    stats = CompileStats(
        load_s=load_s,
        build_s=build_s,
        total_s=time.perf_counter() - start,
        n_triangles=len(compiled.face_vertices),
        n_vertices=len(compiled.vertex_positions),
        n_shapes=len(compiled.shape_kind),
        n_planes=len(compiled.plane_material),
        n_materials=len(compiled.materials),
        n_textures=len(compiled.textures),
        n_bytes=sum(array.nbytes for array in compiled),
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


def _choose_materials(
    scene: SceneDoc,
    thing: Mesh | MeshAsset,
    data: MeshData,
    key: tuple[str, ...],
    pointer: str,
    materials: MaterialTable,
    textures: TextureTable,
    files: SceneFiles,
) -> NDArray[np.int32]:
    """Return each face's row: the object's choice for the group, for the object, the file's own, the default grey."""
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


def _place_mesh(
    thing: Mesh | MeshAsset, data: MeshData, normals_from: str, face_material: NDArray[np.int32], pointer: str
) -> _MeshRecord:
    """Bake an object's transform into its mesh, and give it the normals that the object asks for."""
    rows = transform_rows(thing.transform)
    flags = data.face_flags.copy()
    normals = data.normals
    if normals_from == "flat":
        normals = None
        flags &= np.uint8(0xFF ^ FACE_HAS_NORMALS)
    elif normals_from == "smooth":
        normals = smooth_normals(data.positions, data.faces)
        has_normal = (normals[data.faces] != 0.0).any(axis=2).all(axis=1)
        flags &= np.uint8(0xFF ^ FACE_HAS_NORMALS)
        flags[has_normal] |= np.uint8(FACE_HAS_NORMALS)
    positions, faces = data.positions, data.faces
    if rows != IDENTITY:
        with np.errstate(over="ignore", invalid="ignore"):
            positions = transform_points(rows, positions)
            if normals is not None:
                normals = transform_normals(rows, normals)
        check_range(positions, pointer)
        if is_mirroring(rows):
            faces = faces[:, [0, 2, 1]]  # keeps the winding outward
    return _MeshRecord(positions, normals, data.uvs, data.colors, faces, flags, face_material)


def _join_meshes(meshes: list[_MeshRecord]) -> dict[str, NDArray[Any]]:
    """Concatenate all triangles; absent attributes are filled as `CompiledScene` says."""
    offsets = np.cumsum([0] + [len(mesh.positions) for mesh in meshes])

    def joined(values: list[NDArray[np.float64] | None], width: int, absent: float) -> NDArray[np.float64]:
        out = np.full((int(offsets[-1]), width), absent)
        for mesh, value, offset in zip(meshes, values, offsets, strict=False):
            if value is not None:
                out[offset : offset + len(mesh.positions)] = value
        return out

    return {
        "vertex_positions": joined([mesh.positions for mesh in meshes], 3, 0.0),
        "vertex_normals": joined([mesh.normals for mesh in meshes], 3, 0.0),
        "vertex_uvs": joined([mesh.uvs for mesh in meshes], 2, 0.0),
        "vertex_colors": joined([mesh.colors for mesh in meshes], 3, 1.0),
        "face_vertices": np.concatenate(
            [
                np.empty((0, 3), np.int32),
                *(mesh.faces + np.int32(offset) for mesh, offset in zip(meshes, offsets, strict=False)),
            ]
        ),
        "face_material": np.concatenate([np.empty(0, np.int32), *(mesh.face_material for mesh in meshes)]),
        "face_flags": np.concatenate([np.empty(0, np.uint8), *(mesh.flags for mesh in meshes)]),
    }


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
