"""The scene document, version 1: models, parsing, canonical form, JSON Schema.

Pure Python and pydantic: the API process validates with this and never loads numpy or numba. Names are imported when
they are asked for: who only reads a document's text does without the models.

Examples
--------
>>> camera = {"type": "perspective", "fov_deg": 40}
>>> doc = parse_scene({"version": 1, "camera": camera, "image": {"width": 4, "height": 3}})
>>> doc.sampling.samples
16

"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracer.scene.assets import AssetRef, AssetResolver, asset_ref
    from tracer.scene.camera import Camera, LookAt, OrthographicCamera, PerspectiveCamera, View, ViewPlaneCamera
    from tracer.scene.canonical import canonical_json, scene_hash
    from tracer.scene.document import Asset, Crop, Image, Integrator, Sampling, SceneDoc
    from tracer.scene.faults import Fault, SceneError
    from tracer.scene.lights import AmbientLight, DirectionalLight, Light, PointLight, SpotLight
    from tracer.scene.materials import DEFAULT_REFLECTANCE, Attenuation, BlinnPhongMaterial, DiffuseTexture
    from tracer.scene.objects import AnyObject, Box, Cylinder, Disk, Mesh, MeshAsset, Plane, SceneObject, Shape, Sphere
    from tracer.scene.parse import parse_scene
    from tracer.scene.schema import json_schema
    from tracer.scene.transforms import (
        IDENTITY,
        Matrix,
        MatrixTransform,
        Rotate,
        Scale,
        Transform,
        Translate,
        transform_rows,
    )

__all__ = [
    "DEFAULT_REFLECTANCE",
    "IDENTITY",
    "AmbientLight",
    "AnyObject",
    "Asset",
    "AssetRef",
    "AssetResolver",
    "Attenuation",
    "BlinnPhongMaterial",
    "Box",
    "Camera",
    "Crop",
    "Cylinder",
    "DiffuseTexture",
    "DirectionalLight",
    "Disk",
    "Fault",
    "Image",
    "Integrator",
    "Light",
    "LookAt",
    "Matrix",
    "MatrixTransform",
    "Mesh",
    "MeshAsset",
    "OrthographicCamera",
    "PerspectiveCamera",
    "Plane",
    "PointLight",
    "Rotate",
    "Sampling",
    "Scale",
    "SceneDoc",
    "SceneError",
    "SceneObject",
    "Shape",
    "Sphere",
    "SpotLight",
    "Transform",
    "Translate",
    "View",
    "ViewPlaneCamera",
    "asset_ref",
    "canonical_json",
    "json_schema",
    "parse_scene",
    "scene_hash",
    "transform_rows",
]

_MODULES = {
    "tracer.scene.assets": ("AssetRef", "AssetResolver", "asset_ref"),
    "tracer.scene.camera": ("Camera", "LookAt", "OrthographicCamera", "PerspectiveCamera", "View", "ViewPlaneCamera"),
    "tracer.scene.canonical": ("canonical_json", "scene_hash"),
    "tracer.scene.document": ("Asset", "Crop", "Image", "Integrator", "Sampling", "SceneDoc"),
    "tracer.scene.faults": ("Fault", "SceneError"),
    "tracer.scene.lights": ("AmbientLight", "DirectionalLight", "Light", "PointLight", "SpotLight"),
    "tracer.scene.materials": ("DEFAULT_REFLECTANCE", "Attenuation", "BlinnPhongMaterial", "DiffuseTexture"),
    "tracer.scene.objects": (
        "AnyObject",
        "Box",
        "Cylinder",
        "Disk",
        "Mesh",
        "MeshAsset",
        "Plane",
        "SceneObject",
        "Shape",
        "Sphere",
    ),
    "tracer.scene.parse": ("parse_scene",),
    "tracer.scene.schema": ("json_schema",),
    "tracer.scene.transforms": (
        "IDENTITY",
        "Matrix",
        "MatrixTransform",
        "Rotate",
        "Scale",
        "Transform",
        "Translate",
        "transform_rows",
    ),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'tracer.scene' has no attribute {name!r}")
