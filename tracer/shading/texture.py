"""Texture look-up in the atlas of linear texels, for one point and for four.

u grows to the right and v upwards; row 0 of an image is its top row; texel centres lie at half numbers.
"""

from typing import Any, Final

import numpy as np

from tracer.geometry.vector import at
from tracer.jit import inline, int64, kernel
from tracer.rays.rows import STEP, VECTOR
from tracer.simd import (
    address_of,
    convert,
    count_trailing_zeros,
    float32x4,
    float64x4,
    floor,
    load,
    maximum,
    minimum,
    select,
    splat,
    store,
    transpose,
)
from tracer.simd.gateway import types
from tracer.types import (
    FILTER_BILINEAR,
    N_TEXTURE,
    TEXTURE_HEIGHT,
    TEXTURE_OFFSET,
    TEXTURE_WIDTH,
    WRAP_REPEAT,
    SceneView,
    Vec3,
)

_float64: Final = types.float64
_int32: Final = types.int32
_int64: Final = types.int64
_TEXEL_BYTES: Final = 12
SAMPLE_BYTES: Final = 10 * STEP  # of scratch that `sample_lanes` needs


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


@inline
def _wrap_lanes(x: Any, wrap: int) -> Any:
    """As `wrap_coordinate`."""
    if wrap == WRAP_REPEAT:
        return x - floor(x)
    return minimum(maximum(x, splat(VECTOR, 0.0)), splat(VECTOR, 1.0))


@inline
def _index_lanes(i: Any, n: Any, wrap: int) -> Any:
    """As `wrap_index`, on whole numbers kept as float64."""
    zero, last = splat(VECTOR, 0.0), n - splat(VECTOR, 1.0)
    below, above = (last, zero) if wrap == WRAP_REPEAT else (zero, last)
    return select(i < zero, below, select(i > last, above, i))


@inline
def _texel(texels: int, number: int) -> Any:
    """Load one texel, and a number more, as float64."""
    return convert(_float64, load(float32x4, texels + _TEXEL_BYTES * number))


@inline
def sample_lanes(
    view: SceneView, texture: int, wrap: int, filtering: int, u: Any, v: Any, bits: int, scratch: int
) -> Any:
    """Linear RGB of a texture at four points, bit for bit as `sample_texture`.

    Parameters
    ----------
    view, texture, wrap, filtering
        As there. One texel more than there are can be read.
    u, v
        Vectors of float64.
    bits
        Lanes that count; the others' colours may be anything.
    scratch
        Address of `SAMPLE_BYTES`.
    """
    texels = address_of(view.texels)
    offset = splat(VECTOR, _float64(view.textures[N_TEXTURE * texture + TEXTURE_OFFSET]))
    width = splat(VECTOR, _float64(view.textures[N_TEXTURE * texture + TEXTURE_WIDTH]))
    height = splat(VECTOR, _float64(view.textures[N_TEXTURE * texture + TEXTURE_HEIGHT]))
    one, half = splat(VECTOR, 1.0), splat(VECTOR, 0.5)
    x, y = _wrap_lanes(u, wrap) * width, _wrap_lanes(one - v, wrap) * height
    numbers, weights, colors = scratch, scratch + 2 * STEP, scratch + 6 * STEP
    if filtering != FILTER_BILINEAR:
        place = offset + _index_lanes(floor(y), height, wrap) * width + _index_lanes(floor(x), width, wrap)
        store(numbers, convert(_int32, place))
        while bits != 0:
            lane = count_trailing_zeros(bits)
            bits &= bits - 1
            store(colors + STEP * lane, _texel(texels, _int64(load(_int32, numbers + 4 * lane))))
    else:
        x, y = x - half, y - half
        left, top = floor(x), floor(y)
        fx, fy = x - left, y - top
        column0, column1 = _index_lanes(left, width, wrap), _index_lanes(left + one, width, wrap)
        row0 = offset + _index_lanes(top, height, wrap) * width
        row1 = offset + _index_lanes(top + one, height, wrap) * width
        store(numbers, convert(_int32, row0 + column0))
        store(numbers + 16, convert(_int32, row0 + column1))
        store(numbers + 32, convert(_int32, row1 + column0))
        store(numbers + 48, convert(_int32, row1 + column1))
        store(weights, (one - fx) * (one - fy))
        store(weights + STEP, fx * (one - fy))
        store(weights + 2 * STEP, (one - fx) * fy)
        store(weights + 3 * STEP, fx * fy)
        while bits != 0:
            lane = count_trailing_zeros(bits)
            bits &= bits - 1
            word, weight = numbers + 4 * lane, weights + 8 * lane
            color = splat(VECTOR, load(_float64, weight)) * _texel(texels, _int64(load(_int32, word)))
            for corner in range(1, 4):
                share = splat(VECTOR, load(_float64, weight + STEP * corner))
                color = color + share * _texel(texels, _int64(load(_int32, word + 16 * corner)))
            store(colors + STEP * lane, color)
    r0, r1 = load(float64x4, colors), load(float64x4, colors + STEP)
    red, green, blue, _rest = transpose(r0, r1, load(float64x4, colors + 2 * STEP), load(float64x4, colors + 3 * STEP))
    return Vec3(red, green, blue)
