"""Every operation of tracer.simd on fixed inputs, compared with numpy; prints a digest. Run by test_lanes.py.

A program of its own because numba reads NUMBA_CPU_NAME once: each CPU needs its own process.
"""

import hashlib
import sys

import numba
import numpy as np

from tracer import simd
from tracer.jit import kernel
from tracer.simd import (
    absolute,
    address_of,
    all_lanes,
    any_lane,
    bitcast,
    compress,
    concatenate,
    convert,
    count_trailing_zeros,
    deinterleave,
    extract,
    float32x4,
    float32x8,
    float32x16,
    float64x4,
    float64x8,
    floor,
    fma,
    gather,
    insert,
    int32x8,
    int64x4,
    int64x8,
    iota,
    load,
    lower_half,
    mask8,
    mask_from_bits,
    mask_to_bits,
    maximum,
    minimum,
    permute,
    population_count,
    prefetch,
    reduce_add,
    reduce_max,
    reduce_min,
    select,
    splat,
    sqrt,
    stack_memory,
    store,
    transpose,
    upper_half,
)

float32, float64, int32, int64 = numba.float32, numba.float64, numba.int32, numba.int64
FLOAT_RESULTS, MASK_RESULTS = 12, 7


def float_kernel(vector, size):
    @kernel
    def run(a, b, c, out, masks):
        x, y, z = load(vector, address_of(a)), load(vector, address_of(b)), load(vector, address_of(c))
        o = address_of(out)
        row = 8 * size
        results = (x + y, x - y, x * y, x / y, -x, sqrt(x), absolute(x), floor(x))
        for i in range(8):
            store(o + i * row, results[i])
        store(o + 8 * row, fma(x, y, z))
        store(o + 9 * row, minimum(x, y))
        store(o + 10 * row, maximum(x, y))
        accumulated = x
        accumulated += 2.0 * y
        store(o + 11 * row, accumulated)
        masks[0] = mask_to_bits(x < y)
        masks[1] = mask_to_bits(x <= y)
        masks[2] = mask_to_bits(x > y)
        masks[3] = mask_to_bits(x >= y)
        masks[4] = mask_to_bits(x == y)
        masks[5] = mask_to_bits(x != y)
        masks[6] = mask_to_bits((x < y) & ~(x < z) | (y > z) ^ (x > z))
        return reduce_min(z), reduce_max(z), reduce_add(z), any_lane(z > 1e30), all_lanes(z < 1e30)

    return run


def expected_floats(a, b, c, exact_fma):
    with np.errstate(all="ignore"):
        rows = [a + b, a - b, a * b, a / b, -a, np.sqrt(a), np.abs(a), np.floor(a), exact_fma]
        rows += [np.where(a < b, a, b), np.where(a > b, a, b), a + a.dtype.type(2) * b]
        masks = [a < b, a <= b, a > b, a >= b, a == b, a != b, (a < b) & ~(a < c) | (b > c) ^ (a > c)]
    return np.array(rows), [int(np.packbits(mask, bitorder="little")[0]) for mask in masks]


@kernel
def moves(values, index, numbers, bits, out, wide, longs, scalars):
    v, n = load(float32x8, address_of(values)), load(int32x8, address_of(index))
    mask = mask_from_bits(mask8, bits)
    o = address_of(out)
    memory = stack_memory(64)
    store(memory, v)
    store(o, permute(v, n))
    store(o + 32, compress(v, mask))
    store(o + 64, select(mask, v, -v))
    store(o + 96, gather(float32x8, address_of(values), n, mask))
    store(o + 128, insert(load(float32x8, memory), 3, 7.0))
    both = concatenate(v, splat(float32x8, 1.5))
    store(o + 160, upper_half(both) + lower_half(both))
    store(o + 192, bitcast(float32x8, permute(bitcast(int32x8, v), n)))
    store(o + 224, convert(float32, iota(int32x8)))
    w = address_of(wide)
    store(w, convert(float64, v))
    store(w + 64, gather(float64x8, address_of(wide), n, mask))
    store(w + 128, compress(convert(float64, v), mask))
    store(w + 192, convert(float64, mask))
    k = address_of(longs)
    store(k, convert(int64, load(int32x8, address_of(numbers))))
    store(k + 64, compress(load(int64x8, k), mask) << 3)
    store(k + 128, convert(int64, convert(int32, v)) >> 1)
    prefetch(k)
    scalars[0] = extract(v, 5)
    scalars[1] = count_trailing_zeros(bits)
    scalars[2] = population_count(bits)
    scalars[3] = reduce_max(concatenate(v, v))
    scalars[4] = load(float32, address_of(values) + 8)
    return mask_to_bits(load(float32x16, o) == load(float32x16, o))


def matrix_kernel(vector, row):
    @kernel
    def run(values, columns, thirds):
        v, o = address_of(values), address_of(columns)
        turned = transpose(load(vector, v), load(vector, v + row), load(vector, v + 2 * row), load(vector, v + 3 * row))
        split = deinterleave(load(vector, v), load(vector, v + row), load(vector, v + 2 * row))
        for i in range(4):
            store(o + i * row, turned[i])
        for i in range(3):
            store(address_of(thirds) + i * row, split[i])

    return run


