"""Sobol points of many pixels and samples at once: :mod:`tracer.sampling.sobol` and `hashing` in lanes of 32 bits.

Invariant: bit for bit the points of :func:`tracer.sampling.sampler.sample_keyed`. Words are int32 lanes, whose products
wrap as those of unsigned words do.
"""

from typing import Any, Final

import numpy as np

from tracer.jit import inline, kernel
from tracer.sampling.sampler import sample_keyed
from tracer.simd import (
    any_lane,
    constant_table,
    convert,
    extract,
    float64x8,
    insert,
    int32x8,
    iota,
    load,
    reverse_bits,
    shift_right_logical,
    splat,
    store,
)
from tracer.simd.gateway import types
from tracer.types import SAMPLER_SOBOL

_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64

LANES: Final = 8
_TABLE_BITS: Final = 4
_BYTES: Final = 4 * LANES


def _signed(word: int) -> int:
    """Return the int32 with the bits of an unsigned word."""
    return word - (1 << 32) if word >= 1 << 31 else word


_M1: Final = _signed(0x55555555)
_M2: Final = _signed(0x33333333)
_M4: Final = _signed(0x0F0F0F0F)
_M8: Final = _signed(0x00FF00FF)
_M16: Final = _signed(0x0000FFFF)
_H1: Final = _signed(0xED5AD4BB)
_H2: Final = _signed(0xAC4C1B51)
_H3: Final = _signed(0x31848BAB)
_K1: Final = _signed(0x6C50B47C)
_K2: Final = _signed(0xB82F1E52)
_K3: Final = _signed(0xC7AFE638)
_K4: Final = _signed(0x8D22F6E6)
_SHUFFLE: Final = _signed(0x1B56C4E9)
_U: Final = _signed(0x7F4A7C15)
_V: Final = _signed(0x94D049BB)
_TOP: Final = _signed(0x80000000)


@inline
def _word(number: int) -> Any:
    return splat(int32x8, _int32(number))


@inline
def _right(x: Any, count: int) -> Any:
    return shift_right_logical(x, _int32(count))


@inline
def _hash(x: Any) -> Any:
    """As :func:`tracer.sampling.hashing.hash_word`."""
    x = x ^ _right(x, 17)
    x = x * _word(_H1)
    x = x ^ _right(x, 11)
    x = x * _word(_H2)
    x = x ^ _right(x, 15)
    x = x * _word(_H3)
    return x ^ _right(x, 14)


@inline
def _scramble(x: Any, key: Any) -> Any:
    """As :func:`tracer.sampling.sobol.scramble_reversed`."""
    x = x + key
    x = x ^ (x * _word(_K1))
    x = x ^ (x * _word(_K2))
    x = x ^ (x * _word(_K3))
    x = x ^ (x * _word(_K4))
    return reverse_bits(x)


@inline
def _bits_of(n_samples: int) -> int:
    """Bits that number the samples of a pixel."""
    bits = 0
    while (_int64(1) << bits) < n_samples:
        bits += 1
    return bits


@inline
def _shuffle(index: Any, key: Any, bits: int) -> Any:
    """As :func:`tracer.sampling.sobol.shuffle_index`."""
    if bits == 0:
        return _word(0)
    lift = splat(int32x8, _int32(_int64(1) << (32 - bits)))
    return shift_right_logical(_scramble(reverse_bits(index * lift), key), _int32(32 - bits))


@inline
def _second(index: Any, bits: int) -> Any:
    """As :func:`tracer.sampling.sobol.sobol_reversed_second`, of an index of some bits."""
    index = index ^ (_right(index, 1) & _word(_M1))
    index = index ^ (_right(index, 2) & _word(_M2))
    if bits > 4:
        index = index ^ (_right(index, 4) & _word(_M4))
        index = index ^ (_right(index, 8) & _word(_M8))
        index = index ^ (_right(index, 16) & _word(_M16))
    return index


@inline
def _store_unit(address: int, x: Any) -> None:
    """Write words as numbers in [0, 1)."""
    signed = convert(_float64, x ^ _word(_TOP))
    store(address, (signed + 2.0**31) * 2.0**-32)


