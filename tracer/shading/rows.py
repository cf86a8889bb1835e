"""What is known of 64 rays' hits: more rows behind those of the packet (:mod:`tracer.rays.rows`).

Invariant: values are float64, but for SAMPLE, DEPTH, FROM, MATERIAL and START (int64).
"""

from typing import Any, Final

from tracer.jit import inline
from tracer.rays.rows import RAY_ROWS, ROW, VECTOR, put
from tracer.simd import load, select, splat, store
from tracer.simd.gateway import types
from tracer.types import Vec3

_float64: Final = types.float64

# --- the ray --------------------------------------------------------------------------------------------------------
DIRECTION: Final = RAY_ROWS * ROW  # x, y, z, unit
THROUGHPUT: Final = (RAY_ROWS + 3) * ROW  # R, G, B
SAMPLE: Final = (RAY_ROWS + 6) * ROW  # int64: what the ray's colour is added to
DEPTH: Final = (RAY_ROWS + 7) * ROW  # int64: bounces before it
FROM: Final = (RAY_ROWS + 8) * ROW  # int64: material that attenuates it over its way, -1 for a camera ray
# --- the hit --------------------------------------------------------------------------------------------------------
POSITION: Final = (RAY_ROWS + 9) * ROW
ERROR: Final = (RAY_ROWS + 12) * ROW  # bound on each coordinate's error
GEOMETRIC: Final = (RAY_ROWS + 15) * ROW  # unit, on the shading normal's side
NORMAL: Final = (RAY_ROWS + 18) * ROW  # shading normal, unit, turned to the viewer where the material is two-sided
DIFFUSE: Final = (RAY_ROWS + 21) * ROW  # kd, tinted
SPECULAR: Final = (RAY_ROWS + 24) * ROW  # ks
EXPONENT: Final = (RAY_ROWS + 27) * ROW
ATTENUATION: Final = (RAY_ROWS + 28) * ROW  # a, b, c
MATERIAL: Final = (RAY_ROWS + 31) * ROW  # int64
START: Final = (RAY_ROWS + 32) * ROW  # int64: what a ray from here cannot meet again, -1 for nothing
COLOR: Final = (RAY_ROWS + 33) * ROW  # R, G, B that leaves the hit towards the viewer, bounces apart
# --- the hit and a light --------------------------------------------------------------------------------------------
TO_LIGHT: Final = (RAY_ROWS + 36) * ROW  # unit
COSINE: Final = (RAY_ROWS + 39) * ROW  # n . l
STRENGTH: Final = (RAY_ROWS + 40) * ROW  # attenuation times the falloff of a spot
HIT_ROWS: Final = RAY_ROWS + 41


@inline
def vector_at(address: int) -> Any:
    """Load four rays' values of three neighbouring rows."""
    return Vec3(load(VECTOR, address), load(VECTOR, address + ROW), load(VECTOR, address + 2 * ROW))


@inline
def put_vector(address: int, mask: Any, value: Any) -> None:
    """Write the chosen lanes of three neighbouring rows."""
    put(address, mask, value.x)
    put(address + ROW, mask, value.y)
    put(address + 2 * ROW, mask, value.z)


@inline
def put_lane(address: int, value: Any) -> None:
    """Write one ray's values of three neighbouring rows."""
    store(address, _float64(value.x))
    store(address + ROW, _float64(value.y))
    store(address + 2 * ROW, _float64(value.z))


@inline
def lane_at(address: int) -> Any:
    """Load one ray's values of three neighbouring rows."""
    return Vec3(load(_float64, address), load(_float64, address + ROW), load(_float64, address + 2 * ROW))


@inline
def spread(value: Any) -> Any:
    """Put the same three numbers into every lane."""
    return Vec3(splat(VECTOR, value.x), splat(VECTOR, value.y), splat(VECTOR, value.z))


@inline
def choose(mask: Any, a: Any, b: Any) -> Any:
    """Take ``a`` where the mask is set, else ``b``."""
    return Vec3(select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z))
