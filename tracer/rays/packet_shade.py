"""Light of shadow rays behind a surface."""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import LANES, LIGHT, NIBBLE, ROW, STEP, VECTOR, VECTORS, mask_of, put
from tracer.simd import load, mask_to_bits, splat
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64


@inline
def lets_nothing_through(material: int) -> bool:
    """Tell whether kt, at an address, is black."""
    red, green, blue = load(_float64, material), load(_float64, material + 8), load(_float64, material + 16)
    return bool(red <= 0.0 and green <= 0.0 and blue <= 0.0)


@inline
def dim(packet: int, lanes: int, material: int) -> Any:
    """Multiply the light of some rays by a material's kt; returns those left in the dark."""
    red, green, blue = load(_float64, material), load(_float64, material + 8), load(_float64, material + 16)
    dark = _int64(0)
    zero = splat(VECTOR, 0.0)
    for i in range(VECTORS):
        bits = (lanes >> (LANES * i)) & NIBBLE
        if bits == 0:
            continue
        mask = mask_of(lanes, i)
        at = packet + LIGHT + STEP * i
        r = load(VECTOR, at) * splat(VECTOR, red)
        g = load(VECTOR, at + ROW) * splat(VECTOR, green)
        b = load(VECTOR, at + 2 * ROW) * splat(VECTOR, blue)
        put(at, mask, r)
        put(at + ROW, mask, g)
        put(at + 2 * ROW, mask, b)
        dark |= (bits & mask_to_bits((r <= zero) & (g <= zero) & (b <= zero))) << (LANES * i)
    return dark
