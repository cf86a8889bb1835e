"""exp, log, power, sin, cos and rsqrt against mpmath, lane by lane, to the bounds that the module states."""

import mpmath
import numpy as np
import pytest

from tracer import simd
from tracer.jit import kernel

address_of, load, store = simd.address_of, simd.load, simd.store
BOUNDS = {  # ulp: float64, float32; and mpmath's own function
    "exp": (1.0, 1.0, mpmath.exp),
    "log": (1.0, 1.0, mpmath.log),
    "sin": (1.0, 1.0, mpmath.sin),
    "cos": (1.0, 1.0, mpmath.cos),
    "rsqrt": (1.5, 1.5, lambda x: 1 / mpmath.sqrt(x)),
}


def unary(function, vector):
    size = vector.dtype.bitwidth // 8

    @kernel
    def run(values, results):
        source, target = address_of(values), address_of(results)
        for i in range(0, values.shape[0], 8):
            store(target + size * i, function(load(vector, source + size * i)))

    return run


KERNELS = {
    (name, dtype): unary(getattr(simd, name), vector)
    for name in BOUNDS
    for dtype, vector in ((np.float64, simd.float64x8), (np.float32, simd.float32x8))
}
exp, power, sin = simd.exp, simd.power, simd.sin
float64x8, float32x8 = simd.float64x8, simd.float32x8


@kernel
def power64(bases, exponents, results):
    a, b, c = address_of(bases), address_of(exponents), address_of(results)
    for i in range(0, bases.shape[0], 8):
        store(c + 8 * i, power(load(float64x8, a + 8 * i), load(float64x8, b + 8 * i)))


@kernel
def power32(bases, exponents, results):
    a, b, c = address_of(bases), address_of(exponents), address_of(results)
    for i in range(0, bases.shape[0], 8):
        store(c + 4 * i, power(load(float32x8, a + 4 * i), load(float32x8, b + 4 * i)))


@kernel
def scalars(x):
    return exp(x), sin(x), power(x, x)


def worst_ulp(results, exact):
    """The largest distance in units in the last place; exceptional results must be equal."""
    dtype = results.dtype.type
    worst = 0.0
    for got, want in zip(results.tolist(), exact, strict=True):
        rounded = dtype(float(want))
        if not np.isfinite(rounded) or want == 0:
            assert got == rounded or (np.isnan(got) and np.isnan(rounded)), (got, rounded)
            continue
        unit = mpmath.mpf(float(np.spacing(abs(rounded))))
        worst = max(worst, float(abs(mpmath.mpf(got) - want) / unit))
    return worst


def arguments(name, rng, dtype):
    single = dtype == np.float32
    n = 800
    if name == "exp":
        wide = rng.uniform(-103, 88.7, n) if single else rng.uniform(-745, 709.7, n)
        return np.concatenate([wide, rng.uniform(-2, 2, n), rng.normal(size=n) * 1e-9])
    if name in {"log", "rsqrt"}:
        wide = np.exp(rng.uniform(-80, 80, n)) if single else np.exp(rng.uniform(-700, 700, n))
        tiny = np.full(8, 1e-42 if single else 5e-320)
        return np.concatenate([wide, 1 + rng.normal(size=n) * 1e-2, 1 + rng.normal(size=n) * 1e-7, tiny])
    multiples = np.round(rng.uniform(-(2**20), 2**20, n) * 2 / np.pi) * (np.pi / 2)
    special = np.array([-45.553093477052, 1308.4733402201489, 2.0**20, 2.0**20 + 1, 1e-310, 0.7, 1e5, -1e15])
    return np.concatenate([rng.uniform(-7, 7, n), multiples, rng.uniform(-1e9, 1e9, 80), special])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", list(BOUNDS))
