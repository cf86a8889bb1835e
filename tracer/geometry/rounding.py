"""Bounds on rounding errors.

Every tolerance of the tracer is built from :data:`EPSILON` by counting roundings; there is no other.

Invariant: no kernel is here, so what bounds need outside kernels costs no compiler.

Sources: Higham, "Accuracy and Stability of Numerical Algorithms", 3.1 (gamma); Pharr, Jakob and Humphreys, "Physically
Based Rendering", 6.8.
"""

from typing import Final

EPSILON: Final = 2.0**-53  # unit roundoff of float64: the largest relative error of one rounding to nearest
SMALLEST: Final = 5e-324  # smallest positive float64


def gamma(n: int) -> float:
    """Bound the relative error of ``n`` roundings in a row: n eps / (1 - n eps). For constants, not for kernels."""
    return n * EPSILON / (1.0 - n * EPSILON)