def _shuffles() -> bytes:
    """Owen-shuffled indices below 16, int32: a row for each value of the key's four lowest bits, which decide alone."""
    backwards = np.array([int(f"{index:04b}"[::-1], 2) for index in range(1 << _TABLE_BITS)])
    x = backwards + np.arange(1 << _TABLE_BITS)[:, np.newaxis]
    for factor in (_K1, _K2, _K3, _K4):
        x = (x ^ (x * factor)) % (1 << _TABLE_BITS)
    return backwards[x].astype(np.int32).tobytes()


_shuffled_indices = constant_table("shuffled_indices", _shuffles())


@inline
def place_in_pixel(n_samples: int, key: int, first: int, n: int, px: int, py: int, xs: int, ys: int) -> None:
    """Write where Sobol points of one pixel lie in the picture.

    Parameters
    ----------
    n_samples, key
        As `fill_samples`.
    first, n
        First sample; how many, a multiple of eight.
    px, py
        The pixel.
    xs, ys
        Addresses of float64: where the coordinates go, in pixels.
    """
    words = insert(insert(_word(_SHUFFLE), _int64(1), _int32(_U)), _int64(2), _int32(_V))
    words = _hash(words ^ splat(int32x8, _int32(key)))
    for_u, for_v = splat(int32x8, extract(words, _int64(1))), splat(int32x8, extract(words, _int64(2)))
    shuffle = extract(words, _int64(0))
    bits = _bits_of(n_samples)
    row = _shuffled_indices() + (_int64(shuffle) & ((1 << _TABLE_BITS) - 1)) * (4 << _TABLE_BITS)
    middle_x, middle_y = splat(float64x8, px + 0.5), splat(float64x8, py + 0.5)  # of what words are, signed
    step = splat(float64x8, 2.0**-32)
    for k in range(n // LANES):
        at_lanes = _int64(first) + LANES * k
        if bits == _TABLE_BITS:
            index = load(int32x8, row + 4 * at_lanes)
        else:
            index = _shuffle(iota(int32x8) + splat(int32x8, _int32(at_lanes)), splat(int32x8, shuffle), bits)
        u, v = _scramble(index, for_u), _scramble(_second(index, bits), for_v)
        store(xs + 2 * _BYTES * k, convert(_float64, u ^ _word(_TOP)) * step + middle_x)
        store(ys + 2 * _BYTES * k, convert(_float64, v ^ _word(_TOP)) * step + middle_y)


@kernel
def fill_samples(sampler: int, n_samples: int, n: int, keys: int, indices: int, us: int, vs: int) -> None:
    """Write sample points.

    Parameters
    ----------
    sampler, n_samples
        As :func:`tracer.sampling.sampler.sample_2d`.
    n
        How many; memory is read and written up to the next multiple of eight.
    keys, indices
        Addresses of int32: each point's key (:func:`tracer.sampling.hashing.pixel_key`) and sample index.
    us, vs
        Addresses of float64: where the coordinates go.
    """
    if sampler != SAMPLER_SOBOL:
        for k in range(n):
            key = np.uint64(_int64(load(_int32, keys + 4 * k)) & 0xFFFFFFFF)
            u, v = sample_keyed(sampler, key, _int64(load(_int32, indices + 4 * k)), n_samples)
            store(us + 8 * k, u)
            store(vs + 8 * k, v)
        return
    bits = _bits_of(n_samples)
    last = load(int32x8, keys)
    shuffle, for_u, for_v = _hash(last ^ _word(_SHUFFLE)), _hash(last ^ _word(_U)), _hash(last ^ _word(_V))
    for k in range((n + LANES - 1) // LANES):
        key = load(int32x8, keys + _BYTES * k)
        if any_lane(key != last):  # mostly eight samples of one pixel, then eight more
            last = key
            shuffle, for_u, for_v = _hash(key ^ _word(_SHUFFLE)), _hash(key ^ _word(_U)), _hash(key ^ _word(_V))
        index = load(int32x8, indices + _BYTES * k)
        index = _shuffle(index, shuffle, bits)
        _store_unit(us + 2 * _BYTES * k, _scramble(index, for_u))
        _store_unit(vs + 2 * _BYTES * k, _scramble(_second(index, bits), for_v))
