"""exp, log, pow, sin, cos and rsqrt on lanes and on scalars, to a stated accuracy.

Bounds, in units in the last place of the result, over every finite argument of the domain; the tests measure them
against mpmath, lane by lane:

========== ======= ======= ===================================================================================
function   float64 float32 domain and exceptions
========== ======= ======= ===================================================================================
`exp`      1       1       all; overflow to inf, underflow through the denormals to 0
`log`      1       1       x >= 0, denormals too; log(0) = -inf, NaN below 0
`power`    2       1       x >= 0; x**0 = 1, 0**y = 0 or inf, NaN below 0 (the full libm rules for x < 0 are not ours)
`sin`,     1       1       all; beyond 2**20 the C library's function is called, lane by lane
`cos`
`rsqrt`    1.5     1.5     x >= 0; 1/0 = inf; a correctly rounded root and a correctly rounded quotient
========== ======= ======= ===================================================================================

A NaN comes out as NaN. float32 is computed in float64 lanes and rounded once: half the lanes a register, but no
compensated arithmetic. Polynomials are plain Taylor and atanh series, cut where the rest is below 2**-58 of the sum;
Horner without fused multiply-add, so that every CPU gives the same bits, and :func:`~tracer.simd.arithmetic.fma`
where exactness needs it.

Source: argument reductions after Muller et al., Handbook of Floating-Point Arithmetic, 2nd ed., ch. 10-11; the
two-step scaling and the split of ln 2 as in fdlibm.
"""

import math
from typing import Any, Final

from tracer.jit import inline
from tracer.simd.arithmetic import (
    absolute,
    convert,
    fma,
    from_bits,
    full_like,
    is_single,
    libm_cos,
    libm_sin,
    maximum,
    minimum,
    narrow_like,
    sqrt,
    to_bits,
    widen,
)
from tracer.simd.gateway import types
from tracer.simd.lanes import any_lane, select

# numba reads these globals when it compiles
_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

_LOG2_E: Final = 1.4426950408889634
_LN2_HIGH: Final = 6.93147180369123816490e-01  # 33 bits: exact times any exponent
_LN2_LOW: Final = 1.90821492927058770002e-10  # ln 2 - _LN2_HIGH, rounded
_LN2_LOWEST: Final = 5.497923018708371e-27  # what is left of ln 2 after both (mpmath)
_EXP_MIN: Final = -746.0  # exp below is 0, above _EXP_MAX infinite
_EXP_MAX: Final = 710.0
_ROUNDER: Final = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to an integer
_MANTISSA: Final = 0x000FFFFFFFFFFFFF
_SQRT_HALF_BITS: Final = 0x3FE6A09E667F3BCD  # float64 bits of the least mantissa, sqrt(1/2)
_ONE_BITS: Final = 0x3FF0000000000000
_TWO_54: Final = 18014398509481984.0
_LEAST_NORMAL: Final = 2.2250738585072014e-308
_THIRD: Final = 1.0 / 3.0
_THIRD_LOW: Final = 1.850371707708594e-17  # 1/3 - _THIRD
_INF: Final = math.inf
_NAN: Final = math.nan

_TWO_OVER_PI: Final = 0.6366197723675814
_HALF_PI_1: Final = 1.5707963267948966  # pi / 2 = _1 + _2 + _3
_HALF_PI_2: Final = 6.123233995736766e-17
_HALF_PI_3: Final = -1.4973849048591833e-33
_REDUCE_MAX: Final = 1048576.0  # up to 2**20, n * _HALF_PI_1 has its last bit at 2**-52 and x - n * _HALF_PI_1 is exact


@inline
def _two_to(exponent: Any) -> Any:
    """2**exponent for float64 integers within -1022 .. 1023."""
    # by way of int32: AVX2 converts no 64-bit integers
    biased = convert(_int64, convert(_int32, exponent) + 1023)
    return from_bits(biased << 52)


@inline
def _exp_sum(high: Any, low: Any) -> Any:
    """exp(high + low) for float64, ``|low|`` far below ``|high|`` or both small."""
    high = maximum(full_like(high, _EXP_MIN), minimum(full_like(high, _EXP_MAX), high))  # keeps a NaN
    valid = high == high  # noqa: PLR0124 - false for NaN alone
    exponent = select(valid, (high * _LOG2_E + _ROUNDER) - _ROUNDER, full_like(high, 0.0))
    r = (high - exponent * _LN2_HIGH) - (exponent * _LN2_LOW - low)  # |r| <= ln(2) / 2
    # sum of r**k / k!, k = 2 .. 13; the next term is below 2**-57
    tail = r * 1.6059043836821613e-10 + 2.08767569878681e-09
    tail = tail * r + 2.505210838544172e-08
    tail = tail * r + 2.755731922398589e-07
    tail = tail * r + 2.7557319223985893e-06
    tail = tail * r + 2.48015873015873e-05
    tail = tail * r + 1.984126984126984e-04
    tail = tail * r + 1.3888888888888889e-03
    tail = tail * r + 8.3333333333333333e-03
    tail = tail * r + 4.1666666666666664e-02
    tail = tail * r + 0.16666666666666666
    tail = tail * r + 0.5
    value = (r * r * tail + r) + 1.0
    # in two steps, because 2**exponent alone can leave float64's range
    half = (exponent * 0.5 + _ROUNDER) - _ROUNDER
    return (value * _two_to(half)) * _two_to(exponent - half)


