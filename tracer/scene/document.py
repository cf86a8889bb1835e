"""The scene document, version 1: everything that decides a picture.

Invariant: a `SceneDoc` that came from `parse_scene` can be compiled; only what lies in asset files can still be wrong.
"""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, Strict, model_validator

from tracer.scene.base import Name, Number, Rgb, SceneModel, Whole, at_most
from tracer.scene.camera import Camera
from tracer.scene.faults import Fault, faults_error
from tracer.scene.lights import Light
from tracer.scene.limits import (
    MAX_ASSETS,
    MAX_COLOR,
    MAX_COMPANIONS,
    MAX_DEPTH_OF_RAYS,
    MAX_FILE_NAME_LENGTH,
    MAX_IMAGE_SIDE,
    MAX_LIGHTS,
    MAX_MATERIALS,
    MAX_OBJECTS,
    MAX_SAMPLES_PER_PIXEL,
    MAX_SEED,
)
from tracer.scene.materials import BlinnPhongMaterial
from tracer.scene.objects import AnyObject


def _whole(value: object) -> object:
    """Refuse what only equals 1: true and 1.0."""
    return value if type(value) is int else None


Version = Annotated[Literal[1], BeforeValidator(_whole)]
Side = Annotated[Whole, Field(ge=1, le=MAX_IMAGE_SIDE)]
Offset = Annotated[Whole, Field(ge=0, le=MAX_IMAGE_SIDE - 1)]
Sha256 = Annotated[str, Strict(), Field(pattern=r"^[0-9a-f]{64}$", min_length=64, max_length=64)]
FileName = Annotated[str, Strict(), Field(min_length=1, max_length=MAX_FILE_NAME_LENGTH)]


class Crop(SceneModel):
    """Rectangle of the picture that is rendered, in pixels from the top left."""

    x: Offset = Field(description="Pixels left of the rectangle.", examples=[0])
    y: Offset = Field(description="Pixels above the rectangle.", examples=[0])
    width: Side = Field(description="Width of the rectangle in pixels.", examples=[320])
    height: Side = Field(description="Height of the rectangle in pixels.", examples=[180])


class Image(SceneModel):
    """Size of the picture, and which part of it is rendered."""

    width: Side = Field(description="Width of the full picture in pixels.", examples=[640])
    height: Side = Field(description="Height of the full picture in pixels.", examples=[360])
    crop: Crop | None = Field(
        default=None,
        description="Part to render; its pixels equal those of the full picture. Left out: all.",
        examples=[{"x": 0, "y": 0, "width": 320, "height": 180}],
    )

    @model_validator(mode="after")
    def _check_crop(self) -> "Image":
        faults = []
        if self.crop is not None:
            for offset, extent, side in (("x", "width", self.width), ("y", "height", self.height)):
                first, size = getattr(self.crop, offset), getattr(self.crop, extent)
                if first + size > side:
                    message = f"reaches to pixel {first + size}, outside the image of {side}"
                    faults.append(Fault(f"/crop/{extent}", message, f"{offset} + {extent} <= {side}"))
        if faults:
            raise faults_error(faults)
        return self

    @property
    def rect(self) -> tuple[int, int, int, int]:
        """Rendered rectangle (x, y, width, height) in pixels: the crop, or the full picture."""
        if self.crop is None:
            return 0, 0, self.width, self.height
        return self.crop.x, self.crop.y, self.crop.width, self.crop.height


class Integrator(SceneModel):
    """How light is followed."""

    type: Literal["blinn_phong"] = Field(
        default="blinn_phong",
        description="The report's shading with mirrors and transparency.",
        examples=["blinn_phong"],
    )
    max_depth: Annotated[Whole, Field(ge=0, le=MAX_DEPTH_OF_RAYS)] = Field(
        default=3, description="Bounces followed after the primary ray.", examples=[3]
    )
    shadows: Annotated[bool, Strict()] = Field(
        default=True, description="Whether lights are tested for being hidden.", examples=[True]
    )
    min_throughput: Annotated[Number, Field(ge=0.0, le=1.0)] = Field(
        default=1e-4, description="Paths that carry less than this factor in every channel end.", examples=[1e-4]
    )


