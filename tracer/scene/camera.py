"""Cameras: perspective, explicit view plane, orthographic; placed by look_at or by a matrix.

Every camera gives a `View`: the frame and view plane of the report's equation 1, by which the kernels make rays. A
point of the picture x from the left and y from the top (0 to 1) lies at u = l + (r - l) x, v = t - (t - b) y.
Perspective: the ray starts at `eye` and has the direction `-d w + u u + v v` [farmer2019 eq. 1]. Orthographic: it
starts at `eye + u u + v v` and has the direction `-w`.

Invariant: u, v, w are linearly independent, right > left, top > bottom, distance > 0.
"""

import math
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from tracer.scene.base import Coordinate, Direction, Length, Number, SceneModel, Vector
from tracer.scene.faults import Fault, faults_error
from tracer.scene.limits import MAX_FOV_DEG, MIN_FOV_DEG, MIN_LENGTH, MIN_UP_SINE
from tracer.scene.transforms import MatrixRows

Vector3 = tuple[float, float, float]


class View(NamedTuple):
    """Frame and view plane of a camera, as the kernels take them [farmer2019 eq. 1]."""

    eye: Vector3  # world, position of the camera
    u: Vector3  # world, to the right in the picture
    v: Vector3  # world, upwards in the picture
    w: Vector3  # world, against the viewing direction
    left: float  # view plane's bounds in units of u and v
    right: float
    bottom: float
    top: float
    distance: float  # of the view plane from the eye, in units of w
    orthographic: bool  # True: parallel rays along -w that start on the view plane at the eye


def _cross(a: Vector3, b: Vector3) -> Vector3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _unit(a: Vector3) -> Vector3:
    length = math.hypot(*a)
    return (a[0] / length, a[1] / length, a[2] / length)


class LookAt(SceneModel):
    """Place the camera at `eye`, looking at `target`, with `up` upwards in the picture."""

    eye: Vector = Field(description="Position of the camera [x, y, z].", examples=[[0, 1, 5]])
    target: Vector = Field(description="Point in the middle of the picture [x, y, z].", examples=[[0, 1, 0]])
    up: Direction = Field(
        default=(0.0, 1.0, 0.0),
        description="Direction that is upwards in the picture; not parallel to the viewing direction.",
        examples=[[0, 1, 0]],
    )

    @model_validator(mode="after")
    def _check_frame(self) -> "LookAt":
        backwards = self._backwards()
        if math.hypot(*backwards) < MIN_LENGTH:
            raise faults_error([Fault("/target", "is the same point as eye", "a point other than eye")])
        sine = math.hypot(*_cross(_unit(self.up), _unit(backwards)))
        if sine < MIN_UP_SINE:
            raise faults_error(
                [Fault("/up", "is parallel to the viewing direction", "a direction across the one from eye to target")]
            )
        return self

    def _backwards(self) -> Vector3:
        """Vector from the target to the eye."""
        return (self.eye[0] - self.target[0], self.eye[1] - self.target[1], self.eye[2] - self.target[2])

    def frame(self) -> tuple[Vector3, Vector3, Vector3, Vector3]:
        """Eye and the right-handed orthonormal vectors u (right), v (up), w (backwards)."""
        w = _unit(self._backwards())
        # Both factors are unit vectors, so the product neither overflows nor underflows.
        u = _unit(_cross(_unit(self.up), w))
        return self.eye, u, _cross(w, u), w


