"""The compiled scene as a kernel sees it: one address, from which it reads the arrays' addresses as it needs them.

Kernels hand a view to each other as one number. As a tuple of 36 it cost every call 36 pushes and loads, and the
compiler half its time.
"""

from typing import Any, Final, get_type_hints

from llvmlite import ir

from tracer.jit import inline, int64, pointer
from tracer.simd import address_of, store
from tracer.simd.gateway import (
    AttributeTemplate,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    types,
)
from tracer.types import FIELDS, PLACEMENT_END, CompiledScene, SceneView

_NAMES: Final = tuple(get_type_hints(SceneView))
VIEW_BYTES: Final = 8 * len(_NAMES)
_KINDS: Final[dict[str, Any]] = {
    name: types.CPointer(getattr(types, FIELDS[name][0])) if name in FIELDS else types.int64 for name in _NAMES
}


class SceneViewType(types.Type):  # type: ignore[misc]
    """Type of :class:`tracer.types.SceneView` in kernels."""

    def __init__(self) -> None:
        super().__init__("SceneView")


scene_view: Final = SceneViewType()


@register_model(SceneViewType)
class _SceneViewModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.IntType(64))


@infer_getattr
class _SceneViewAttributes(AttributeTemplate):  # type: ignore[misc]
    key = SceneViewType

    def generic_resolve(self, _kind: Any, name: str) -> Any:
        return _KINDS.get(name)


@lower_getattr_generic(SceneViewType)
def _lower_attribute(context: Any, builder: Any, _kind: Any, value: Any, name: str) -> Any:
    place = builder.add(value, ir.Constant(ir.IntType(64), 8 * _NAMES.index(name)))
    word = context.get_value_type(_KINDS[name])
    return builder.load(builder.inttoptr(place, word.as_pointer()))


@intrinsic
def _as_view(_typing: Any, address: Any) -> Any:
    del address

    def generate(_context: Any, _builder: Any, _sig: Any, args: Any) -> Any:
        return args[0]

    return scene_view(types.int64), generate


@inline
def _write_table(scene: CompiledScene, table: int) -> None:
    """Write the fields of `SceneView`, in its order."""
    store(table + 0, address_of(pointer(scene.settings)))
    store(table + 8, address_of(pointer(scene.limits)))
    store(table + 16, address_of(pointer(scene.camera)))
    store(table + 24, address_of(pointer(scene.background)))
    store(table + 32, address_of(pointer(scene.ambient)))
    store(table + 40, address_of(pointer(scene.vertex_positions)))
    store(table + 48, address_of(pointer(scene.vertex_normals)))
    store(table + 56, address_of(pointer(scene.vertex_uvs)))
    store(table + 64, address_of(pointer(scene.vertex_colors)))
    store(table + 72, address_of(pointer(scene.face_vertices)))
    store(table + 80, address_of(pointer(scene.face_material)))
    store(table + 88, address_of(pointer(scene.face_flags)))
    store(table + 96, address_of(pointer(scene.shape_kind)))
    store(table + 104, address_of(pointer(scene.shape_material)))
    store(table + 112, address_of(pointer(scene.shape_origin)))
    store(table + 120, address_of(pointer(scene.shape_to_world)))
    store(table + 128, address_of(pointer(scene.shape_to_local)))
    store(table + 136, address_of(pointer(scene.plane_point)))
    store(table + 144, address_of(pointer(scene.plane_normal)))
    store(table + 152, address_of(pointer(scene.plane_uv)))
    store(table + 160, address_of(pointer(scene.plane_material)))
    store(table + 168, address_of(pointer(scene.materials)))
    store(table + 176, address_of(pointer(scene.material_flags)))
    store(table + 184, address_of(pointer(scene.textures)))
    store(table + 192, address_of(pointer(scene.texels)))
    store(table + 200, address_of(pointer(scene.lights)))
    store(table + 208, address_of(pointer(scene.light_kind)))
    store(table + 216, address_of(pointer(scene.trees)))
    store(table + 224, address_of(pointer(scene.placements)))
    store(table + 232, address_of(pointer(scene.placement_maps)))
    store(table + 240, address_of(pointer(scene.top_bounds)))
    store(table + 248, address_of(pointer(scene.top_children)))
    store(table + 256, address_of(pointer(scene.top_slots)))
    store(table + 264, address_of(pointer(scene.bvh_bounds)))
    store(table + 272, address_of(pointer(scene.bvh_children)))
    store(table + 280, address_of(pointer(scene.bvh_slots)))
    store(table + 288, address_of(pointer(scene.bvh_root)))
    store(table + 296, address_of(pointer(scene.solids)))
    store(table + 304, int64(scene.placements[-1, PLACEMENT_END]))  # n_triangles
    store(table + 312, int64(scene.shape_kind.shape[0]))  # n_shapes
    store(table + 320, int64(scene.plane_material.shape[0]))  # n_planes
    store(table + 328, int64(scene.light_kind.shape[0]))  # n_lights
    store(table + 336, int64(scene.placements.shape[0]))  # n_placements
    store(table + 344, int64(scene.solids.shape[0]))  # n_solids


@inline
def view_scene(scene: CompiledScene, table: int) -> SceneView:
    """Write the addresses of a scene's arrays and their lengths to ``table``, `VIEW_BYTES` long.

    The caller keeps the scene and the table alive.
    """
    _write_table(scene, table)
    view: SceneView = _as_view(table)
    return view