class Adaptive(SceneModel):
    """Blocks of 16 x 16 pixels in which the first samples show no detail take no more."""

    min_samples: Annotated[Whole, Field(ge=2, le=MAX_SAMPLES_PER_PIXEL, multiple_of=2)] = Field(
        default=2, description="Samples that every pixel gets, fewer than all.", examples=[2]
    )
    threshold: Annotated[Number, Field(ge=0.0, le=MAX_COLOR)] = Field(
        default=0.01,
        description="RMS difference of neighbouring pixels, linear radiance, from which a block gets all samples.",
        examples=[0.01],
    )


class Sampling(SceneModel):
    """How many samples a pixel gets, and which."""

    samples: Annotated[Whole, Field(ge=1, le=MAX_SAMPLES_PER_PIXEL)] = Field(
        default=16, description="Samples per pixel.", examples=[16]
    )
    sampler: Literal["sobol", "independent", "stratified"] = Field(
        default="sobol", description="Where the samples lie.", examples=["sobol"]
    )
    seed: Annotated[Whole, Field(ge=0, le=MAX_SEED)] = Field(
        default=0, description="Another seed gives another noise.", examples=[0]
    )
    adaptive: Adaptive | None = Field(
        default=None,
        description="Leaves out samples where little changes. Left out: every pixel gets all.",
        examples=[{"min_samples": 2, "threshold": 0.01}],
    )

    @model_validator(mode="after")
    def _check_adaptive(self) -> "Sampling":
        if self.adaptive is not None and self.adaptive.min_samples >= self.samples:
            most = (self.samples - 1) // 2 * 2
            mend = f"an even number from 2 to {most}" if most else "3 samples or more, or no adaptive sampling"
            message = f"is {self.adaptive.min_samples}, of {self.samples} samples"
            raise faults_error([Fault("/adaptive/min_samples", message, mend)])
        return self


class Asset(SceneModel):
    """A file that the scene uses, by name and content."""

    file: FileName = Field(
        description="Name of the file; clients look beside the scene file, the service accepts plain names only.",
        examples=["car.obj"],
    )
    sha256: Sha256 | None = Field(
        default=None,
        description="SHA-256 of the file's bytes, 64 lower-case hex digits; the service requires it.",
        examples=["e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"],
    )
    companions: (
        Annotated[dict[FileName, Sha256 | None], Field(max_length=MAX_COMPANIONS), at_most(MAX_COMPANIONS)] | None
    ) = Field(
        default=None,
        description="Files that this file refers to (MTL, textures, buffers): relative name to SHA-256.",
        examples=[{"car.mtl": None}],
    )


class SceneDoc(SceneModel):
    """A scene: camera, image, materials, lights, objects, and the settings of the render."""

    version: Version = Field(description="Version of this format.", examples=[1])
    name: Name | None = Field(default=None, description="Title, for people.", examples=["Cornell box"])
    camera: Camera = Field(
        description="From where the scene is seen.",
        examples=[{"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 1, 5], "target": [0, 1, 0]}}],
    )
    image: Image = Field(description="Size of the picture.", examples=[{"width": 640, "height": 360}])
    integrator: Integrator = Field(
        default_factory=Integrator, description="How light is followed, and how far.", examples=[{"max_depth": 3}]
    )
    sampling: Sampling = Field(
        default_factory=Sampling, description="Samples per pixel and their pattern.", examples=[{"samples": 16}]
    )
    materials: Annotated[dict[Name, BlinnPhongMaterial], Field(max_length=MAX_MATERIALS), at_most(MAX_MATERIALS)] = (
        Field(default_factory=dict, description="Materials by name.", examples=[{"red": {"kd": [0.8, 0.1, 0.1]}}])
    )
    lights: Annotated[tuple[Light, ...], Field(max_length=MAX_LIGHTS), at_most(MAX_LIGHTS)] = Field(
        default=(),
        description="Lights; without any, only emission is seen.",
        examples=[[{"type": "ambient", "intensity": 1}]],
    )
    objects: Annotated[tuple[AnyObject, ...], Field(max_length=MAX_OBJECTS), at_most(MAX_OBJECTS)] = Field(
        default=(), description="What is seen.", examples=[[{"type": "sphere", "center": [0, 1, 0], "radius": 1}]]
    )
    background: Rgb = Field(
        default=(0.0, 0.0, 0.0), description="Linear RGB of rays that leave the scene.", examples=[[0.2, 0.3, 0.5]]
    )
    assets: Annotated[dict[Name, Asset], Field(max_length=MAX_ASSETS), at_most(MAX_ASSETS)] = Field(
        default_factory=dict, description="Files by name.", examples=[{"car": {"file": "car.obj"}}]
    )
