"""Bounds on rounding errors, and arithmetic without them.

Every tolerance of the tracer is built from :data:`EPSILON` by counting roundings; there is no other.

Sources: Higham, "Accuracy and Stability of Numerical Algorithms", 3.1 (gamma); Pharr, Jakob and Humphreys, "Physically
Based Rendering", 6.8; Dekker 1971 and Shewchuk 1997 (exact products and sums); Rump 2009 (successor).
"""

from typing import Final

from tracer.jit import inline

EPSILON: Final = 2.0**-53  # unit roundoff of float64: the largest relative error of one rounding to nearest
SMALLEST: Final = 5e-324  # smallest positive float64
_SPLITTER: Final = 134217729.0  # 2^27 + 1, Veltkamp's constant for 53 bits
_SUCCESSOR: Final = EPSILON * (1.0 + 2.0 * EPSILON)


def gamma(n: int) -> float:
    """Bound the relative error of ``n`` roundings in a row: n eps / (1 - n eps). For constants, not for kernels."""
    return n * EPSILON / (1.0 - n * EPSILON)


@inline
def two_product(a: float, b: float) -> tuple[float, float]:
    """Split a*b into its rounded value and the exact rest (Dekker's product; needs no FMA, so it is the same anywhere).

    Exact unless a partial product overflows (|a| or |b| above 2^996) or the rest underflows (|a b| below 2^-969).
    """
    product = a * b
    c = _SPLITTER * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = _SPLITTER * b
    b_high = c - (c - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@inline
def two_difference(a: float, b: float) -> tuple[float, float]:
    """Split a - b into its rounded value and the exact rest (Knuth)."""
    difference = a - b
    virtual = difference - a
    return difference, (a - (difference - virtual)) - (b + virtual)


@inline
def away(value: float, towards: float) -> float:
    """Next float64 after ``value`` in the direction of the sign of ``towards`` (or the one after it; Rump 2009).

    A zero ``towards`` leaves the value as it is.
    """
    step = abs(value) * _SUCCESSOR + SMALLEST
    if towards > 0.0:
        return value + step
    if towards < 0.0:
        return value - step
    return value
