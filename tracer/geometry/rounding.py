"""Bounds on rounding errors.

Every tolerance of the tracer is built from :data:`EPSILON` by counting roundings; there is no other.

Sources: Higham, "Accuracy and Stability of Numerical Algorithms", 3.1 (gamma); Pharr, Jakob and Humphreys, "Physically
Based Rendering", 6.8; Rump 2009 (successor).
"""

from typing import Final

from tracer.jit import inline

EPSILON: Final = 2.0**-53  # unit roundoff of float64: the largest relative error of one rounding to nearest
SMALLEST: Final = 5e-324  # smallest positive float64
_SUCCESSOR: Final = EPSILON * (1.0 + 2.0 * EPSILON)


def gamma(n: int) -> float:
    """Bound the relative error of ``n`` roundings in a row: n eps / (1 - n eps). For constants, not for kernels."""
    return n * EPSILON / (1.0 - n * EPSILON)


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
