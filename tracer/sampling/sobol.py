"""Owen-scrambled, shuffled Sobol points in two dimensions.

Each pixel and dimension pair has its own random scrambling, by hash: every aligned run of 2^k samples of a pixel
has one point in each elementary interval of area 2^-k (a (0, k, 2)-net), and the points are uniform over the
scramblings.

Sources: Burley 2020, "Practical Hash-based Owen Scrambling"; Laine and Karras 2011 (the permutation); Vegdahl's
constants.
"""

from typing import Final

import numpy as np

from tracer.jit import inline
from tracer.sampling.hashing import MASK

_M1: Final = np.uint64(0x55555555)
_M2: Final = np.uint64(0x33333333)
_M4: Final = np.uint64(0x0F0F0F0F)
_M8: Final = np.uint64(0x00FF00FF)
_M16: Final = np.uint64(0x0000FFFF)
_S1: Final = np.uint64(1)
_S2: Final = np.uint64(2)
_S4: Final = np.uint64(4)
_S8: Final = np.uint64(8)
_S16: Final = np.uint64(16)
_K1: Final = np.uint64(0x6C50B47C)
_K2: Final = np.uint64(0xB82F1E52)
_K3: Final = np.uint64(0xC7AFE638)
_K4: Final = np.uint64(0x8D22F6E6)


@inline
def reverse_bits(x: np.uint64) -> np.uint64:
    """Reverse a 32-bit word."""
    x = ((x >> _S1) & _M1) | ((x & _M1) << _S1)
    x = ((x >> _S2) & _M2) | ((x & _M2) << _S2)
    x = ((x >> _S4) & _M4) | ((x & _M4) << _S4)
    x = ((x >> _S8) & _M8) | ((x & _M8) << _S8)
    return (x >> _S16) | ((x & _M16) << _S16)


@inline
def permute_upwards(x: np.uint64, key: np.uint64) -> np.uint64:
    """Permutation in which every bit depends on the key and on the bits below it alone (Laine and Karras)."""
    x = (x + key) & MASK
    x ^= (x * _K1) & MASK
    x ^= (x * _K2) & MASK
    x ^= (x * _K3) & MASK
    return x ^ ((x * _K4) & MASK)


@inline
def scramble_reversed(x: np.uint64, key: np.uint64) -> np.uint64:
    """Owen-scramble the word whose bit reversal is ``x``: a random binary tree of swaps, from the top bit down."""
    return reverse_bits(permute_upwards(x, key))


@inline
def sobol_reversed_second(index: np.uint64) -> np.uint64:
    """Bit reversal of the second Sobol coordinate of an index.

    Its generator matrix is Pascal's triangle modulo 2, a tensor power of [[1, 1], [0, 1]]: five butterfly steps.
    (The bit reversal of the first coordinate is the index itself.)
    """
    index ^= (index >> _S1) & _M1
    index ^= (index >> _S2) & _M2
    index ^= (index >> _S4) & _M4
    index ^= (index >> _S8) & _M8
    return index ^ ((index >> _S16) & _M16)


@inline
def shuffle_index(index: np.uint64, bits: np.uint64, key: np.uint64) -> np.uint64:
    """Owen-shuffle an index below 2^bits: aligned runs stay aligned runs, so prefixes stay nets."""
    shift = np.uint64(32) - bits
    return scramble_reversed(reverse_bits(index << shift), key) >> shift
