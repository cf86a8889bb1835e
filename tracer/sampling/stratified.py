"""Stratified points: a jittered grid, in an order that is itself a random permutation.

A square number of samples fills a grid of equal cells; any other number takes a grid of m x n cells with m n just large
enough, in Kensler's correlated multi-jittered arrangement, which is stratified in each coordinate alone, too.

Source: Kensler 2013, "Correlated Multi-Jittered Sampling" (the permutation of any length, the arrangement).
"""

from typing import Final

import numpy as np

from tracer.jit import inline
from tracer.sampling.hashing import MASK, combine, hash_word, to_unit

_P1: Final = np.uint64(0xE170893D)
_P2: Final = np.uint64(0x0929EB3F)
_P3: Final = np.uint64(0x6935FA69)
_P4: Final = np.uint64(0x74DCB303)
_P5: Final = np.uint64(0x9E501CC3)
_P6: Final = np.uint64(0xC860A3DF)
_ONE: Final = np.uint64(1)
_S1: Final = np.uint64(1)
_S2: Final = np.uint64(2)
_S4: Final = np.uint64(4)
_S5: Final = np.uint64(5)
_S8: Final = np.uint64(8)
_S11: Final = np.uint64(11)
_S16: Final = np.uint64(16)
_S23: Final = np.uint64(23)
_S27: Final = np.uint64(27)
_COLUMN: Final = np.uint64(0x51633E2D)
_ROW: Final = np.uint64(0x68BC21EB)
_JITTER_U: Final = np.uint64(0x967A889B)
_JITTER_V: Final = np.uint64(0x368CC8B7)


@inline
def permute(index: np.uint64, length: np.uint64, key: np.uint64) -> np.uint64:
    """Image of ``index`` under a random permutation of 0 .. length - 1 (Kensler), by walking cycles."""
    w = length - _ONE
    w |= w >> _S1
    w |= w >> _S2
    w |= w >> _S4
    w |= w >> _S8
    w |= w >> _S16
    i = index
    while True:
        i ^= key
        i = (i * _P1) & MASK
        i ^= key >> _S16
        i ^= (i & w) >> _S4
        i ^= key >> _S8
        i = (i * _P2) & MASK
        i ^= key >> _S23
        i ^= (i & w) >> _S1
        i = (i * (_ONE | (key >> _S27))) & MASK
        i = (i * _P3) & MASK
        i ^= (i & w) >> _S11
        i = (i * _P4) & MASK
        i ^= (i & w) >> _S2
        i = (i * _P5) & MASK
        i ^= (i & w) >> _S2
        i = (i * _P6) & MASK
        i &= w
        i ^= i >> _S5
        if i < length:
            return (i + key) % length


@inline
def sample_stratified(key: np.uint64, sample: int, n_samples: int) -> tuple[float, float]:
    """Point ``sample`` of ``n_samples`` for a pixel and dimension."""
    columns = int(np.sqrt(float(n_samples)))
    if columns * columns > n_samples:
        columns -= 1
    rows = (n_samples + columns - 1) // columns
    s = permute(np.uint64(sample), np.uint64(n_samples), key)
    jitter_u = to_unit(hash_word(combine(key ^ _JITTER_U, s)))
    jitter_v = to_unit(hash_word(combine(key ^ _JITTER_V, s)))
    n_columns = np.uint64(columns)
    n_rows = np.uint64(rows)
    column = s % n_columns
    row = s // n_columns
    if columns * columns == n_samples:
        return (float(column) + jitter_u) / columns, (float(row) + jitter_v) / rows
    # Kensler's arrangement: each sample has a row of its own (1 / n_samples high). Columns and sub-columns are
    # shuffled, so that the cells that no sample takes lie anywhere: the same ones in every pixel would be a bias.
    shuffled_column = permute(column, n_columns, key ^ _COLUMN)
    sub_column = permute(row, n_rows, key ^ _ROW)
    u = (float(shuffled_column) + (float(sub_column) + jitter_u) / rows) / columns
    v = (float(s) + jitter_v) / n_samples
    return u, v
