"""Transforms of an object: a list of steps, applied first to last, and their product as one affine matrix.

Invariant: every step is invertible by itself, so the product is, unless it leaves the range of float64, which is a
fault, too. Matrices are 4 rows of 4 numbers that multiply column vectors, p' = M p.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from tracer.scene.base import Direction, Number, Row, SceneModel, Vector, at_most, rows_validator
from tracer.scene.faults import Fault, faults_error, shown
from tracer.scene.limits import MAX_COORDINATE, MAX_TRANSFORMS, MIN_LENGTH

Matrix = tuple[
    tuple[float, float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float, float],
]

IDENTITY: Matrix = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))

_MATRIX_TEXT = "4 rows of 4 numbers, an invertible matrix with the last row [0, 0, 0, 1]"
_COEFFICIENT_TEXT = "a finite number from -1e30 to 1e30"
_check_rows = rows_validator(4, float, -MAX_COORDINATE, MAX_COORDINATE, "a row of four numbers", _COEFFICIENT_TEXT)


def determinant(matrix: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Compute the determinant of the linear part, and a bound of its rounding error, after scaling each row to size 1.

    Parameters
    ----------
    matrix : sequence of rows
        At least 3 rows of at least 3 numbers.

    Returns
    -------
    value, bound : float
        The determinant is zero to working precision when `abs(value) <= bound`.

    Notes
    -----
    The expansion by 5 operations a term errs by at most gamma(5) times the permanent of the absolute values
    (Higham, Accuracy and Stability of Numerical Algorithms, section 3.1); the scaling adds one rounding an entry, 3 a
    term: gamma(8), with gamma(n) = n u / (1 - n u) and u = 2^-53.

    """
    rows = []
    for row in matrix[:3]:
        size = max(abs(number) for number in row[:3])
        if size == 0.0:
            return 0.0, 0.0
        rows.append([number / size for number in row[:3]])
    (a, b, c), (d, e, f), (g, h, i) = rows
    value = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    permanent = (
        abs(a) * (abs(e * i) + abs(f * h)) + abs(b) * (abs(d * i) + abs(f * g)) + abs(c) * (abs(d * h) + abs(e * g))
    )
    unit = 2.0**-53
    return value, 8 * unit / (1 - 8 * unit) * permanent


