"""Texture look-up in the atlas of linear texels.

u grows to the right and v upwards; row 0 of an image is its top row; texel centres lie at half numbers.
"""

from typing import Any

import numpy as np

from tracer.geometry.vector import at
from tracer.jit import inline, int64, kernel
from tracer.types import FILTER_BILINEAR, N_TEXTURE, TEXTURE_HEIGHT, TEXTURE_OFFSET, TEXTURE_WIDTH, WRAP_REPEAT, Vec3


@inline
def wrap_index(i: int, n: int, wrap: int) -> int:
    """Bring an index of -1 .. n back into 0 .. n - 1."""
    if i < 0:
        return n - 1 if wrap == WRAP_REPEAT else 0
    if i >= n:
        return 0 if wrap == WRAP_REPEAT else n - 1
    return i


@inline
def wrap_coordinate(x: float, wrap: int) -> float:
    """Bring a coordinate into [0, 1]: its fraction, or the nearest end."""
    if wrap == WRAP_REPEAT:
        return x - float(np.floor(x))
    return min(max(x, 0.0), 1.0)


@kernel
def sample_texture(textures: Any, texels: Any, texture: int, wrap: int, filtering: int, u: float, v: float) -> Vec3:
    """Linear RGB of a texture.

    Parameters
    ----------
    textures, texels
        Flat arrays as in :class:`tracer.types.CompiledScene`.
    texture
        Row of ``textures``.
    wrap, filtering
        WRAP_*, FILTER_*.
    u, v
        Texture coordinates, finite.
    """
    offset = int64(textures[N_TEXTURE * texture + TEXTURE_OFFSET])
    width = int64(textures[N_TEXTURE * texture + TEXTURE_WIDTH])
    height = int64(textures[N_TEXTURE * texture + TEXTURE_HEIGHT])
    x = wrap_coordinate(u, wrap) * width
    y = wrap_coordinate(1.0 - v, wrap) * height
    if filtering != FILTER_BILINEAR:
        column = wrap_index(int64(x), width, wrap)
        row = wrap_index(int64(y), height, wrap)
        return at(texels, 3 * (offset + row * width + column))
    x -= 0.5
    y -= 0.5
    left = int64(np.floor(x))
    top = int64(np.floor(y))
    fx = x - left
    fy = y - top
    column0 = wrap_index(left, width, wrap)
    column1 = wrap_index(left + 1, width, wrap)
    row0 = offset + wrap_index(top, height, wrap) * width
    row1 = offset + wrap_index(top + 1, height, wrap) * width
    c00 = at(texels, 3 * (row0 + column0))
    c10 = at(texels, 3 * (row0 + column1))
    c01 = at(texels, 3 * (row1 + column0))
    c11 = at(texels, 3 * (row1 + column1))
    w00 = (1.0 - fx) * (1.0 - fy)
    w10 = fx * (1.0 - fy)
    w01 = (1.0 - fx) * fy
    w11 = fx * fy
    return Vec3(
        w00 * c00.x + w10 * c10.x + w01 * c01.x + w11 * c11.x,
        w00 * c00.y + w10 * c10.y + w01 * c01.y + w11 * c11.y,
        w00 * c00.z + w10 * c10.z + w01 * c01.z + w11 * c11.z,
    )
