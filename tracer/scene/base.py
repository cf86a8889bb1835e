"""Base of all models of the scene document, and its small value types: numbers, names, vectors, colours, rows.

Invariant: what is validated here is finite, in range, of exactly the type that the document's text showed (no text or
boolean taken for a number), and immutable. Arrays of numbers are checked in one pass over the flattened values,
because validating each row as a value of its own is several times slower and can raise a million errors.
"""

import math
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    Strict,
    WithJsonSchema,
)

from tracer.scene.faults import Fault, faults_error, shown
from tracer.scene.limits import (
    MAX_COLOR,
    MAX_COORDINATE,
    MAX_NAME_LENGTH,
    MAX_ROW_FAULTS,
    MAX_TEXTURE_COORDINATE,
    MIN_LENGTH,
)

Row = tuple[float, ...]
T = TypeVar("T")


class SceneModel(BaseModel):
    """Base of all models: immutable, and unknown members are faults."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, hide_input_in_errors=True)


# --- scalars ------------------------------------------------------------------------------------------------------

Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
"""Any finite number; whole numbers become floats, texts and booleans are refused."""

Coordinate = Annotated[Number, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Length = Annotated[Number, Field(ge=MIN_LENGTH, le=MAX_COORDINATE)]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]


def _check_name(value: str) -> str:
    """Refuse control characters: names are shown in terminals, logs and pages."""
    if any(ord(character) < 32 or ord(character) == 127 for character in value):
        raise faults_error([Fault("", "holds a control character", "a name of printable characters")])
    return value


Name = Annotated[str, Strict(), Field(min_length=1, max_length=MAX_NAME_LENGTH), AfterValidator(_check_name)]
"""Name of a material, asset, group or object: 1 to 256 printable characters."""


def at_most(count: int) -> BeforeValidator:
    """Refuse arrays and objects of more than `count` members before any of them is looked at.

    pydantic looks at all of them first: 15 million numbers where objects belong would cost minutes and gigabytes.
    """

    def check(value: object) -> object:
        if isinstance(value, list | tuple | dict) and len(value) > count:
            raise faults_error([Fault("", f"has {len(value)} items", f"at most {count} items")])
        return value

    return BeforeValidator(check)


# --- arrays of numbers --------------------------------------------------------------------------------------------


def _number_fault(value: object, kind: type[float] | type[int], low: float, high: float, expected: str) -> Fault | None:
    """Fault of one number that is not of `kind` or not in [low, high], else None."""
    allowed = (int,) if kind is int else (int, float)
    if isinstance(value, bool) or not isinstance(value, allowed):
        return Fault("", f"is {shown(value)}", expected)
    if not low <= value <= high:  # also false for NaN
        return Fault("", f"is {shown(value)}", expected)
    return None


def checked_row(
    value: object, width: int, kind: type[float] | type[int], low: float, high: float, expected: str, item: str
) -> list[Fault]:
    """Faults of one array of `width` numbers, with pointers relative to it."""
    if not isinstance(value, list | tuple):
        return [Fault("", f"is {shown(value)}", expected)]
    if len(value) != width:
        return [Fault("", f"has {len(value)} items", expected)]
    found = ((index, _number_fault(number, kind, low, high, item)) for index, number in enumerate(value))
    return [fault.below(f"/{index}") for index, fault in found if fault is not None]


def checked_rows(
    value: object,
    width: int,
    kind: type[float] | type[int],
    low: float,
    high: float,
    expected: str,
    item: str,
) -> tuple[tuple[Any, ...], ...]:
    """Rows of numbers, from an array of arrays.

    Parameters
    ----------
    value : object
        What stood in the document.
    width : int
        Numbers in a row.
    kind : type
        `float` (whole numbers become floats) or `int` (numbers with a point are refused).
    low, high : float
        Inclusive range of each number.
    expected, item : str
        Texts for the faults: what a row and what one number should be.

    Returns
    -------
    tuple of tuple
        One tuple of `width` numbers a row.

    Raises
    ------
    PydanticCustomError
        With the first `MAX_ROW_FAULTS` faults.

    """
    if not isinstance(value, list | tuple):
        raise faults_error([Fault("", f"is {shown(value)}", f"an array, each item {expected}")])
    if _is_flat(value, width):
        flat = list(chain.from_iterable(value))
        allowed = {int} if kind is int else {int, float}
        # min and max ignore a NaN that is not first, so finiteness is asked for by the sum's own test.
        if set(map(type, flat)) <= allowed and (
            not flat or (min(flat) >= low and max(flat) <= high and all(map(math.isfinite, flat)))
        ):
            numbers = iter(flat) if kind is int else map(float, flat)
            return tuple(zip(*[numbers] * width, strict=True))
    faults: list[Fault] = []
    for index, row in enumerate(value):
        faults += [fault.below(f"/{index}") for fault in checked_row(row, width, kind, low, high, expected, item)]
        if len(faults) >= MAX_ROW_FAULTS:
            break
    if faults:
        raise faults_error(faults[:MAX_ROW_FAULTS])
    return tuple(tuple(kind(number) for number in row) for row in value)


def _is_flat(rows: Sequence[object], width: int) -> bool:
    """Whether all rows are arrays of `width` items."""
    return set(map(type, rows)) <= {list, tuple} and set(map(len, rows)) <= {width}  # type: ignore[arg-type]


def _row_schema(width: int, item: dict[str, object]) -> dict[str, object]:
    return {"type": "array", "items": item, "minItems": width, "maxItems": width}


def _range_schema(low: float, high: float) -> dict[str, object]:
    return {"type": "number", "minimum": low, "maximum": high}


def row_validator(width: int, low: float, high: float, expected: str, item: str) -> Callable[[object], Row]:
    """Make a validator of one row of floats in [low, high]."""

    def check(value: object) -> Row:
        faults = checked_row(value, width, float, low, high, expected, item)
        if faults:
            raise faults_error(faults)
        assert isinstance(value, list | tuple)
        return tuple(float(number) for number in value)

    return check


def rows_validator(
    width: int, kind: type[float] | type[int], low: float, high: float, expected: str, item: str
) -> Callable[[object], tuple[Row, ...]]:
    """Make a validator of an array of rows of numbers in [low, high]."""

    def check(value: object) -> tuple[Row, ...]:
        return checked_rows(value, width, kind, low, high, expected, item)

    return check


_COORDINATE_TEXT = "a finite number from -1e30 to 1e30"
_POINT_TEXT = f"three numbers [x, y, z], each {_COORDINATE_TEXT}"
_COORDINATE_SCHEMA = _range_schema(-MAX_COORDINATE, MAX_COORDINATE)
_check_point = row_validator(3, -MAX_COORDINATE, MAX_COORDINATE, _POINT_TEXT, _COORDINATE_TEXT)

Vector = Annotated[
    tuple[float, float, float], PlainValidator(_check_point), WithJsonSchema(_row_schema(3, _COORDINATE_SCHEMA))
]
"""Three coordinates [x, y, z]."""


def _check_direction(value: object) -> Row:
    """Three coordinates that have a direction."""
    vector = _check_point(value)
    if math.hypot(*vector) < MIN_LENGTH:
        raise faults_error([Fault("", "has no direction: its length is zero", "three numbers [x, y, z], not all zero")])
    return vector


Direction = Annotated[
    tuple[float, float, float], PlainValidator(_check_direction), WithJsonSchema(_row_schema(3, _COORDINATE_SCHEMA))
]
"""Three coordinates, not all zero; any length, since only the direction counts."""

_COLOR_ITEM = f"a finite number from 0 to {MAX_COLOR:g}"
_COLOR_TEXT = f"{_COLOR_ITEM}, or three of them [r, g, b]"
_COLOR_SCHEMA = _range_schema(0.0, MAX_COLOR)
_check_triple = row_validator(3, 0.0, MAX_COLOR, _COLOR_TEXT, _COLOR_ITEM)


def _check_color(value: object) -> Row:
    """One number for all three channels, or three numbers."""
    if isinstance(value, list | tuple):
        return _check_triple(value)
    fault = _number_fault(value, float, 0.0, MAX_COLOR, _COLOR_TEXT)
    if fault is not None:
        raise faults_error([fault])
    return (float(value),) * 3  # type: ignore[arg-type]


Rgb = Annotated[
    tuple[float, float, float],
    PlainValidator(_check_color),
    WithJsonSchema({"anyOf": [_COLOR_SCHEMA, _row_schema(3, _COLOR_SCHEMA)]}),
]
"""Linear RGB: one number >= 0 for all channels, or [r, g, b]; always three numbers once validated."""


def _rows_type_schema(width: int, item: dict[str, object]) -> dict[str, object]:
    return {"type": "array", "items": _row_schema(width, item)}


Points = Annotated[
    tuple[tuple[float, float, float], ...],
    PlainValidator(rows_validator(3, float, -MAX_COORDINATE, MAX_COORDINATE, _POINT_TEXT, _COORDINATE_TEXT)),
    WithJsonSchema(_rows_type_schema(3, _COORDINATE_SCHEMA)),
]
"""Array of points or vectors, (n, 3)."""

TextureCoordinates = Annotated[
    tuple[tuple[float, float], ...],
    PlainValidator(
        rows_validator(
            2,
            float,
            -MAX_TEXTURE_COORDINATE,
            MAX_TEXTURE_COORDINATE,
            "two numbers [u, v]",
            f"a finite number from -{MAX_TEXTURE_COORDINATE:g} to {MAX_TEXTURE_COORDINATE:g}",
        )
    ),
    WithJsonSchema(_rows_type_schema(2, _range_schema(-MAX_TEXTURE_COORDINATE, MAX_TEXTURE_COORDINATE))),
]
"""Array of texture coordinates, (n, 2)."""

Colors = Annotated[
    tuple[tuple[float, float, float], ...],
    PlainValidator(
        rows_validator(3, float, 0.0, MAX_COLOR, f"three numbers [r, g, b], each {_COLOR_ITEM}", _COLOR_ITEM)
    ),
    WithJsonSchema(_rows_type_schema(3, _COLOR_SCHEMA)),
]
"""Array of linear RGB colours, (n, 3)."""

_INDEX_TEXT = "a whole number from 0, the index of a vertex"

Faces = Annotated[
    tuple[tuple[int, int, int], ...],
    PlainValidator(
        rows_validator(3, int, 0, 2**31 - 1, f"three vertex indices [i, j, k], each {_INDEX_TEXT}", _INDEX_TEXT)
    ),
    WithJsonSchema(_rows_type_schema(3, {"type": "integer", "minimum": 0, "maximum": 2**31 - 1})),
]
"""Array of triangles, (n, 3) vertex indices."""