@inline
def _split_mantissa(x: Any) -> Any:
    """(mantissa in [sqrt(1/2), sqrt(2)), exponent as float64) of positive finite float64, denormals too."""
    small = x < _LEAST_NORMAL
    bits = to_bits(select(small, x * _TWO_54, x)) + (_ONE_BITS - _SQRT_HALF_BITS)
    exponent = convert(_float64, convert(_int32, bits >> 52) - 1023)
    mantissa = from_bits((bits & _MANTISSA) + _SQRT_HALF_BITS)
    return mantissa, select(small, exponent - 54.0, exponent)


@inline
def _log_exceptions(x: Any, value: Any) -> Any:
    value = select(x == 0.0, full_like(x, -_INF), value)
    value = select(x == _INF, full_like(x, _INF), value)
    return select(x >= 0.0, value, full_like(x, _NAN))


@inline
def _log64(x: Any) -> Any:
    mantissa, exponent = _split_mantissa(x)
    f = mantissa - 1.0
    s = f / (mantissa + 1.0)
    z = s * s  # log(mantissa) = 2 atanh(s) = 2 s (1 + z/3 + z**2/5 + ...), z <= 0.0295: the 12th term is below 2**-58
    rest = z * (2.0 / 23.0) + 2.0 / 21.0
    rest = rest * z + 2.0 / 19.0
    rest = rest * z + 2.0 / 17.0
    rest = rest * z + 2.0 / 15.0
    rest = rest * z + 2.0 / 13.0
    rest = rest * z + 2.0 / 11.0
    rest = rest * z + 2.0 / 9.0
    rest = rest * z + 2.0 / 7.0
    rest = rest * z + 2.0 / 5.0
    rest = (rest * z + 2.0 / 3.0) * z
    # 2 s = f - s f, and s f = f**2/2 - s f**2/2: the large part of the result is then f itself, exact
    half_square = 0.5 * f * f
    value = exponent * _LN2_HIGH - ((half_square - (s * (half_square + rest) + exponent * _LN2_LOW)) - f)
    return _log_exceptions(x, value)


@inline
def _log_pair(x: Any) -> Any:
    """log(x) of positive finite float64 as an unevaluated sum (high, low), good to 2**-64 of it."""
    mantissa, exponent = _split_mantissa(x)
    f = mantissa - 1.0
    above = mantissa + 1.0
    below = mantissa - (above - 1.0)
    s = f / above
    s_low = (fma(-s, above, f) - s * below) / above
    z = s * s
    z_low = fma(s, s, -z) + 2.0 * s * s_low
    # 1/3 + z/5 + z**2/7 + ...: from z/5 on plain float64 will do, for it is below 0.006
    rest = z * (1.0 / 23.0) + 1.0 / 21.0
    rest = rest * z + 1.0 / 19.0
    rest = rest * z + 1.0 / 17.0
    rest = rest * z + 1.0 / 15.0
    rest = rest * z + 1.0 / 13.0
    rest = rest * z + 1.0 / 11.0
    rest = rest * z + 1.0 / 9.0
    rest = rest * z + 1.0 / 7.0
    rest = (rest * z + 1.0 / 5.0) * z
    sum_high = rest + _THIRD
    sum_low = (rest - (sum_high - _THIRD)) + _THIRD_LOW
    t = z * sum_high
    t_low = fma(z, sum_high, -t) + (z * sum_low + z_low * sum_high)
    p = s * t
    p_low = fma(s, t, -p) + (s * t_low + s_low * t)
    high = s + p
    low = (p - (high - s)) + (s_low + p_low)
    # exponent ln 2 + 2 (high + low)
    base = exponent * _LN2_HIGH
    double = 2.0 * high
    total = base + double
    back = total - base
    error = (base - (total - back)) + (double - back)
    scale = exponent * _LN2_LOW
    scale_low = fma(exponent, full_like(x, _LN2_LOW), -scale) + exponent * _LN2_LOWEST
    low = error + (2.0 * low + scale_low)
    result = total + scale
    back = result - total
    low = ((total - (result - back)) + (scale - back)) + low
    high = result + low
    return high, low - (high - result)


@inline
def _power_exceptions(x: Any, y: Any, value: Any) -> Any:
    value = select((x == 1.0) | (y == 0.0), full_like(x, 1.0), value)
    empty = x == 0.0
    value = select(empty & (y > 0.0), full_like(x, 0.0), value)
    value = select(empty & (y < 0.0), full_like(x, _INF), value)
    endless = x == _INF
    value = select(endless & (y > 0.0), full_like(x, _INF), value)
    value = select(endless & (y < 0.0), full_like(x, 0.0), value)
    return select((x >= 0.0) | (y == 0.0), value, full_like(x, _NAN))


