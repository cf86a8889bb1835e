"""The compiled scene: every array the kernels read, and nothing else.

Invariants
----------
* Every field of :class:`CompiledScene` is a C-contiguous, writable-or-not numpy array of a fixed dtype and a fixed
  number of dimensions (``FIELDS``), present even when empty: so there is one specialisation of each kernel, and a
  scene is saved as one file of arrays and memory-mapped again with the same numba type.
* World space throughout, but for meshes that share a tree: these stay in their own space, and each *placement* of such
  a tree has an affine map to the world. Elsewhere transforms are baked into vertices. Shapes keep an affine map to
  their local space.
* Primitive ids: triangles first (``0 <= id < n_triangles``, placement by placement: a triangle that is placed twice has
  two ids), then finite shapes (``n_triangles + shape``), then infinite planes (``n_triangles + n_shapes + plane``).
  Equal distances are won by the lowest id.
* There is at least one placement. A scene with only one has it untransformed.

Equations are those of [farmer2019].
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

BLOCK_PX: Final = 16  # edge of a block, the unit of rendering; blocks lie on the absolute image grid
CHANNELS: Final = ("R", "G", "B")

# --- counters -------------------------------------------------------------------------------------------------------
COUNTERS: Final[tuple[str, ...]] = (
    "samples",  # image samples that the picture's pixels are the mean of
    "primary_rays",  # camera rays
    "shadow_rays",  # shadow rays traced
    "reflection_rays",  # rays traced along eq. 17, total internal reflection included
    "transmission_rays",  # rays traced along eq. 18
    "primary_rays_skipped_shared",  # of these, not traced: one beam showed which face all of a square of pixels meet
    "reflection_rays_skipped_shared",  # the same of reflection rays, off a flat mirror
    "shadow_rays_skipped_facing",  # not traced: n.l <= 0
    "shadow_rays_skipped_black",  # not traced: the light adds nothing here (black, outside its cone, black kd and ks)
    "shadow_rays_skipped_solid",  # not traced: they pass through the inside of a closed opaque mesh
    "shadow_rays_skipped_shared",  # not traced: one beam showed that all of a square of pixels are lit, or all are dark
    "bounces_skipped_depth",  # not traced: integrator.max_depth
    "bounces_skipped_throughput",  # not traced: throughput below integrator.min_throughput
    "pixels_skipped_background",  # filled with the background: no primary ray of the pixel can meet the scene
    # adaptive sampling (tracer.render.adaptive): rays, and what is skipped of them, count all that was done to decide,
    # `samples` only what pixels are the mean of
    "samples_skipped_adaptive",  # not taken: the block's first samples show no detail
    "adaptive_blocks_audited",  # whole blocks of which that is true, and that were finished all the same
    "adaptive_blocks_missed",  # of these, those of which all samples show detail
)

# --- settings: int64 (N_SETTINGS,) ----------------------------------------------------------------------------------
SETTING_WIDTH: Final = 0  # full image, pixels
SETTING_HEIGHT: Final = 1
SETTING_CROP_X: Final = 2  # rendered window, absolute pixels from the top left; the full image when there is no crop
SETTING_CROP_Y: Final = 3
SETTING_CROP_WIDTH: Final = 4
SETTING_CROP_HEIGHT: Final = 5
SETTING_SAMPLES: Final = 6  # samples a pixel
SETTING_SAMPLER: Final = 7  # SAMPLER_*
SETTING_SEED: Final = 8  # 0 .. 2**32 - 1
SETTING_MAX_DEPTH: Final = 9  # bounces after the primary ray
SETTING_SHADOWS: Final = 10  # 0 or 1
SETTING_CAMERA: Final = 11  # CAMERA_*
SETTING_SKIP: Final = 12  # 0: every ray is traced (docs/skipping.md)
SETTING_MIN_SAMPLES: Final = 13  # adaptive sampling: samples that every block takes, even; 0: all take SETTING_SAMPLES
N_SETTINGS: Final = 14

SAMPLER_INDEPENDENT: Final = 0
SAMPLER_STRATIFIED: Final = 1
SAMPLER_SOBOL: Final = 2

CAMERA_VIEW_PLANE: Final = 0  # perspective and view_plane: common origin, direction by eq. 1
CAMERA_ORTHOGRAPHIC: Final = 1  # common direction -w, origin on the view plane

# --- limits: float64 (N_LIMITS,) ------------------------------------------------------------------------------------
LIMIT_MIN_THROUGHPUT: Final = 0
LIMIT_ADAPTIVE_THRESHOLD: Final = 1  # contrast, linear radiance, from which a block takes all samples
N_LIMITS: Final = 2

# --- camera: float64 (N_CAMERA,) ------------------------------------------------------------------------------------
CAMERA_EYE: Final = 0  # 0..2   e, world
CAMERA_U: Final = 3  # 3..5   u, to the right of the image; column 0 of camera-to-world, not normalised
CAMERA_V: Final = 6  # 6..8   v, to the top of the image; column 1
CAMERA_W: Final = 9  # 9..11  w, backwards; column 2
CAMERA_LEFT: Final = 12  # l, r, b, t: bounds of the view plane in camera units
CAMERA_RIGHT: Final = 13
CAMERA_BOTTOM: Final = 14
CAMERA_TOP: Final = 15
CAMERA_DISTANCE: Final = 16  # d > 0, distance of the view plane (1 for orthographic; unused)
N_CAMERA: Final = 17

# --- materials: float64 (n_materials, N_MATERIAL) -------------------------------------------------------------------
MATERIAL_KA: Final = 0  # 0..2, RGB, linear
MATERIAL_KD: Final = 3
MATERIAL_KS: Final = 6
MATERIAL_KE: Final = 9
MATERIAL_KR: Final = 12
MATERIAL_KT: Final = 15
MATERIAL_EXPONENT: Final = 18
MATERIAL_ETA: Final = 19  # index of refraction of the inside; outside is 1
MATERIAL_A: Final = 20  # attenuation 1 / (a + b D + c D^2), D in world units
MATERIAL_B: Final = 21
MATERIAL_C: Final = 22
N_MATERIAL: Final = 24  # one spare column: rows of 192 bytes, three cache lines

# material_flags: int32 (n_materials, N_MATERIAL_FLAGS)
FLAG_TEXTURE: Final = 0  # row of `textures` that multiplies ka and kd, or -1
FLAG_WRAP: Final = 1  # WRAP_*
FLAG_FILTER: Final = 2  # FILTER_*
FLAG_TWO_SIDED: Final = 3  # 0 or 1
N_MATERIAL_FLAGS: Final = 4

WRAP_REPEAT: Final = 0
WRAP_CLAMP: Final = 1
FILTER_NEAREST: Final = 0
FILTER_BILINEAR: Final = 1

# --- textures: int64 (n_textures, N_TEXTURE) ------------------------------------------------------------------------
TEXTURE_OFFSET: Final = 0  # first row of `texels`
TEXTURE_WIDTH: Final = 1  # texels
TEXTURE_HEIGHT: Final = 2
N_TEXTURE: Final = 3

# --- lights: float64 (n_lights, N_LIGHT), light_kind int32 (n_lights,) ----------------------------------------------
LIGHT_POSITION: Final = 0  # 0..2, world (point, spot)
LIGHT_DIRECTION: Final = 3  # 3..5, unit, the way light travels (directional, spot)
LIGHT_AMBIENT: Final = 6  # RGB
LIGHT_DIFFUSE: Final = 9
LIGHT_SPECULAR: Final = 12
LIGHT_SPOT_SCALE: Final = 15  # falloff = clamp(cos(angle) * scale + offset, 0, 1)^2 (glTF KHR_lights_punctual):
LIGHT_SPOT_OFFSET: Final = 16  # scale = 1 / max(1e-3, cos(inner) - cos(outer)), offset = -cos(outer) * scale
N_LIGHT: Final = 18

LIGHT_KIND_DIRECTIONAL: Final = 0
LIGHT_KIND_POINT: Final = 1
LIGHT_KIND_SPOT: Final = 2

# --- shapes ---------------------------------------------------------------------------------------------------------
# Local forms, all of unit size: the affine map does the rest, and keeps the ray parameter t.
#   sphere    x^2 + y^2 + z^2 = 1;           uv: u = azimuth / 2pi from +x towards +y, v = 1/2 + asin(z) / pi
#   box       [-1, 1]^3;                     uv: the two other coordinates of the face, mapped from [-1, 1] to [0, 1]
#   disk      z = 0, x^2 + y^2 <= 1, +z up;  uv: ((x + 1) / 2, (y + 1) / 2)
#   cylinder  x^2 + y^2 = 1, 0 <= z <= 1;    uv: (azimuth / 2pi, z); caps as the disk
SHAPE_SPHERE: Final = 0
SHAPE_BOX: Final = 1
SHAPE_DISK: Final = 2
SHAPE_CYLINDER_OPEN: Final = 3
SHAPE_CYLINDER_CAPPED: Final = 4

# --- triangles ------------------------------------------------------------------------------------------------------
FACE_HAS_NORMALS: Final = 1  # bits of face_flags: interpolate vertex normals, uvs, colours
FACE_HAS_UVS: Final = 2
FACE_HAS_COLORS: Final = 4

# --- placements of trees: int64 (n_placements, N_PLACEMENT) ---------------------------------------------------------
PLACEMENT_FIRST: Final = 0  # its triangles' ids: FIRST .. END; the next placement's follow
PLACEMENT_END: Final = 1
PLACEMENT_TREE: Final = 2  # first word of its tree in `trees`
PLACEMENT_FACE: Final = 3  # row of face_vertices and face_flags of its first triangle
PLACEMENT_MATERIAL: Final = 4  # row of face_material of its first triangle
PLACEMENT_KIND: Final = 5  # PLACED_*
N_PLACEMENT: Final = 6

PLACED_AS_IS: Final = 0  # vertices are in world space
PLACED_MOVED: Final = 1  # vertices are in the mesh's own space; `placement_maps` says where that is
PLACED_MIRRORED: Final = 2  # the same, and the map turns a right hand into a left one: the winding is swapped

# placement_maps: float64 (n_placements, N_MAP)
MAP_ORIGIN: Final = 0  # 0..2    p_world = origin + to_world @ p_object
MAP_TO_WORLD: Final = 3  # 3..11   row by row
MAP_TO_OBJECT: Final = 12  # 12..20  its inverse, each number rounded once
MAP_BOX: Final = 21  # 21..26  world bounds: low x, y, z, high x, y, z; (+inf, -inf) when nothing is in it
MAP_ERROR: Final = 27  # 27..29  what going to the object's space and back can add to a hit point's error, world
MAP_PAD: Final = 30  # share of the distance by which a ray can pass its box and still meet what is in it
MAP_TOP_PAD: Final = 31  # the largest MAP_PAD of all
N_MAP: Final = 32

# solids: float64 (n, N_SOLID)
SOLID_CENTRE: Final = 0  # 0..2    of an ellipsoid that lies within a closed mesh, world
SOLID_BALL: Final = 3  # 3..5    1 / its half axes
SOLID_BOX: Final = 6  # 6..8    1 / the half extents of the mesh's box, which has the same centre
N_SOLID: Final = 9


class Vec3(NamedTuple):
    """Three scalars: a point, a direction or a colour. As fast as separate arguments in compiled code."""

    x: float
    y: float
    z: float


class Bvh(NamedTuple):
    """The hierarchies of a scene; fields as in :class:`CompiledScene`."""

    trees: NDArray[np.int64]
    placements: NDArray[np.int64]
    placement_maps: NDArray[np.float64]
    top_bounds: NDArray[np.float64]
    top_children: NDArray[np.int32]
    top_slots: NDArray[np.int32]
    bvh_bounds: NDArray[np.float64]
    bvh_children: NDArray[np.int32]
    bvh_slots: NDArray[np.int32]
    bvh_root: NDArray[np.float64]


class CompiledScene(NamedTuple):
    """All that a kernel reads. Shapes in the comments: ``nv`` vertices, ``nt`` triangles, ``ns`` finite shapes."""

    settings: NDArray[np.int64]  # (N_SETTINGS,) SETTING_*
    limits: NDArray[np.float64]  # (N_LIMITS,) LIMIT_*
    camera: NDArray[np.float64]  # (N_CAMERA,) CAMERA_*; world units
    background: NDArray[np.float64]  # (3,) linear RGB of a primary or bounced ray that meets nothing
    ambient: NDArray[np.float64]  # (3,) sum of the global ambient lights, linear RGB

    vertex_positions: NDArray[np.float64]  # (nv, 3) world, or the mesh's own space where placements move it; finite
    vertex_normals: NDArray[np.float64]  # (nv, 3) the same space, by the inverse transpose, NOT normalised; 0 if absent
    vertex_uvs: NDArray[np.float64]  # (nv, 2) v grows upwards; 0 where absent
    vertex_colors: NDArray[np.float64]  # (nv, 3) linear RGB, multiplies ka and kd; 1 where absent
    face_vertices: NDArray[np.int32]  # (nt, 3) rows of the vertex arrays; 2nd and 3rd swapped under a mirroring
    #                                    baked transform (det < 0), so that the winding stays outward
    face_material: NDArray[np.int32]  # (>= nt,) row of materials; placements with the same choice share rows
    face_flags: NDArray[np.uint8]  # (nt,) bits FACE_HAS_*

    shape_kind: NDArray[np.int32]  # (ns,) SHAPE_*
    shape_material: NDArray[np.int32]  # (ns,)
    shape_origin: NDArray[np.float64]  # (ns, 3) world position of the local origin
    shape_to_world: NDArray[np.float64]  # (ns, 3, 3) p_world = shape_origin + shape_to_world @ p_local
    shape_to_local: NDArray[np.float64]  # (ns, 3, 3) its inverse: p_local = shape_to_local @ (p_world - shape_origin)

    plane_point: NDArray[np.float64]  # (np, 3) world
    plane_normal: NDArray[np.float64]  # (np, 3) world, unit, the front side
    plane_uv: NDArray[np.float64]  # (np, 2, 3) u, v = plane_uv @ (p_world - plane_point)
    plane_material: NDArray[np.int32]  # (np,)

    materials: NDArray[np.float64]  # (n_materials, N_MATERIAL) MATERIAL_*
    material_flags: NDArray[np.int32]  # (n_materials, N_MATERIAL_FLAGS) FLAG_*
    textures: NDArray[np.int64]  # (n_textures, N_TEXTURE) TEXTURE_*
    texels: NDArray[np.float32]  # (n_texels, 3) linear RGB (sRGB decoded), row 0 of an image is its TOP row
    lights: NDArray[np.float64]  # (n_lights, N_LIGHT) LIGHT_*
    light_kind: NDArray[np.int32]  # (n_lights,) LIGHT_KIND_*

    trees: NDArray[np.int64]  # (n,) the triangles' wide trees, each as tracer.accel.layout says, one behind the other
    placements: NDArray[np.int64]  # (n_placements, N_PLACEMENT) PLACEMENT_*
    placement_maps: NDArray[np.float64]  # (n_placements, N_MAP) MAP_*
    # the placements' tree, as the shapes' below:
    top_bounds: NDArray[np.float64]  # (n_nodes, 12) world
    top_children: NDArray[np.int32]  # (n_nodes, 4)
    top_slots: NDArray[np.int32]  # (n_placements,)
    # the finite shapes' tree:
    bvh_bounds: NDArray[np.float64]  # (n_nodes, 12) per axis: low of child 0, of child 1, high of 0, of 1; the root
    #                                    is node 0
    bvh_children: NDArray[np.int32]  # (n_nodes, 4) per child (index, count): count 0: node `index`; count > 0: leaf of
    #                                    slots index .. index + count; count -1: nothing there
    bvh_slots: NDArray[np.int32]  # (ns,) shape by slot
    bvh_root: NDArray[np.float64]  # (2, 3) bounds of all finite primitives; (+inf, -inf) when there are none
    solids: NDArray[np.float64]  # (n, N_SOLID) balls within closed opaque meshes, SOLID_*


class SceneView(NamedTuple):
    """The compiled scene inside a kernel: flat pointers (see :func:`tracer.jit.pointer`) and the lengths.

    Compiled, it is one address (:mod:`tracer.accel.view`).

    Fields are named as in :class:`CompiledScene`; element ``[row, column]`` is ``field[n_columns * row + column]``.
    """

    settings: NDArray[np.int64]
    limits: NDArray[np.float64]
    camera: NDArray[np.float64]
    background: NDArray[np.float64]
    ambient: NDArray[np.float64]
    vertex_positions: NDArray[np.float64]
    vertex_normals: NDArray[np.float64]
    vertex_uvs: NDArray[np.float64]
    vertex_colors: NDArray[np.float64]
    face_vertices: NDArray[np.int32]
    face_material: NDArray[np.int32]
    face_flags: NDArray[np.uint8]
    shape_kind: NDArray[np.int32]
    shape_material: NDArray[np.int32]
    shape_origin: NDArray[np.float64]
    shape_to_world: NDArray[np.float64]
    shape_to_local: NDArray[np.float64]
    plane_point: NDArray[np.float64]
    plane_normal: NDArray[np.float64]
    plane_uv: NDArray[np.float64]
    plane_material: NDArray[np.int32]
    materials: NDArray[np.float64]
    material_flags: NDArray[np.int32]
    textures: NDArray[np.int64]
    texels: NDArray[np.float32]
    lights: NDArray[np.float64]
    light_kind: NDArray[np.int32]
    trees: NDArray[np.int64]
    placements: NDArray[np.int64]
    placement_maps: NDArray[np.float64]
    top_bounds: NDArray[np.float64]
    top_children: NDArray[np.int32]
    top_slots: NDArray[np.int32]
    bvh_bounds: NDArray[np.float64]
    bvh_children: NDArray[np.int32]
    bvh_slots: NDArray[np.int32]
    bvh_root: NDArray[np.float64]
    solids: NDArray[np.float64]
    n_triangles: int  # placed ones
    n_shapes: int
    n_planes: int
    n_lights: int
    n_placements: int
    n_solids: int


class FilmBlocks(NamedTuple):
    """What a backend returns for ``n`` blocks of 16 x 16 pixels."""

    # (n, 2, 16, 16, 3) sums of linear RGB over even / odd sample indices; 0 outside the crop; of blocks that took fewer
    # samples than were asked for (adaptive sampling) scaled to as many
    sums: NDArray[np.float64]
    n_samples: NDArray[np.int64]  # (2,) samples in each half
    counters: NDArray[np.int64]  # (len(COUNTERS),)


# Name of each field -> dtype and shape; None is a free length.
FIELDS: Final[dict[str, tuple[str, tuple[int | None, ...]]]] = {
    "settings": ("int64", (N_SETTINGS,)),
    "limits": ("float64", (N_LIMITS,)),
    "camera": ("float64", (N_CAMERA,)),
    "background": ("float64", (3,)),
    "ambient": ("float64", (3,)),
    "vertex_positions": ("float64", (None, 3)),
    "vertex_normals": ("float64", (None, 3)),
    "vertex_uvs": ("float64", (None, 2)),
    "vertex_colors": ("float64", (None, 3)),
    "face_vertices": ("int32", (None, 3)),
    "face_material": ("int32", (None,)),
    "face_flags": ("uint8", (None,)),
    "shape_kind": ("int32", (None,)),
    "shape_material": ("int32", (None,)),
    "shape_origin": ("float64", (None, 3)),
    "shape_to_world": ("float64", (None, 3, 3)),
    "shape_to_local": ("float64", (None, 3, 3)),
    "plane_point": ("float64", (None, 3)),
    "plane_normal": ("float64", (None, 3)),
    "plane_uv": ("float64", (None, 2, 3)),
    "plane_material": ("int32", (None,)),
    "materials": ("float64", (None, N_MATERIAL)),
    "material_flags": ("int32", (None, N_MATERIAL_FLAGS)),
    "textures": ("int64", (None, N_TEXTURE)),
    "texels": ("float32", (None, 3)),
    "lights": ("float64", (None, N_LIGHT)),
    "light_kind": ("int32", (None,)),
    "trees": ("int64", (None,)),
    "placements": ("int64", (None, N_PLACEMENT)),
    "placement_maps": ("float64", (None, N_MAP)),
    "top_bounds": ("float64", (None, 12)),
    "top_children": ("int32", (None, 4)),
    "top_slots": ("int32", (None,)),
    "bvh_bounds": ("float64", (None, 12)),
    "bvh_children": ("int32", (None, 4)),
    "bvh_slots": ("int32", (None,)),
    "bvh_root": ("float64", (2, 3)),
    "solids": ("float64", (None, N_SOLID)),
}


def check_layout(scene: CompiledScene) -> None:
    """Refuse a scene that the kernels would misread.

    Parameters
    ----------
    scene
        Arrays as :data:`FIELDS` says.

    Raises
    ------
    ValueError
        A field has another dtype, shape or memory order; the message names it.
    """
    for name, (dtype, shape) in FIELDS.items():
        array = getattr(scene, name)
        if array.dtype != np.dtype(dtype) or array.ndim != len(shape) or not array.flags.c_contiguous:
            raise ValueError(f"{name}: {array.dtype} {array.shape}, expected C-contiguous {dtype} {shape}")
        if any(want is not None and want != have for want, have in zip(shape, array.shape, strict=True)):
            raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
    if len(scene.placements) == 0 or len(scene.placement_maps) != len(scene.placements):
        raise ValueError("placements: expected at least one, and a map for each")