def is_singular(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether the linear part of an affine matrix is singular to working precision."""
    value, bound = determinant(matrix)
    return abs(value) <= bound


def _check_matrix(value: object) -> Matrix:
    """Check an affine, invertible 4 x 4 matrix."""
    if isinstance(value, list | tuple) and len(value) != 4:
        raise faults_error([Fault("", f"is {shown(value)}", _MATRIX_TEXT)])
    rows = _check_rows(value)
    if tuple(rows[3]) != (0.0, 0.0, 0.0, 1.0):
        raise faults_error([Fault("/3", "is not [0, 0, 0, 1]", "the last row of an affine matrix, [0, 0, 0, 1]")])
    if is_singular(rows):
        raise faults_error([Fault("", "is singular: it flattens space", _MATRIX_TEXT)])
    return rows  # type: ignore[return-value]


MatrixRows = Annotated[
    Matrix,
    PlainValidator(_check_matrix),
    WithJsonSchema(
        {
            "type": "array",
            "minItems": 4,
            "maxItems": 4,
            "items": {
                "type": "array",
                "minItems": 4,
                "maxItems": 4,
                "items": {"type": "number", "minimum": -MAX_COORDINATE, "maximum": MAX_COORDINATE},
            },
        }
    ),
]
"""An affine, invertible matrix as 4 rows of 4 numbers."""


def _check_scale(value: object) -> Row:
    """One factor for all axes, or three; none is zero, negative ones mirror."""
    factors = value if isinstance(value, list | tuple) else [value, value, value]
    expected = "a number other than zero, or three of them [x, y, z]"
    if len(factors) != 3:
        raise faults_error([Fault("", f"has {len(factors)} items", expected)])
    faults: list[Fault] = []
    checked: list[float] = []
    for index, factor in enumerate(factors):
        pointer = f"/{index}" if isinstance(value, list | tuple) else ""
        if isinstance(factor, bool) or not isinstance(factor, int | float):
            faults.append(Fault(pointer, f"is {shown(factor)}", expected))
        elif not MIN_LENGTH <= abs(factor) <= MAX_COORDINATE:
            faults.append(Fault(pointer, f"is {shown(factor)}", expected + ", of size 1e-30 to 1e30"))
        else:
            checked.append(float(factor))
    if faults:
        raise faults_error(faults if isinstance(value, list | tuple) else faults[:1])
    return tuple(checked)


_FACTOR_SCHEMA: dict[str, object] = {
    "type": "number",
    "minimum": -MAX_COORDINATE,
    "maximum": MAX_COORDINATE,
    "not": {"const": 0},
}
ScaleFactors = Annotated[
    tuple[float, float, float],
    PlainValidator(_check_scale),
    WithJsonSchema(
        {"anyOf": [_FACTOR_SCHEMA, {"type": "array", "items": _FACTOR_SCHEMA, "minItems": 3, "maxItems": 3}]}
    ),
]
"""Factors along x, y and z; one number stands for three."""


class Translate(SceneModel):
    """Move by a vector."""

    type: Literal["translate"] = Field(description="Kind of this step.", examples=["translate"])
    by: Vector = Field(description="Vector [x, y, z] added to every point.", examples=[[0, 1, 0]])

    def matrix(self) -> Matrix:
        """Matrix of this step."""
        x, y, z = self.by
        return ((1.0, 0.0, 0.0, x), (0.0, 1.0, 0.0, y), (0.0, 0.0, 1.0, z), (0.0, 0.0, 0.0, 1.0))


class Rotate(SceneModel):
    """Turn about an axis through the origin, right-handed."""

    type: Literal["rotate"] = Field(description="Kind of this step.", examples=["rotate"])
    axis: Direction = Field(description="Axis through the origin; its length does not count.", examples=[[0, 1, 0]])
    angle_deg: Annotated[Number, Field(ge=-36000.0, le=36000.0)] = Field(
        description="Angle in degrees, counter-clockwise when the axis points at the viewer.", examples=[90]
    )

    def matrix(self) -> Matrix:
        """Matrix of this step (Rodrigues); multiples of 90 degrees have exact sines and cosines."""
        length = math.hypot(*self.axis)
        x, y, z = (coordinate / length for coordinate in self.axis)
        sine, cosine = _sine_cosine_deg(self.angle_deg)
        rest = 1.0 - cosine
        return (
            (cosine + x * x * rest, x * y * rest - z * sine, x * z * rest + y * sine, 0.0),
            (y * x * rest + z * sine, cosine + y * y * rest, y * z * rest - x * sine, 0.0),
            (z * x * rest - y * sine, z * y * rest + x * sine, cosine + z * z * rest, 0.0),
            (0.0, 0.0, 0.0, 1.0),
        )


class Scale(SceneModel):
    """Stretch along the axes; negative factors mirror."""

    type: Literal["scale"] = Field(description="Kind of this step.", examples=["scale"])
    by: ScaleFactors = Field(description="One factor, or one per axis [x, y, z]; not zero.", examples=[2, [1, 2, 1]])

    def matrix(self) -> Matrix:
        """Matrix of this step."""
        x, y, z = self.by
        return ((x, 0.0, 0.0, 0.0), (0.0, y, 0.0, 0.0), (0.0, 0.0, z, 0.0), (0.0, 0.0, 0.0, 1.0))


class MatrixTransform(SceneModel):
    """Any invertible affine map."""

    type: Literal["matrix"] = Field(description="Kind of this step.", examples=["matrix"])
    rows: MatrixRows = Field(
        description="4 rows of 4 numbers that multiply column vectors; the last row is [0, 0, 0, 1].",
        examples=[[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]],
    )

    def matrix(self) -> Matrix:
        """Matrix of this step."""
        return self.rows


Transform = Annotated[Translate | Rotate | Scale | MatrixTransform, Field(discriminator="type")]
Transforms = Annotated[tuple[Transform, ...], Field(max_length=MAX_TRANSFORMS), at_most(MAX_TRANSFORMS)]


def _sine_cosine_deg(angle_deg: float) -> tuple[float, float]:
    """Sine and cosine of an angle in degrees, exact at multiples of 90."""
    remainder = math.fmod(angle_deg, 360.0)
    quarters = round(remainder / 90.0)
    rest = math.radians(remainder - 90.0 * quarters)
    sine, cosine = math.sin(rest), math.cos(rest)
    return ((sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine))[quarters % 4]


def multiplied(left: Matrix, right: Matrix) -> Matrix:
    """Matrix product `left right`: first `right` is applied, then `left`."""
    columns = tuple(zip(*right, strict=True))
    return tuple(  # type: ignore[return-value]
        tuple(sum(a * b for a, b in zip(row, column, strict=True)) for column in columns) for row in left
    )


def transform_rows(transforms: Sequence[Transform] | None) -> Matrix:
    """Object-to-world matrix of a list of steps, applied first to last.

    Parameters
    ----------
    transforms : sequence of steps, or None
        An object's `transform`; None or an empty list is the identity.

    Returns
    -------
    Matrix
        4 rows of 4 floats, p_world = M p_object for column vectors.

    """
    product = IDENTITY
    for step in transforms or ():
        product = multiplied(step.matrix(), product)
    return product
