"""The scene document, version 1: models, parsing, canonical form, JSON Schema.

Pure Python and pydantic: the API process validates with this and never loads numpy or numba.

Examples
--------
>>> camera = {"type": "perspective", "fov_deg": 40}
>>> doc = parse_scene({"version": 1, "camera": camera, "image": {"width": 4, "height": 3}})
>>> doc.sampling.samples
16

"""

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
