"""Light of shadow rays behind a surface.

What triangles leave of a light is a product of up to many kt, in an order that depends on the way through the tree,
and so on the company that a ray has. It is kept as the unevaluated sum of two float64, LIGHT and LIGHT_REST, off by
some 2**-104 a factor: rounded to LIGHT it is the same in every order, but for about one product in 2**50, that near the
middle between two numbers.

Sources: Dekker 1971 (products of two float64 without error); Joldes, Muller and Popescu 2017, algorithm 9.
"""

from typing import Any, Final

from tracer.jit import inline, kernel
from tracer.rays.rows import LANES, LIGHT, LIGHT_REST, MASK, NIBBLE, ROW, STEP, VECTOR, VECTORS, mask_of, put
from tracer.simd import load, mask_from_bits, mask_to_bits, minimum, select, splat, stand_alone, store
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64

_ROWS: Final = 6  # LIGHT and LIGHT_REST
LIGHT_BYTES: Final = _ROWS * ROW
_HALVES: Final = 2.0**27 + 1.0  # cuts a float64 in two (Veltkamp)
_MOST: Final = 2.0**960  # light is no more than this: its halves stay finite


@inline
def lets_nothing_through(material: int) -> bool:
    """Tell whether kt, at an address, is black."""
    red, green, blue = load(_float64, material), load(_float64, material + 8), load(_float64, material + 16)
    return bool(red <= 0.0 and green <= 0.0 and blue <= 0.0)


@kernel
def keep_light(packet: int, kept: int) -> None:
    """Copy the light of all rays to an address."""
    stand_alone()
    for at in range(0, LIGHT_BYTES, STEP):
        store(kept + at, load(VECTOR, packet + LIGHT + at))


@kernel
def restore_light(packet: int, kept: int, lanes: int) -> None:
    """Give some rays the light back that `keep_light` has copied."""
    stand_alone()
    for i in range(VECTORS):
        mask = mask_of(lanes, i)
        for row in range(_ROWS):
            at = ROW * row + STEP * i
            put(packet + LIGHT + at, mask, load(VECTOR, kept + at))


@inline
def _halves(x: Any) -> Any:
    """Cut into two parts of 26 bits: high and low."""
    scaled = x * splat(VECTOR, _HALVES)
    high = scaled - (scaled - x)
    return high, x - high


@inline
def _multiply(at: int, mask: Any, factor: float) -> Any:
    """Multiply one channel of four rays, where the mask says; returns the products, rounded."""
    k, most = splat(VECTOR, factor), splat(VECTOR, _MOST)
    light = load(VECTOR, at)
    product = minimum(light * k, most)
    a, b = _halves(light)
    c, d = _halves(k)
    error = ((a * c - product) + a * d + b * c) + b * d
    error = error + load(VECTOR, at + (LIGHT_REST - LIGHT)) * k
    error = select(product < most, error, splat(VECTOR, 0.0))
    rounded = product + error
    put(at, mask, rounded)
    put(at + (LIGHT_REST - LIGHT), mask, error - (rounded - product))
    return rounded


@kernel
def dim_four(four: int, bits: int, material: int) -> Any:
    """Multiply the light of rays of a vector, at an address, by a material's kt; returns those left in the dark."""
    stand_alone()
    mask = mask_from_bits(MASK, bits)
    zero = splat(VECTOR, 0.0)
    red = _multiply(four + LIGHT, mask, load(_float64, material))
    green = _multiply(four + LIGHT + ROW, mask, load(_float64, material + 8))
    blue = _multiply(four + LIGHT + 2 * ROW, mask, load(_float64, material + 16))
    return mask_to_bits((red <= zero) & (green <= zero) & (blue <= zero)) & bits


@inline
def dim(packet: int, lanes: int, material: int) -> Any:
    """As `dim_four`, for any rays of a packet."""
    dark = _int64(0)
    for i in range(VECTORS):
        bits = (lanes >> (LANES * i)) & NIBBLE
        if bits != 0:
            dark |= dim_four(packet + STEP * i, bits, material) << (LANES * i)
    return dark
