"""Memory of a packet: up to 64 rays side by side, one row of 64 values for each thing that is known of a ray.

A packet is an address; a thing's row is a constant offset from it, and lane ``i`` of a row lies 8 ``i`` bytes on. A set
of rays of a packet is an int64, bit ``i`` for lane ``i``.

Invariant: a row's values are float64, but for PRIMITIVE, SKIP and AXIS (int64). Lanes outside the set that a function
is handed may hold anything that was once a number there.
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.simd import (
    absolute,
    all_lanes,
    bitcast,
    float64x4,
    int64x4,
    load,
    mask4,
    mask_from_bits,
    opaque,
    select,
    splat,
    store,
    to_bits,
)
from tracer.simd.gateway import types

_int64: Final = types.int64

PACKET: Final = 64  # rays
LANES: Final = 4  # rays that one vector holds
VECTORS: Final = PACKET // LANES
ROW: Final = 8 * PACKET  # bytes
STEP: Final = 8 * LANES  # bytes of a vector

ORIGIN: Final = 0  # x, y, z, world
SHEAR: Final = 3 * ROW  # Sx, Sy, Sz, in the order kx, ky, kz
SPEED: Final = 6 * ROW  # |d.kz|
T_BEST: Final = 7 * ROW  # end of the ray, then the nearest hit
PRIMITIVE: Final = 8 * ROW  # int64: nearest hit, -1 for none
SKIP: Final = 9 * ROW  # int64: a triangle that the ray cannot meet, -1 for none
WEIGHT_1: Final = 10 * ROW  # of the second and third vertex of the face as given
WEIGHT_2: Final = 11 * ROW
AXIS: Final = 12 * ROW  # int64: 2 kz + (1 where d.kz < 0)
LIGHT: Final = 13 * ROW  # R, G, B: share of a light that is left
LIGHT_REST: Final = 16 * ROW  # what LIGHT has lost to rounding (:mod:`tracer.rays.packet_shade`)
RAY_ROWS: Final = 19

VECTOR: Final = float64x4
INTEGERS: Final = int64x4
MASK: Final = mask4
NIBBLE: Final = 15
ALL: Final = -1


@inline
def mask_of(lanes: int, vector: int) -> Any:
    """Mask of a vector's lanes in a set."""
    return mask_from_bits(MASK, (lanes >> (LANES * vector)) & NIBBLE)


@inline
def put(address: int, mask: Any, value: Any) -> None:
    """Write the chosen lanes of a vector of float64."""
    if all_lanes(mask):  # mostly
        store(address, value)
    else:
        store(address, select(mask, value, opaque(load(VECTOR, address))))


@inline
def put_integers(address: int, mask: Any, value: Any) -> None:
    """Write the chosen lanes of a vector of int64."""
    if all_lanes(mask):
        store(address, value)
    else:
        store(address, select(mask, bitcast(VECTOR, value), opaque(load(VECTOR, address))))


@inline
def shear_lanes(packet: int, vector: int, dx: Any, dy: Any, dz: Any) -> None:
    """Fill SHEAR, SPEED and AXIS of four rays from their directions, as :func:`predicate.shear_of` does for one."""
    one = splat(VECTOR, 1.0)
    x, y, z = absolute(dx), absolute(dy), absolute(dz)
    along_z = (z >= x) & (z >= y)
    along_y = ~along_z & (y >= x)
    # kx, ky, kz are z, x, y along y and y, z, x along x
    kx = select(along_z, dx, select(along_y, dz, dy))
    ky = select(along_z, dy, select(along_y, dx, dz))
    kz = select(along_z, dz, select(along_y, dy, dx))
    at = packet + STEP * vector
    inverse = one / kz
    store(at + SHEAR, kx * inverse)
    store(at + SHEAR + ROW, ky * inverse)
    store(at + SHEAR + 2 * ROW, inverse)
    store(at + SPEED, absolute(kz))
    zero, unit = splat(INTEGERS, _int64(0)), splat(INTEGERS, _int64(1))
    axis = select(along_z, splat(INTEGERS, _int64(4)), select(along_y, splat(INTEGERS, _int64(2)), zero))
    store(at + AXIS, axis + select(kz < splat(VECTOR, 0.0), unit, zero))


@inline
def axes_of(axis: int) -> Any:
    """Return (kx, ky, kz) of an AXIS."""
    kz = axis >> 1
    return kz - 2 if kz == 2 else kz + 1, kz - 1 if kz > 0 else _int64(2), kz


@inline
def blend(mask: Any, new: Any, old: Any) -> Any:
    """Take ``new`` where the mask, int64 lanes of -1 or 0, is set, else ``old``.

    Not by `select`: a store of it becomes a masked store, which costs ten plain ones on some CPUs.
    """
    return bitcast(VECTOR, (to_bits(new) & mask) | (to_bits(old) & ~mask))


@inline
def direction_lanes(ray: int) -> Any:
    """Make x, y, z of four rays' directions again from their shears: up to a rounding each."""
    axis, speed = load(INTEGERS, ray + AXIS), load(VECTOR, ray + SPEED)
    negative = (axis & splat(INTEGERS, _int64(1))) != splat(INTEGERS, _int64(0))
    kz = select(negative, -speed, speed)
    kx, ky = load(VECTOR, ray + SHEAR) * kz, load(VECTOR, ray + SHEAR + ROW) * kz
    along_z, along_x = axis >= splat(INTEGERS, _int64(4)), axis < splat(INTEGERS, _int64(2))
    # kx, ky, kz are x, y, z along z, z, x, y along y and y, z, x along x
    return (
        select(along_z, kx, select(along_x, kz, ky)),
        select(along_z, ky, select(along_x, kx, kz)),
        select(along_z, kz, select(along_x, ky, kx)),
    )


@inline
def spread_shear(packet: int, vector: int, shear: Any, speed: float) -> None:
    """Fill SHEAR, SPEED and AXIS of four rays of one direction.

    Parameters
    ----------
    packet, vector
        Where.
    shear
        :func:`predicate.shear_of` the direction.
    speed
        Its component along kz.
    """
    _kx, _ky, kz, sx, sy, sz = shear
    at = packet + STEP * vector
    store(at + SHEAR, splat(VECTOR, sx))
    store(at + SHEAR + ROW, splat(VECTOR, sy))
    store(at + SHEAR + 2 * ROW, splat(VECTOR, sz))
    store(at + SPEED, splat(VECTOR, abs(speed)))
    store(at + AXIS, splat(INTEGERS, _int64(2 * kz + (1 if speed < 0.0 else 0))))
