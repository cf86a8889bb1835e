"""Rays through a scene's placements: the top level above the wide trees.

A packet goes down the placements' tree as a set of rays: at a node each ray meets the children's boxes by itself, four
rays at a time, and the nearer child comes first. A placement as it is traces the packet itself. For one that is moved
the rays are copied into the object's space: origin and direction by the inverse map, the direction not made unit, so
that t stays; there they may have other axes, and are parted anew. What is nearer is copied back.

Invariants: a ray's answer is the least (t, id) of all placements, whatever the order and company: T_BEST goes along; a
box is passed by only if no ray of the set can meet anything in it (the pad covers the roundings of the slab test and
of the way into the object's space, :mod:`tracer.accel.placing`). In a tree, ids count from 0: PRIMITIVE and SKIP are
renumbered on the way in and out, and what belongs to other placements becomes an id that no triangle of it has.
"""

from typing import Any, Final

from tracer.accel.build import MAX_DEPTH
from tracer.geometry.vector import at
from tracer.jit import inline, kernel
from tracer.rays.bundle import trace_bundle
from tracer.rays.leaf import SHADE
from tracer.rays.packet import FROM_POINT, TO_POINT
from tracer.rays.packet_shade import LIGHT_BYTES
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    LIGHT,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    RAY_ROWS,
    ROW,
    SKIP,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    WEIGHT_1,
    WEIGHT_2,
    direction_lanes,
    mask_of,
    shear_lanes,
)
from tracer.simd import (
    absolute,
    load,
    mask_to_bits,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
    splat,
    stack_memory,
    stand_alone,
    store,
)
from tracer.simd.gateway import types
from tracer.types import (
    MAP_BOX,
    MAP_ORIGIN,
    MAP_PAD,
    MAP_TO_OBJECT,
    MAP_TOP_PAD,
    N_MAP,
    N_PLACEMENT,
    PLACED_AS_IS,
    PLACEMENT_FIRST,
    PLACEMENT_KIND,
    PLACEMENT_MATERIAL,
    PLACEMENT_TREE,
    SceneView,
    Vec3,
)

_int64: Final = types.int64
_INF: Final = float("inf")
_STEEPEST: Final = 1e300  # stands for the inverse of 0: with it the slab test has no NaN

_DIRECTION: Final = 0  # rows beside the packet: direction x, y, z
_INVERSE: Final = 3 * ROW  # and its inverses
_WAY_BYTES: Final = 6 * ROW
_OWN_BYTES: Final = RAY_ROWS * ROW
_ENTRY: Final = 32  # bytes of a postponed child: index, count, set of rays, placements that were traced before
_STACK_BYTES: Final = _ENTRY * (MAX_DEPTH + 4)


@inline
def _survey(packet: int, lanes: int, ways: int) -> float:
    """Write directions and their inverses, from the shears; returns the largest coordinate of an origin."""
    reach = splat(VECTOR, 0.0)
    one, steepest = splat(VECTOR, 1.0), splat(VECTOR, _STEEPEST)
    for i in range(VECTORS):
        if (lanes >> (LANES * i)) & NIBBLE == 0:
            continue
        ray, way = packet + STEP * i, ways + STEP * i
        dx, dy, dz = direction_lanes(ray)
        mask = mask_of(lanes, i)
        for k in range(3):
            size = absolute(load(VECTOR, ray + ORIGIN + k * ROW))
            reach = maximum(select(mask, size, reach), reach)  # in this order a NaN does not count
        store(way + _DIRECTION, dx)
        store(way + _DIRECTION + ROW, dy)
        store(way + _DIRECTION + 2 * ROW, dz)
        store(way + _INVERSE, minimum(maximum(one / dx, -steepest), steepest))
        store(way + _INVERSE + ROW, minimum(maximum(one / dy, -steepest), steepest))
        store(way + _INVERSE + 2 * ROW, minimum(maximum(one / dz, -steepest), steepest))
    return float(reduce_max(reach))


@inline
def _meet_box(packet: int, ways: int, lanes: int, low: Any, high: Any, pad: float) -> Any:
    """Return (rays that meet a box before their end, least t at which one does)."""
    low_x, high_x = splat(VECTOR, low.x - pad), splat(VECTOR, high.x + pad)
    low_y, high_y = splat(VECTOR, low.y - pad), splat(VECTOR, high.y + pad)
    low_z, high_z = splat(VECTOR, low.z - pad), splat(VECTOR, high.z + pad)
    zero, infinite = splat(VECTOR, 0.0), splat(VECTOR, _INF)
    met = _int64(0)
    first = infinite
    for i in range(VECTORS):
        bits = (lanes >> (LANES * i)) & NIBBLE
        if bits == 0:
            continue
        ray, way = packet + STEP * i, ways + STEP * i
        x, y = load(VECTOR, ray + ORIGIN), load(VECTOR, ray + ORIGIN + ROW)
        z = load(VECTOR, ray + ORIGIN + 2 * ROW)
        kx, ky = load(VECTOR, way + _INVERSE), load(VECTOR, way + _INVERSE + ROW)
        kz = load(VECTOR, way + _INVERSE + 2 * ROW)
        x0, x1 = (low_x - x) * kx, (high_x - x) * kx
        y0, y1 = (low_y - y) * ky, (high_y - y) * ky
        z0, z1 = (low_z - z) * kz, (high_z - z) * kz
        near = maximum(maximum(minimum(x0, x1), minimum(y0, y1)), maximum(minimum(z0, z1), zero))
        far = minimum(minimum(maximum(x0, x1), maximum(y0, y1)), maximum(z0, z1))
        here = (near <= far) & (near <= load(VECTOR, ray + T_BEST))
        bits &= mask_to_bits(here)
        met |= bits << (LANES * i)
        first = minimum(first, select(mask_of(met, i), near, infinite))
    return met, reduce_min(first)


