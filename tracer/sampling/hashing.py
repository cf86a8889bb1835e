"""Counter-based random numbers: a hash of where the number is used, no state.

32-bit words are kept in 64-bit integers and masked: a product of two words fits, so the same code runs compiled and
as plain Python, and nothing overflows.

Sources: Wellons, "Prospecting for Hash Functions" (triple32, bias 0.02); Salmon et al. 2011 (counter-based random
numbers).
"""

from typing import Final

import numpy as np

from tracer.jit import inline

MASK: Final = np.uint64(0xFFFFFFFF)
_M1: Final = np.uint64(0xED5AD4BB)
_M2: Final = np.uint64(0xAC4C1B51)
_M3: Final = np.uint64(0x31848BAB)
_S11: Final = np.uint64(11)
_S14: Final = np.uint64(14)
_S15: Final = np.uint64(15)
_S17: Final = np.uint64(17)
_GOLDEN: Final = np.uint64(0x9E3779B9)  # 2^32 / golden ratio: keeps hash_word(0) from being a fixed point at 0


@inline
def hash_word(x: np.uint64) -> np.uint64:
    """Mix a 32-bit word (Wellons' triple32)."""
    x = x & MASK
    x ^= x >> _S17
    x = (x * _M1) & MASK
    x ^= x >> _S11
    x = (x * _M2) & MASK
    x ^= x >> _S15
    x = (x * _M3) & MASK
    return x ^ (x >> _S14)


@inline
def combine(key: np.uint64, word: np.uint64) -> np.uint64:
    """Fold another word into a key."""
    return hash_word((key ^ (word & MASK)) + _GOLDEN)


@inline
def to_unit(word: np.uint64) -> float:
    """32-bit word as a number in [0, 1), a multiple of 2^-32."""
    return float(word) * 2.0**-32


@inline
def pixel_key(seed: int, px: int, py: int, dimension: int) -> np.uint64:
    """Key of a pixel and a dimension: what all samples of the pixel share.

    Keyed by both coordinates, not by an index: the picture's width does not matter.
    """
    key = combine(np.uint64(seed), np.uint64(px))
    key = combine(key, np.uint64(py))
    return combine(key, np.uint64(dimension))