class _Camera(SceneModel):
    """Base of all cameras: their pose."""

    look_at: LookAt | None = Field(
        default=None,
        description="Pose by eye, target and up; give this or matrix, or neither for the identity.",
        examples=[{"eye": [0, 1, 5], "target": [0, 1, 0], "up": [0, 1, 0]}],
    )
    matrix: MatrixRows | None = Field(
        default=None,
        description="Pose as camera-to-world matrix (4 rows of 4); the camera looks along its -z with +y upwards.",
        examples=[[[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 5], [0, 0, 0, 1]]],
    )

    @model_validator(mode="after")
    def _check_pose(self) -> "_Camera":
        if self.look_at is not None and self.matrix is not None:
            raise faults_error([Fault("/matrix", "stands beside look_at", "only one of look_at and matrix")])
        return self

    def frame(self) -> tuple[Vector3, Vector3, Vector3, Vector3]:
        """Eye and the vectors u (right), v (up), w (backwards) in the world.

        From `look_at` they are orthonormal. From `matrix` they are its columns as given: a scale or shear in it acts
        on the picture as it does on any object.
        """
        if self.look_at is not None:
            return self.look_at.frame()
        if self.matrix is not None:
            u, v, w, eye = zip(*self.matrix[:3], strict=True)
            return eye, u, v, w
        return (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class PerspectiveCamera(_Camera):
    """Pinhole camera given by its field of view; pixels are square."""

    type: Literal["perspective"] = Field(description="Kind of this camera.", examples=["perspective"])
    fov_deg: Annotated[Number, Field(ge=MIN_FOV_DEG, le=MAX_FOV_DEG)] = Field(
        description="Full angle of view in degrees along fov_axis.", examples=[40]
    )
    fov_axis: Literal["vertical", "horizontal"] = Field(
        default="vertical", description="Side of the picture that fov_deg spans.", examples=["vertical"]
    )

    def view(self, width: int, height: int) -> View:
        """Frame and view plane at distance 1 for a picture of width x height pixels."""
        half = math.tan(math.radians(self.fov_deg) / 2.0)
        if self.fov_axis == "vertical":
            right, top = half * width / height, half
        else:
            right, top = half, half * height / width
        return View(*self.frame(), -right, right, -top, top, 1.0, orthographic=False)


class ViewPlaneCamera(_Camera):
    """Pinhole camera given by its view plane [farmer2019 eq. 1], off-centre and stretched ones included."""

    type: Literal["view_plane"] = Field(description="Kind of this camera.", examples=["view_plane"])
    left: Coordinate = Field(description="Left edge of the view plane, along u.", examples=[-1])
    right: Coordinate = Field(description="Right edge of the view plane, along u; greater than left.", examples=[1])
    bottom: Coordinate = Field(description="Lower edge of the view plane, along v.", examples=[-1])
    top: Coordinate = Field(description="Upper edge of the view plane, along v; greater than bottom.", examples=[1])
    distance: Length = Field(description="Distance of the view plane from the eye, along -w.", examples=[0.1])

    @model_validator(mode="after")
    def _check_bounds(self) -> "ViewPlaneCamera":
        faults = []
        if self.left >= self.right:
            faults.append(Fault("/right", f"is {self.right!r}, not right of left", f"a number > {self.left!r} (left)"))
        if self.bottom >= self.top:
            faults.append(Fault("/top", f"is {self.top!r}, not above bottom", f"a number > {self.bottom!r} (bottom)"))
        if faults:
            raise faults_error(faults)
        return self

    def view(self, width: int, height: int) -> View:  # noqa: ARG002 - the same call for every camera
        """Frame and view plane as given, whatever the picture's size in pixels."""
        return View(*self.frame(), self.left, self.right, self.bottom, self.top, self.distance, orthographic=False)


class OrthographicCamera(_Camera):
    """Parallel rays; things keep their size at any distance. Pixels are square."""

    type: Literal["orthographic"] = Field(description="Kind of this camera.", examples=["orthographic"])
    height: Length = Field(
        description="What the full height of the picture spans, in world units (times the scale of matrix, if any).",
        examples=[2],
    )

    def view(self, width: int, height: int) -> View:
        """Frame and bounds of the plane through the eye on which rays start; distance is 1 and without effect."""
        top = self.height / 2.0
        right = top * width / height
        return View(*self.frame(), -right, right, -top, top, 1.0, orthographic=True)


Camera = Annotated[PerspectiveCamera | ViewPlaneCamera | OrthographicCamera, Field(discriminator="type")]