@inline
def _renumber(packet: int, by: int) -> None:
    """Add to the ids of a packet."""
    offset = splat(INTEGERS, by)
    for i in range(VECTORS):
        ray = packet + STEP * i
        store(ray + PRIMITIVE, load(INTEGERS, ray + PRIMITIVE) + offset)
        store(ray + SKIP, load(INTEGERS, ray + SKIP) + offset)


@inline
def _transform(matrix: Any, i: int, v: Any) -> Any:
    """3 x 3 matrix at ``matrix[i:]`` (flat, by rows) times four vectors."""
    return Vec3(
        splat(VECTOR, matrix[i]) * v.x + splat(VECTOR, matrix[i + 1]) * v.y + splat(VECTOR, matrix[i + 2]) * v.z,
        splat(VECTOR, matrix[i + 3]) * v.x + splat(VECTOR, matrix[i + 4]) * v.y + splat(VECTOR, matrix[i + 5]) * v.z,
        splat(VECTOR, matrix[i + 6]) * v.x + splat(VECTOR, matrix[i + 7]) * v.y + splat(VECTOR, matrix[i + 8]) * v.z,
    )


@inline
def _go_in(maps: Any, i: int, packet: int, ways: int, own: int, lanes: int, first: int, mode: int) -> None:
    """Copy rays into a placement's own space; its map begins at ``maps[i]``, its ids with ``first``."""
    origin_x = splat(VECTOR, maps[i + MAP_ORIGIN])
    origin_y = splat(VECTOR, maps[i + MAP_ORIGIN + 1])
    origin_z = splat(VECTOR, maps[i + MAP_ORIGIN + 2])
    offset = splat(INTEGERS, first)
    for k in range(VECTORS):
        if (lanes >> (LANES * k)) & NIBBLE == 0:
            continue
        ray, mine, way = packet + STEP * k, own + STEP * k, ways + STEP * k
        o = Vec3(
            load(VECTOR, ray + ORIGIN) - origin_x,
            load(VECTOR, ray + ORIGIN + ROW) - origin_y,
            load(VECTOR, ray + ORIGIN + 2 * ROW) - origin_z,
        )
        d = Vec3(load(VECTOR, way), load(VECTOR, way + ROW), load(VECTOR, way + 2 * ROW))
        o, d = _transform(maps, i + MAP_TO_OBJECT, o), _transform(maps, i + MAP_TO_OBJECT, d)
        store(mine + ORIGIN, o.x)
        store(mine + ORIGIN + ROW, o.y)
        store(mine + ORIGIN + 2 * ROW, o.z)
        shear_lanes(own, k, d.x, d.y, d.z)
        store(mine + T_BEST, load(VECTOR, ray + T_BEST))
        store(mine + SKIP, load(INTEGERS, ray + SKIP) - offset)
        store(mine + PRIMITIVE, load(INTEGERS, ray + PRIMITIVE) - offset)
        store(mine + WEIGHT_1, load(VECTOR, ray + WEIGHT_1))
        store(mine + WEIGHT_2, load(VECTOR, ray + WEIGHT_2))
        if mode == SHADE:
            for row in range(LIGHT, LIGHT + LIGHT_BYTES, ROW):
                store(mine + row, load(VECTOR, ray + row))


@inline
def _come_out(packet: int, own: int, lanes: int, first: int, mode: int) -> None:
    """Copy back what was found; lanes outside the set get what they had."""
    offset = splat(INTEGERS, first)
    for k in range(VECTORS):
        if (lanes >> (LANES * k)) & NIBBLE == 0:
            continue
        ray, mine = packet + STEP * k, own + STEP * k
        if mode == SHADE:
            for row in range(LIGHT, LIGHT + LIGHT_BYTES, ROW):
                store(ray + row, load(VECTOR, mine + row))
        else:
            store(ray + T_BEST, load(VECTOR, mine + T_BEST))
            store(ray + PRIMITIVE, load(INTEGERS, mine + PRIMITIVE) + offset)
            store(ray + WEIGHT_1, load(VECTOR, mine + WEIGHT_1))
            store(ray + WEIGHT_2, load(VECTOR, mine + WEIGHT_2))


