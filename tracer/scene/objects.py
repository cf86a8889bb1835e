"""Objects: meshes, inline or as assets, and analytic shapes.

Invariant: every shape has an extent (positive radius, two distinct ends, min below max). What refers to other places
of the document or of the same mesh (names, vertex indices, lengths) is checked by `references`, since that can be told
even where other values are wrong.
"""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from tracer.scene.base import (
    Colors,
    Direction,
    Faces,
    Flag,
    Length,
    Name,
    Points,
    SceneModel,
    TextureCoordinates,
    Vector,
    Whole,
    at_most,
)
from tracer.scene.faults import Fault, faults_error
from tracer.scene.limits import MAX_COORDINATE, MAX_GROUPS, MIN_LENGTH
from tracer.scene.transforms import Transforms, is_singular, transform_rows

GroupMaterials = Annotated[dict[Name, Name], Field(max_length=MAX_GROUPS), at_most(MAX_GROUPS)]
FaceRange = tuple[Annotated[Whole, Field(ge=0)], Annotated[Whole, Field(ge=0)]]


class SceneObject(SceneModel):
    """Base of all objects."""

    name: Name | None = Field(default=None, description="Name for people; it has no effect.", examples=["floor"])
    material: Name | None = Field(
        default=None,
        description="Name of a material; left out: the mesh file's own, else a grey.",
        examples=["red"],
    )
    transform: Transforms | None = Field(
        default=None,
        description="Steps from the object's own space to the world, applied first to last.",
        examples=[[{"type": "scale", "by": 2}, {"type": "translate", "by": [0, 1, 0]}]],
    )

    @model_validator(mode="after")
    def _check_product(self) -> "SceneObject":
        """Refuse a product that leaves the range; each step is invertible already."""
        if self.transform and len(self.transform) > 1:
            rows = transform_rows(self.transform)
            in_range = all(abs(number) <= MAX_COORDINATE for row in rows for number in row)
            if not in_range or is_singular(rows):
                raise faults_error(
                    [Fault("/transform", "has a product that is singular or out of range", "an invertible product")]
                )
        return self


class Mesh(SceneObject):
    """Triangles given in the document."""

    type: Literal["mesh"] = Field(description="Kind of this object.", examples=["mesh"])
    positions: Points = Field(
        description="Vertices [x, y, z] in the object's space.", examples=[[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    )
    faces: Faces = Field(
        description="Triangles as three vertex indices; counter-clockwise seen from the front.", examples=[[[0, 1, 2]]]
    )
    normals: Points | None = Field(
        default=None,
        description="One normal per vertex, interpolated as given, then normalised; left out: flat triangles.",
        examples=[[[0, 0, 1], [0, 0, 1], [0, 0, 1]]],
    )
    uvs: TextureCoordinates | None = Field(
        default=None,
        description="One texture coordinate [u, v] per vertex; v grows upwards in the image.",
        examples=[[[0, 0], [1, 0], [0, 1]]],
    )
    colors: Colors | None = Field(
        default=None,
        description="One linear RGB colour per vertex, interpolated; it multiplies ka and kd.",
        examples=[[[1, 0, 0], [0, 1, 0], [0, 0, 1]]],
    )
    groups: Annotated[dict[Name, FaceRange], Field(max_length=MAX_GROUPS), at_most(MAX_GROUPS)] | None = Field(
        default=None,
        description="Named ranges of faces [first, end), half open, that do not overlap.",
        examples=[{"body": [0, 1]}],
    )
    materials: GroupMaterials | None = Field(
        default=None, description="Material of each named group, before material.", examples=[{"body": "red"}]
    )


class MeshAsset(SceneObject):
    """Triangles of a file: OBJ, PLY, STL, GLB/glTF, or JSON with vertexdata, indexdata and groups."""

    type: Literal["mesh_asset"] = Field(description="Kind of this object.", examples=["mesh_asset"])
    asset: Name = Field(description="Name of a file in the assets table.", examples=["car"])
    materials: GroupMaterials | None = Field(
        default=None,
        description="Material of each named group (or material) of the file, before material.",
        examples=[{"Body": "blue"}],
    )
    normals: Literal["file", "flat", "smooth"] = Field(
        default="file",
        description="Normals of the file (flat where it has none), of each triangle, or averaged over the vertices.",
        examples=["file"],
    )


class Plane(SceneObject):
    """Infinite plane."""

    type: Literal["plane"] = Field(description="Kind of this object.", examples=["plane"])
    point: Vector = Field(description="Any point of the plane [x, y, z].", examples=[[0, 0, 0]])
    normal: Direction = Field(description="Direction across the plane, to its front.", examples=[[0, 1, 0]])


class Sphere(SceneObject):
    """Sphere."""

    type: Literal["sphere"] = Field(description="Kind of this object.", examples=["sphere"])
    center: Vector = Field(description="Centre [x, y, z].", examples=[[0, 1, 0]])
    radius: Length = Field(description="Radius, above zero.", examples=[1])


class Box(SceneObject):
    """Box along the axes of its own space."""

    type: Literal["box"] = Field(description="Kind of this object.", examples=["box"])
    min: Vector = Field(description="Corner with the smallest coordinates [x, y, z].", examples=[[-1, 0, -1]])
    max: Vector = Field(description="Corner with the greatest coordinates, each above min.", examples=[[1, 2, 1]])

    @model_validator(mode="after")
    def _check_corners(self) -> "Box":
        faults = [
            Fault(f"/max/{axis}", f"is {high!r}, not above min", f"a number > {low!r} (min)")
            for axis, (low, high) in enumerate(zip(self.min, self.max, strict=True))
            if not low < high
        ]
        if faults:
            raise faults_error(faults)
        return self


class Disk(SceneObject):
    """Flat disk."""

    type: Literal["disk"] = Field(description="Kind of this object.", examples=["disk"])
    center: Vector = Field(description="Centre [x, y, z].", examples=[[0, 0, 0]])
    normal: Direction = Field(description="Direction across the disk, to its front.", examples=[[0, 1, 0]])
    radius: Length = Field(description="Radius, above zero.", examples=[1])


class Cylinder(SceneObject):
    """Round cylinder between two points."""

    type: Literal["cylinder"] = Field(description="Kind of this object.", examples=["cylinder"])
    start: Vector = Field(description="Centre of one end [x, y, z].", examples=[[0, 0, 0]])
    end: Vector = Field(description="Centre of the other end [x, y, z].", examples=[[0, 2, 0]])
    radius: Length = Field(description="Radius, above zero.", examples=[0.5])
    capped: Flag = Field(default=True, description="Whether disks close the ends.", examples=[True])

    @model_validator(mode="after")
    def _check_axis(self) -> "Cylinder":
        if math.dist(self.start, self.end) < MIN_LENGTH:
            raise faults_error([Fault("/end", "is the same point as start", "a point other than start")])
        return self


Shape = Plane | Sphere | Box | Disk | Cylinder
AnyObject = Annotated[Mesh | MeshAsset | Plane | Sphere | Box | Disk | Cylinder, Field(discriminator="type")]