def check_matrices():
    for vector, dtype in ((float32x4, np.float32), (float64x4, np.float64), (int64x4, np.int64)):
        values = np.arange(16).astype(dtype).reshape(4, 4)
        columns, thirds = np.zeros((4, 4), dtype), np.zeros((3, 4), dtype)
        matrix_kernel(vector, 4 * values.itemsize)(values, columns, thirds)
        np.testing.assert_array_equal(columns, values.T)
        np.testing.assert_array_equal(thirds, np.arange(12).reshape(4, 3).T)


def check_floats(dtype, vector, digest):
    rng = np.random.default_rng(5)
    size = np.dtype(dtype).itemsize
    run = float_kernel(vector, size)
    special = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.5, 1e-40], dtype)
    for case in range(40):
        a, b, c = ((rng.normal(size=8) * 10.0 ** rng.integers(-18, 18)).astype(dtype) for _ in range(3))
        if case < 8:
            a, b = special, np.roll(special, case)
        out, masks = np.zeros((FLOAT_RESULTS, 8), dtype), np.zeros(MASK_RESULTS, np.int64)
        reductions = run(a, b, c, out, masks)
        with np.errstate(
            all="ignore"
        ):  # float64's product of float32 is exact; the sum is rounded twice: compare loosely
            product = a.astype(np.longdouble) * b.astype(np.longdouble) + c.astype(np.longdouble)
        want, bits = expected_floats(a, b, c, product.astype(dtype))
        np.testing.assert_array_equal(np.delete(out, 8, 0), np.delete(want, 8, 0))
        np.testing.assert_allclose(out[8], want[8], rtol=4 * np.finfo(dtype).eps, atol=0)
        assert masks.tolist() == bits
        halves = (c[:4] + c[4:])[:2] + (c[:4] + c[4:])[2:]
        assert reductions == (c.min(), c.max(), halves[0] + halves[1], c.max() > 1e30, c.max() < 1e30)
        digest.update(np.nan_to_num(out, nan=12345.0).tobytes() + masks.tobytes())


def check_moves(digest):
    rng = np.random.default_rng(6)
    for case in range(300):
        values = rng.normal(size=8).astype(np.float32) * 100
        index = rng.integers(0, 8, 8).astype(np.int32)
        numbers = rng.integers(-(2**31), 2**31 - 1, 8).astype(np.int32)
        bits = case % 256
        mask = np.array([bits >> i & 1 for i in range(8)], bool)
        count = int(mask.sum())
        out, wide, longs = np.zeros((8, 8), np.float32), np.zeros((4, 8)), np.zeros((3, 8), np.int64)
        scalars = np.zeros(5)
        assert moves(values, index, numbers, bits, out, wide, longs, scalars) == 0xFFFF
        np.testing.assert_array_equal(out[0], values[index])
        np.testing.assert_array_equal(out[1][:count], values[mask])
        np.testing.assert_array_equal(out[2], np.where(mask, values, -values))
        np.testing.assert_array_equal(out[3], np.where(mask, values[index], 0))
        np.testing.assert_array_equal(out[4], np.where(np.arange(8) == 3, 7, values))
        np.testing.assert_array_equal(out[5], values + np.float32(1.5))
        np.testing.assert_array_equal(out[6], values[index])
        np.testing.assert_array_equal(out[7], np.arange(8))
        np.testing.assert_array_equal(wide[0], values)
        np.testing.assert_array_equal(wide[1], np.where(mask, values[index], 0))
        np.testing.assert_array_equal(wide[2][:count], values[mask])
        np.testing.assert_array_equal(wide[3], mask)
        np.testing.assert_array_equal(longs[0], numbers)
        np.testing.assert_array_equal(longs[1][:count], numbers[mask].astype(np.int64) * 8)
        np.testing.assert_array_equal(longs[2], np.trunc(values).astype(np.int64) >> 1)
        lowest = bits & -bits
        assert scalars[0] == values[5]
        assert bits == 0 or scalars[1] == lowest.bit_length() - 1
        assert scalars[2:].tolist() == [count, values.max(), values[2]]
        digest.update(out[:1].tobytes() + out[2:].tobytes() + wide[0].tobytes() + longs[0].tobytes())


def main():
    digest = hashlib.sha256()
    check_floats(np.float32, float32x8, digest)
    check_floats(np.float64, float64x8, digest)
    check_moves(digest)
    check_matrices()
    rng = np.random.default_rng(8)
    elementary = np.array([simd_value(x) for x in rng.uniform(0.01, 30, 200)])
    digest.update(elementary.tobytes())
    sys.stdout.write(f"{digest.hexdigest()} {simd.features.register_bytes()}\n")


@kernel
def simd_value(x):
    return simd.exp(x) + simd.log(x) + simd.power(x, 0.37) + simd.sin(x) * simd.rsqrt(x)


if __name__ == "__main__":
    main()
