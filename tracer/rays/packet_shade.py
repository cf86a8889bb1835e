"""Light of shadow rays behind a surface."""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import LANES, LIGHT, NIBBLE, ROW, STEP, VECTOR, VECTORS, mask_of, put
from tracer.simd import load, mask_to_bits, splat, store
from tracer.simd.gateway import types

_float64: Final = types.float64
_int64: Final = types.int64

LIGHT_BYTES: Final = 3 * ROW


@inline
def lets_nothing_through(material: int) -> bool:
    """Tell whether kt, at an address, is black."""
    red, green, blue = load(_float64, material), load(_float64, material + 8), load(_float64, material + 16)
    return bool(red <= 0.0 and green <= 0.0 and blue <= 0.0)


@inline
def keep_light(packet: int, kept: int) -> None:
    """Copy the light of all rays to an address."""
    for at in range(0, 3 * ROW, STEP):
        store(kept + at, load(VECTOR, packet + LIGHT + at))


@inline
def restore_light(packet: int, kept: int, lanes: int) -> None:
    """Give some rays the light back that `keep_light` has copied."""
    for i in range(VECTORS):
        mask = mask_of(lanes, i)
        for channel in range(3):
            at = ROW * channel + STEP * i
            put(packet + LIGHT + at, mask, load(VECTOR, kept + at))


@inline
def dim_lane(ray: int, material: int) -> bool:
    """Multiply one ray's light by a material's kt; tells whether it is left in the dark."""
    at = ray + LIGHT
    red = load(_float64, at) * load(_float64, material)
    green = load(_float64, at + ROW) * load(_float64, material + 8)
    blue = load(_float64, at + 2 * ROW) * load(_float64, material + 16)
    store(at, red)
    store(at + ROW, green)
    store(at + 2 * ROW, blue)
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