def test_within_the_stated_bound(name, dtype):
    values = arguments(name, np.random.default_rng(7), dtype).astype(dtype)
    results = np.zeros_like(values)
    KERNELS[name, dtype](values, results)
    bound64, bound32, reference = BOUNDS[name]
    with mpmath.workprec(200):
        exact = [reference(mpmath.mpf(float(x))) for x in values]
        assert worst_ulp(results, exact) <= (bound64 if dtype == np.float64 else bound32)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_power(dtype):
    rng = np.random.default_rng(3)
    n = 800
    near_one = 1 - rng.random(n) ** 2 * 1e-3  # what a Blinn-Phong highlight asks: cosines near 1, large exponents
    bases = np.concatenate([near_one, rng.random(n), np.exp(rng.uniform(-60, 60, n))]).astype(dtype)
    exponents = np.concatenate([np.exp(rng.uniform(0, 13, n)), np.exp(rng.uniform(0, 4, n)), rng.uniform(-1.4, 1.4, n)])
    exponents = exponents.astype(dtype)
    results = np.zeros_like(bases)
    (power64 if dtype == np.float64 else power32)(bases, exponents, results)
    with mpmath.workprec(300):
        exact = [mpmath.power(float(x), float(y)) for x, y in zip(bases, exponents, strict=True)]
        assert worst_ulp(results, exact) <= (2.0 if dtype == np.float64 else 1.0)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0, 1e3, 1e6, 1e9])
def test_power_of_the_sharpest_highlights(exponent):
    """N19: bases from 0 to 1 and close to 1, every exponent that a scene may have."""
    rng = np.random.default_rng(9)
    bases = [0.0, 1e-300, 1.0, 1.0 - 2.0**-53, *rng.random(50), *(1.0 - rng.random(58) * 1e-8)]
    bases, results = np.array(bases), np.zeros(112)
    power64(bases, np.full(112, exponent), results)
    for base, found in zip(bases.tolist(), results.tolist(), strict=True):
        with mpmath.workprec(300):
            exact = mpmath.power(mpmath.mpf(base), exponent)
            assert abs(found - exact) <= 8 * 2.0**-52 * exact + 5e-324


def test_power_to_the_ends_of_the_range():
    rng = np.random.default_rng(4)
    bases = np.exp(rng.uniform(-700, 700, 800))
    exponents = rng.uniform(-745, 709, 800) / np.log(bases)
    results = np.zeros_like(bases)
    power64(bases, exponents, results)
    with mpmath.workprec(300):
        exact = [mpmath.power(float(x), float(y)) for x, y in zip(bases, exponents, strict=True)]
        assert worst_ulp(results, exact) <= 2.0


def test_power_exceptions():
    inf, nan = np.inf, np.nan
    bases = np.array([0.0, 0.0, 0.0, 1.0, inf, inf, -1.0, nan, 2.0, 0.5, 2.0, 2.0, nan, 1.0, 5e-324, 1e300])
    exponents = np.array([0.0, 2.0, -2.0, inf, 2.0, -2.0, 2.0, 2.0, 2000.0, 2000.0, -inf, nan, 0.0, nan, 1.0, 2.0])
    want = np.array([1.0, 0.0, inf, 1.0, inf, 0.0, nan, nan, inf, 0.0, 0.0, nan, 1.0, 1.0, 5e-324, inf])
    results = np.zeros_like(bases)
    power64(bases, exponents, results)
    np.testing.assert_array_equal(results, want)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_exceptional_arguments(dtype):
    values = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e4, -1e4], dtype)
    inf, nan = np.inf, np.nan
    want = {
        "exp": [nan, inf, 0, 1, 1, np.exp(dtype(-1)), inf, 0],
        "log": [nan, inf, nan, -inf, -inf, nan, np.log(dtype(1e4)), nan],
        "sin": [nan, nan, nan, 0, 0, *np.sin(values[5:].astype(np.float64))],
        "rsqrt": [nan, 0, nan, inf, -inf, nan, dtype(0.01), nan],
    }
    for name, expected in want.items():
        results = np.zeros_like(values)
        KERNELS[name, dtype](values, results)
        np.testing.assert_allclose(results, np.array(expected, dtype), rtol=2e-7 if dtype == np.float32 else 1e-15)


def test_one_source_for_scalars_and_lanes():
    values = np.linspace(0.1, 5, 8)
    for name, lane in (("exp", 0), ("sin", 1)):
        results = np.zeros(8)
        KERNELS[name, np.float64](values, results)
        assert results.tolist() == [scalars(x)[lane] for x in values]
    assert isinstance(scalars(np.float32(0.5))[0], float)