@inline
def _sin_cos64(x: Any) -> Any:
    """(sin, cos) of float64."""
    huge = absolute(x) > _REDUCE_MAX
    far = huge | (x != x)  # noqa: PLR0124 - NaN, too
    inside = select(far, full_like(x, 0.0), x)
    n = (inside * _TWO_OVER_PI + _ROUNDER) - _ROUNDER
    first = fma(-n, full_like(x, _HALF_PI_1), inside)  # exact
    # r + low = first - n * (_2 + _3): near a multiple of pi/2 the two large parts cancel, so both roundings are kept
    second = n * _HALF_PI_2
    second_low = fma(n, full_like(x, _HALF_PI_2), -second) + n * _HALF_PI_3
    r = first - second
    back = r - first
    low = ((first - (r - back)) - (second + back)) - second_low
    z = r * r
    # sum of the Taylor series on |r| <= pi/4; the next term is below 2**-62
    s = z * 2.8114572543455206e-15 - 7.647163731819816e-13
    s = s * z + 1.6059043836821613e-10
    s = s * z - 2.505210838544172e-08
    s = s * z + 2.7557319223985893e-06
    s = s * z - 1.984126984126984e-04
    s = s * z + 8.3333333333333333e-03
    s = s * z - 0.16666666666666666
    half = 0.5 * z
    sine = r + (r * z * s + (low - half * low))
    c = z * 4.779477332387385e-14 - 1.1470745597729725e-11
    c = c * z + 2.08767569878681e-09
    c = c * z - 2.755731922398589e-07
    c = c * z + 2.48015873015873e-05
    c = c * z - 1.3888888888888889e-03
    c = c * z + 4.1666666666666664e-02
    near = 1.0 - half
    cosine = near + (((1.0 - near) - half) + (z * z * c - r * low))
    quadrant = convert(_int64, convert(_int32, n))
    swapped = (quadrant & 1) != 0
    sine, cosine = select(swapped, cosine, sine), select(swapped, sine, cosine)
    sine = select((quadrant & 2) != 0, -sine, sine)
    cosine = select(((quadrant + 1) & 2) != 0, -cosine, cosine)
    if any_lane(far):
        sine = select(far, libm_sin(x), sine)
        cosine = select(far, libm_cos(x), cosine)
    return sine, cosine


@inline
def exp(x: Any) -> Any:
    """e**x.

    Parameters
    ----------
    x
        float32 or float64, scalar or lanes.

    Returns
    -------
    of the type of x
        To 1 ulp; 0 below about -745.13, infinite above about 709.78 (float64).
    """
    return narrow_like(x, _exp_sum(widen(x), full_like(widen(x), 0.0)))


@inline
def log(x: Any) -> Any:
    """Compute the natural logarithm.

    Parameters
    ----------
    x
        float32 or float64, scalar or lanes.

    Returns
    -------
    of the type of x
        To 1 ulp; -inf at 0, NaN below.
    """
    return narrow_like(x, _log64(widen(x)))


@inline
def power(x: Any, y: Any) -> Any:
    """x**y for x >= 0.

    Parameters
    ----------
    x, y
        Both float32 or both float64, scalars or lanes.

    Returns
    -------
    of the type of x
        To 2 ulp (float64) or 1 ulp (float32); NaN where x < 0 and y is not 0.
    """
    wide_x = widen(x)
    wide_y = widen(y)
    if is_single(x):  # float64's log is good to 2**-53 and |y log x| <= 104 where the result is finite
        value = _exp_sum(wide_y * _log64(wide_x), full_like(wide_x, 0.0))
    else:
        high, low = _log_pair(wide_x)
        product = wide_y * high
        rest = fma(wide_y, high, -product) + wide_y * low
        value = _exp_sum(product, select(absolute(product) < 800.0, rest, full_like(wide_x, 0.0)))
    return narrow_like(x, _power_exceptions(wide_x, wide_y, value))


@inline
def sin_cos(x: Any) -> Any:
    """Compute the sine and the cosine of an angle in radians.

    Parameters
    ----------
    x
        float32 or float64, scalar or lanes.

    Returns
    -------
    tuple
        (sine, cosine) of the type of x, to 1 ulp; NaN for infinities.
    """
    sine, cosine = _sin_cos64(widen(x))
    return narrow_like(x, sine), narrow_like(x, cosine)


@inline
def sin(x: Any) -> Any:
    """Compute the sine; see :func:`sin_cos`."""
    return sin_cos(x)[0]


@inline
def cos(x: Any) -> Any:
    """Compute the cosine; see :func:`sin_cos`."""
    return sin_cos(x)[1]


@inline
def rsqrt(x: Any) -> Any:
    """1 / sqrt(x), by a correctly rounded root and a correctly rounded quotient.

    No approximate instruction: those differ from CPU to CPU.

    Parameters
    ----------
    x
        float32 or float64, scalar or lanes.

    Returns
    -------
    of the type of x
        To 1.5 ulp; inf at 0, NaN below.
    """
    return full_like(x, 1.0) / sqrt(x)