@kernel
def _trace_placement(
    view: SceneView,
    trees: int,
    placement: int,
    packet: int,
    ways: int,
    own: int,
    lanes: int,
    mode: int,
    kt: int,
    face_material: int,
    stride: int,
) -> Any:
    """Follow rays through one placement; returns as `trace_bundle`."""
    row = N_PLACEMENT * placement
    base = trees + 8 * view.placements[row + PLACEMENT_TREE]
    first = view.placements[row + PLACEMENT_FIRST]
    materials = face_material + 4 * view.placements[row + PLACEMENT_MATERIAL]
    if view.placements[row + PLACEMENT_KIND] == PLACED_AS_IS:
        _renumber(packet, -first)
        ended = trace_bundle(base, packet, lanes, mode, kt, materials, stride)
        _renumber(packet, first)
        return ended
    _go_in(view.placement_maps, N_MAP * placement, packet, ways, own, lanes, first, mode)
    ended = trace_bundle(base, own, lanes, mode, kt, materials, stride)
    _come_out(packet, own, lanes, first, mode)
    return ended


@inline
def _postpone(top: int, index: int, count: int, lanes: int, traced: int) -> int:
    """Put a child on the stack; returns the new top."""
    store(top, _int64(index))
    store(top + 8, _int64(count))
    store(top + 16, lanes)
    store(top + 24, traced)
    return top + _ENTRY


@inline
def _meet_child(
    view: SceneView, packet: int, ways: int, lanes: int, node: int, child: int, reach: float, skew: float
) -> Any:
    """As `_meet_box`, for a child of a node."""
    bounds = view.top_bounds
    i = 12 * node + child
    low = Vec3(bounds[i], bounds[i + 4], bounds[i + 8])
    high = Vec3(bounds[i + 2], bounds[i + 6], bounds[i + 10])
    size = max(abs(low.x), abs(low.y), abs(low.z), abs(high.x), abs(high.y), abs(high.z))
    return _meet_box(packet, ways, lanes, low, high, skew * (reach + size))


@inline
def _meet_placement(view: SceneView, packet: int, ways: int, lanes: int, placement: int, reach: float) -> Any:
    """Return the rays that meet a placement's box."""
    i = N_MAP * placement
    low, high = at(view.placement_maps, i + MAP_BOX), at(view.placement_maps, i + MAP_BOX + 3)
    size = max(abs(low.x), abs(low.y), abs(low.z), abs(high.x), abs(high.y), abs(high.z))
    return _meet_box(packet, ways, lanes, low, high, view.placement_maps[i + MAP_PAD] * (reach + size))[0]


@kernel
def trace_placements(
    view: SceneView, trees: int, packet: int, lanes: int, mode: int, kt: int, face_material: int, stride: int
) -> Any:
    """Follow any rays of a packet through all placements.

    Parameters
    ----------
    view
        The scene.
    trees
        Address of `trees`.
    packet, lanes, mode, kt, face_material, stride
        As :func:`tracer.rays.packet.trace_packet`; ids are the scene's.

    Returns
    -------
    int64
        As :func:`tracer.rays.bundle.trace_bundle`.
    """
    stand_alone()
    mode &= ~(FROM_POINT | TO_POINT)  # ends change from placement to placement, and a map rounds what they end in
    own, ways, stack = stack_memory(_OWN_BYTES), stack_memory(_WAY_BYTES), stack_memory(_STACK_BYTES)
    reach = _survey(packet, lanes, ways)
    skew = view.placement_maps[MAP_TOP_PAD]
    ended, traced = _int64(0), _int64(0)
    top = _postpone(stack, 0, 0, lanes, traced)
    while top > stack:
        top -= _ENTRY
        index, count = load(_int64, top), load(_int64, top + 8)
        lanes = load(_int64, top + 16) & ~ended
        if lanes != 0 and count == 0:
            met0, near0 = _meet_child(view, packet, ways, lanes, index, 0, reach, skew)
            met1, near1 = _meet_child(view, packet, ways, lanes, index, 1, reach, skew)
            child0, count0 = view.top_children[4 * index], view.top_children[4 * index + 1]
            child1, count1 = view.top_children[4 * index + 2], view.top_children[4 * index + 3]
            if met1 != 0 and near0 <= near1:
                top = _postpone(top, child1, count1, met1, traced)
            if met0 != 0:
                top = _postpone(top, child0, count0, met0, traced)
            if met1 != 0 and not near0 <= near1:
                top = _postpone(top, child1, count1, met1, traced)
        elif lanes != 0:
            placement = _int64(view.top_slots[index])
            if load(_int64, top + 24) != traced:  # since then some rays may have met something nearer
                lanes = _meet_placement(view, packet, ways, lanes, placement, reach)
            if lanes != 0:
                traced += 1
                ended |= _trace_placement(
                    view, trees, placement, packet, ways, own, lanes, mode, kt, face_material, stride
                )
    return ended


@inline
def trace_scene(
    view: SceneView, trees: int, packet: int, lanes: int, mode: int, kt: int, face_material: int, stride: int
) -> Any:
    """Follow any rays of a packet through a scene's triangles; parameters as :func:`trace_placements`."""
    if view.n_placements == 1:  # as it is, and its ids begin with 0
        return trace_bundle(trees, packet, lanes, mode, kt, face_material, stride)
    return trace_placements(view, trees, packet, lanes, mode, kt, face_material, stride)
