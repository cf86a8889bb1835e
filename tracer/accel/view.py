"""The compiled scene as a kernel sees it: pointers instead of arrays."""

from tracer.jit import inline, pointer
from tracer.types import PLACEMENT_END, CompiledScene, SceneView


@inline
def view_scene(scene: CompiledScene) -> SceneView:
    """Take the address of every array; the caller keeps the scene alive."""
    return SceneView(
        pointer(scene.settings),
        pointer(scene.limits),
        pointer(scene.camera),
        pointer(scene.background),
        pointer(scene.ambient),
        pointer(scene.vertex_positions),
        pointer(scene.vertex_normals),
        pointer(scene.vertex_uvs),
        pointer(scene.vertex_colors),
        pointer(scene.face_vertices),
        pointer(scene.face_material),
        pointer(scene.face_flags),
        pointer(scene.shape_kind),
        pointer(scene.shape_material),
        pointer(scene.shape_origin),
        pointer(scene.shape_to_world),
        pointer(scene.shape_to_local),
        pointer(scene.plane_point),
        pointer(scene.plane_normal),
        pointer(scene.plane_uv),
        pointer(scene.plane_material),
        pointer(scene.materials),
        pointer(scene.material_flags),
        pointer(scene.textures),
        pointer(scene.texels),
        pointer(scene.lights),
        pointer(scene.light_kind),
        pointer(scene.trees),
        pointer(scene.placements),
        pointer(scene.placement_maps),
        pointer(scene.top_bounds),
        pointer(scene.top_children),
        pointer(scene.top_slots),
        pointer(scene.bvh_bounds),
        pointer(scene.bvh_children),
        pointer(scene.bvh_slots),
        pointer(scene.bvh_root),
        scene.placements[-1, PLACEMENT_END],
        scene.shape_kind.shape[0],
        scene.plane_material.shape[0],
        scene.light_kind.shape[0],
        scene.placements.shape[0],
    )
