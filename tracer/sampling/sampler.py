"""The samplers behind one pure function.

A sample's position depends on (seed, pixel, sample, dimension) and on the number of samples, on nothing else: not
on the picture's size, the order of rendering, or the machine. ``dimension`` counts independent pairs of
coordinates: 0 is the position in the pixel.
"""

from typing import Final

import numpy as np

from tracer.jit import inline, kernel
from tracer.sampling.hashing import combine, hash_word, pixel_key, to_unit
from tracer.sampling.sobol import scramble_reversed, shuffle_index, sobol_reversed_second
from tracer.sampling.stratified import sample_stratified
from tracer.types import SAMPLER_INDEPENDENT, SAMPLER_STRATIFIED

_WORD_SHUFFLE: Final = np.uint64(0x1B56C4E9)  # tell the uses of one key apart
_WORD_U: Final = np.uint64(0x7F4A7C15)
_WORD_V: Final = np.uint64(0x94D049BB)
_ONE: Final = np.uint64(1)


@inline
def sample_keyed(sampler: int, key: np.uint64, sample: int, n_samples: int) -> tuple[float, float]:
    """Point of a sampler for a key of :func:`tracer.sampling.hashing.pixel_key`."""
    if sampler == SAMPLER_INDEPENDENT:
        word = combine(key, np.uint64(sample))
        return to_unit(word), to_unit(hash_word(word ^ _WORD_V))
    if sampler == SAMPLER_STRATIFIED:
        return sample_stratified(key, sample, n_samples)
    bits = np.uint64(0)
    while (_ONE << bits) < np.uint64(n_samples):
        bits += _ONE
    index = shuffle_index(np.uint64(sample), bits, hash_word(key ^ _WORD_SHUFFLE))
    u = to_unit(scramble_reversed(index, hash_word(key ^ _WORD_U)))
    v = to_unit(scramble_reversed(sobol_reversed_second(index), hash_word(key ^ _WORD_V)))
    return u, v


@kernel
def sample_2d(
    sampler: int, seed: int, px: int, py: int, sample: int, n_samples: int, dimension: int
) -> tuple[float, float]:
    """Two coordinates in [0, 1).

    Parameters
    ----------
    sampler : SAMPLER_*
    seed : 0 .. 2^32 - 1
    px, py : absolute pixel, from the top left
    sample, n_samples : index and number of the pixel's samples
    dimension : which pair of coordinates
    """
    return sample_keyed(sampler, pixel_key(seed, px, py, dimension), sample, n_samples)
