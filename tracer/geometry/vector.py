"""Arithmetic of :class:`tracer.types.Vec3`: small functions that disappear into their callers."""

import math
from typing import Any

import numpy as np

from tracer.jit import inline
from tracer.types import Vec3


@inline
def add(a: Vec3, b: Vec3) -> Vec3:
    """Sum."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inline
def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Difference a - b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inline
def scale(a: Vec3, s: float) -> Vec3:
    """Product with a number."""
    return Vec3(a.x * s, a.y * s, a.z * s)


@inline
def multiply(a: Vec3, b: Vec3) -> Vec3:
    """Product of coordinates, as of two colours."""
    return Vec3(a.x * b.x, a.y * b.y, a.z * b.z)


@inline
def negate(a: Vec3) -> Vec3:
    """Opposite vector."""
    return Vec3(-a.x, -a.y, -a.z)


@inline
def dot(a: Vec3, b: Vec3) -> float:
    """Scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inline
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Vector product."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inline
def length(a: Vec3) -> float:
    """Euclidean length."""
    return math.sqrt(dot(a, a))


@inline
def normalize(a: Vec3) -> Vec3:
    """Scale to unit length; a zero vector stays as it is.

    A vector whose square would leave the range of float64 is brought to unit maximum first.
    """
    squared = dot(a, a)
    if 1e-290 < squared < 1e290:  # well inside the range, where one division by the length is accurate
        return scale(a, 1.0 / math.sqrt(squared))
    largest = max(abs(a.x), abs(a.y), abs(a.z))
    if not (0.0 < largest < math.inf):
        return a
    b = Vec3(a.x / largest, a.y / largest, a.z / largest)
    return scale(b, 1.0 / length(b))


@inline
def is_zero(a: Vec3) -> bool:
    """Tell whether all three are zero."""
    return a.x == 0.0 and a.y == 0.0 and a.z == 0.0


@inline
def is_black(a: Vec3) -> bool:
    """Tell whether a colour adds nothing."""
    return a.x <= 0.0 and a.y <= 0.0 and a.z <= 0.0


@inline
def largest(a: Vec3) -> float:
    """Greatest coordinate."""
    return max(a.x, a.y, a.z)


@inline
def at(array: Any, i: int) -> Vec3:
    """Three neighbours of a flat array, as float64."""
    return Vec3(np.float64(array[i]), np.float64(array[i + 1]), np.float64(array[i + 2]))
