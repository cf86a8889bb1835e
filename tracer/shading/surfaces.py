"""Fill in what shading needs of 64 hits, triangle by triangle: the rays of one triangle four at a time.

The equations are those of :mod:`tracer.shading.surface`, which serves shapes and planes, one hit at a time.
"""

from typing import Any, Final

from tracer.geometry.rounding import gamma
from tracer.geometry.shapes import transform, transform_transposed
from tracer.geometry.vector import add, at, cross, dot, is_zero, multiply, negate, normalize, subtract
from tracer.jit import inline, int64, kernel
from tracer.rays.rows import (
    INTEGERS,
    LANES,
    NIBBLE,
    ORIGIN,
    PRIMITIVE,
    ROW,
    STEP,
    T_BEST,
    VECTOR,
    VECTORS,
    WEIGHT_1,
    WEIGHT_2,
    mask_of,
    put,
    put_integers,
)
from tracer.shading.rows import (
    ATTENUATION,
    COLOR,
    DIFFUSE,
    DIRECTION,
    ERROR,
    EXPONENT,
    GEOMETRIC,
    MATERIAL,
    NORMAL,
    POSITION,
    SPECULAR,
    START,
    choose,
    lane_at,
    put_lane,
    put_vector,
    spread,
    vector_at,
)
from tracer.shading.surface import make_surface
from tracer.shading.texture import SAMPLE_BYTES, sample_lanes
from tracer.simd import (
    all_lanes,
    count_trailing_zeros,
    load,
    mask_to_bits,
    splat,
    sqrt,
    stack_memory,
    stand_alone,
    store,
)
from tracer.simd.gateway import types
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    FLAG_FILTER,
    FLAG_TEXTURE,
    FLAG_TWO_SIDED,
    FLAG_WRAP,
    MAP_ERROR,
    MAP_ORIGIN,
    MAP_TO_OBJECT,
    MAP_TO_WORLD,
    MATERIAL_A,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KS,
    N_MAP,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    N_PLACEMENT,
    PLACED_AS_IS,
    PLACED_MIRRORED,
    PLACEMENT_FACE,
    PLACEMENT_FIRST,
    PLACEMENT_KIND,
    PLACEMENT_MATERIAL,
    SceneView,
    Vec3,
)

_int64: Final = types.int64
_float64: Final = types.float64
_GAMMA_8: Final = gamma(8)


@inline
def _lanes_of(packet: int, lanes: int, primitive: int) -> Any:
    """Return the rays of a set that have met a primitive."""
    same = _int64(0)
    wanted = splat(INTEGERS, primitive)
    for i in range(VECTORS):
        if (lanes >> (LANES * i)) & NIBBLE != 0:
            met = load(INTEGERS, packet + PRIMITIVE + STEP * i) == wanted
            same |= mask_to_bits(met) << (LANES * i)
    return same & lanes


@inline
def blend(a: Any, b: Any, c: Any, b0: Any, b1: Any, b2: Any) -> Any:
    """Weighted sum of three corners' values, spread over the lanes."""
    return Vec3(
        b0 * splat(VECTOR, a.x) + b1 * splat(VECTOR, b.x) + b2 * splat(VECTOR, c.x),
        b0 * splat(VECTOR, a.y) + b1 * splat(VECTOR, b.y) + b2 * splat(VECTOR, c.y),
        b0 * splat(VECTOR, a.z) + b1 * splat(VECTOR, b.z) + b2 * splat(VECTOR, c.z),
    )


@kernel
def _normalize_carefully(address: int, other: Any) -> None:
    """Make four interpolated normals unit, one by one; ``other`` stands for those that are zero."""
    for lane in range(LANES):
        raw = Vec3(
            load(_float64, address + 8 * lane),
            load(_float64, address + STEP + 8 * lane),
            load(_float64, address + 2 * STEP + 8 * lane),
        )
        unit = other if is_zero(raw) else normalize(raw)
        store(address + 8 * lane, unit.x)
        store(address + STEP + 8 * lane, unit.y)
        store(address + 2 * STEP + 8 * lane, unit.z)


@inline
def _make_unit(raw: Any, other: Any, scratch: int) -> Any:
    """Make four interpolated normals unit; ``other`` (one vector) stands for those that cancel out."""
    squared = dot(raw, raw)
    if all_lanes((squared > splat(VECTOR, 1e-290)) & (squared < splat(VECTOR, 1e290))):
        inverse = splat(VECTOR, 1.0) / sqrt(squared)
        return Vec3(raw.x * inverse, raw.y * inverse, raw.z * inverse)
    store(scratch, raw.x)
    store(scratch + STEP, raw.y)
    store(scratch + 2 * STEP, raw.z)
    _normalize_carefully(scratch, other)
    return Vec3(load(VECTOR, scratch), load(VECTOR, scratch + STEP), load(VECTOR, scratch + 2 * STEP))


@inline
def _put_material(view: SceneView, ambient: Any, at_lanes: int, mask: Any, material: int, tint: Any) -> None:
    """Write a material's coefficients and the light that it sends out by itself [farmer2019 eq. 10, 13]."""
    i = N_MATERIAL * material
    kd, ks = spread(at(view.materials, i + MATERIAL_KD)), spread(at(view.materials, i + MATERIAL_KS))
    ka, ke = spread(multiply(at(view.materials, i + MATERIAL_KA), ambient)), spread(at(view.materials, i + MATERIAL_KE))
    put_vector(at_lanes + DIFFUSE, mask, multiply(kd, tint))
    put_vector(at_lanes + SPECULAR, mask, ks)
    put(at_lanes + EXPONENT, mask, splat(VECTOR, view.materials[i + MATERIAL_EXPONENT]))
    put_vector(at_lanes + ATTENUATION, mask, spread(at(view.materials, i + MATERIAL_A)))
    put_integers(at_lanes + MATERIAL, mask, splat(INTEGERS, material))
    put(at_lanes + COLOR, mask, ka.x * tint.x + ke.x)
    put(at_lanes + COLOR + ROW, mask, ka.y * tint.y + ke.y)
    put(at_lanes + COLOR + 2 * ROW, mask, ka.z * tint.z + ke.z)


@inline
def placement_of(view: SceneView, primitive: int) -> Any:
    """Find the placement that a triangle's id belongs to."""
    low, high = int64(0), int64(view.n_placements - 1)
    while low < high:
        middle = (low + high + 1) >> 1
        if view.placements[N_PLACEMENT * middle + PLACEMENT_FIRST] <= primitive:
            low = middle
        else:
            high = middle - 1
    return low


@inline
def _to_world(view: SceneView, i: int, point: Vec3) -> Vec3:
    """Place a vertex, as :func:`tracer.render.geometry.transform_points` does."""
    return add(transform(view.placement_maps, i + MAP_TO_WORLD, point), at(view.placement_maps, i + MAP_ORIGIN))


@inline
def face_normals(flags: int, across: Vec3, n0: Vec3, n1: Vec3, n2: Vec3) -> Any:
    """Return (whether the vertices' normals differ, geometric normal, shading normal where they do not).

    Parameters
    ----------
    flags
        FACE_*.
    across
        Cross product of the edges from the first vertex.
    n0, n1, n2
        The vertices' normals.
    """
    normal = normalize(across)
    # flat faces with vertex normals all the same: walls, boxes
    uniform = n0.x == n1.x == n2.x and n0.y == n1.y == n2.y and n0.z == n1.z == n2.z and not is_zero(n0)
    smooth = flags & FACE_HAS_NORMALS != 0 and not uniform
    facing = normal
    if flags & FACE_HAS_NORMALS and uniform:
        facing = normalize(n0)
        if dot(normal, facing) < 0.0:
            normal = negate(normal)
    return smooth, normal, facing


@kernel
def _fill_triangle(
    view: SceneView, ambient: Vec3, packet: int, lanes: int, primitive: int, face: int, material: int, moved: int
) -> Any:
    """Fill in the rays that have met a triangle.

    Parameters
    ----------
    view, ambient, packet, lanes
        As `fill_surfaces`.
    primitive, face, material
        Id; row of face_vertices; row of materials.
    moved
        Where the map of its placement begins in `placement_maps`, plus 1, negative where it mirrors; 0: as it is.

    Returns
    -------
    int64
        Those that came from behind.
    """
    stand_alone()
    i0 = int64(view.face_vertices[3 * face])
    i1 = int64(view.face_vertices[3 * face + 1])
    i2 = int64(view.face_vertices[3 * face + 2])
    weight_1, weight_2 = int64(WEIGHT_1), int64(WEIGHT_2)
    if moved < 0:  # keeps the winding outward
        i1, i2 = i2, i1
        weight_1, weight_2 = weight_2, weight_1
    p0, p1, p2 = at(view.vertex_positions, 3 * i0), at(view.vertex_positions, 3 * i1), at(view.vertex_positions, 3 * i2)
    n0, n1, n2 = at(view.vertex_normals, 3 * i0), at(view.vertex_normals, 3 * i1), at(view.vertex_normals, 3 * i2)
    normal = cross(subtract(p1, p0), subtract(p2, p0))
    more = Vec3(0.0, 0.0, 0.0)  # error of a point, beside what follows from its world coordinates
    if moved != 0:
        place = abs(moved) - 1
        p0, p1, p2 = _to_world(view, place, p0), _to_world(view, place, p1), _to_world(view, place, p2)
        n0 = transform_transposed(view.placement_maps, place + MAP_TO_OBJECT, n0)
        n1 = transform_transposed(view.placement_maps, place + MAP_TO_OBJECT, n1)
        n2 = transform_transposed(view.placement_maps, place + MAP_TO_OBJECT, n2)
        # from the edges in the object's space, which the place in the world does not round
        normal = transform_transposed(view.placement_maps, place + MAP_TO_OBJECT, normal)
        if moved < 0:
            normal = negate(normal)
        more = at(view.placement_maps, place + MAP_ERROR)
    e1, e2 = subtract(p1, p0), subtract(p2, p0)
    # error: gamma(7) of the products' absolute sum (pbrt 6.8.5), and gamma(8) of the extent for the shear of this
    # triangle's and its neighbours' vertices by the next ray, which starts here: the sum alone vanishes near the
    # world's origin
    extent = max(abs(e1.x), abs(e1.y), abs(e1.z), abs(e2.x), abs(e2.y), abs(e2.z))
    # with the weights' sum of at most 1 taken for granted: one bound for all of the triangle
    reach = _GAMMA_8 * extent
    error = Vec3(
        _GAMMA_8 * max(abs(p0.x), abs(p1.x), abs(p2.x)) + reach + more.x,
        _GAMMA_8 * max(abs(p0.y), abs(p1.y), abs(p2.y)) + reach + more.y,
        _GAMMA_8 * max(abs(p0.z), abs(p1.z), abs(p2.z)) + reach + more.z,
    )
    errors = spread(error)
    flags = int64(view.face_flags[face])
    two_sided = view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TWO_SIDED] != 0
    texture = int64(view.material_flags[N_MATERIAL_FLAGS * material + FLAG_TEXTURE])
    wrap = int64(view.material_flags[N_MATERIAL_FLAGS * material + FLAG_WRAP])
    filtering = int64(view.material_flags[N_MATERIAL_FLAGS * material + FLAG_FILTER])
    smooth, normal, facing = face_normals(flags, normal, n0, n1, n2)
    c0, c1, c2 = at(view.vertex_colors, 3 * i0), at(view.vertex_colors, 3 * i1), at(view.vertex_colors, 3 * i2)
    flat, away, level = spread(normal), spread(negate(normal)), spread(facing)
    scratch = stack_memory(SAMPLE_BYTES)
    one = splat(VECTOR, 1.0)
    zero = splat(VECTOR, 0.0)
    behind_lanes = _int64(0)
    for i in range(VECTORS):
        bits = (lanes >> (LANES * i)) & NIBBLE
        if bits == 0:
            continue
        mask = mask_of(lanes, i)
        ray = packet + STEP * i
        b1, b2 = load(VECTOR, ray + weight_1), load(VECTOR, ray + weight_2)
        b0 = (one - b1) - b2
        put_vector(ray + POSITION, mask, blend(p0, p1, p2, b0, b1, b2))
        put_vector(ray + ERROR, mask, errors)
        shading = level
        geometric = flat
        if smooth:  # as given, then unit
            shading = _make_unit(blend(n0, n1, n2, b0, b1, b2), normal, scratch)
            geometric = choose(dot(flat, shading) < zero, away, flat)
        behind = dot(geometric, vector_at(ray + DIRECTION)) > zero
        behind_lanes |= (mask_to_bits(behind) & bits) << (LANES * i)
        put_vector(ray + GEOMETRIC, mask, geometric)
        turned = choose(behind, negate(shading), shading) if two_sided else shading
        put_vector(ray + NORMAL, mask, turned)
        tint = Vec3(one, one, one)
        if flags & FACE_HAS_COLORS:
            tint = blend(c0, c1, c2, b0, b1, b2)
        if texture >= 0:
            u, v = zero, zero
            if flags & FACE_HAS_UVS:
                uvs = view.vertex_uvs
                u = b0 * splat(VECTOR, uvs[2 * i0]) + b1 * splat(VECTOR, uvs[2 * i1]) + b2 * splat(VECTOR, uvs[2 * i2])
                v = (
                    b0 * splat(VECTOR, uvs[2 * i0 + 1])
                    + b1 * splat(VECTOR, uvs[2 * i1 + 1])
                    + b2 * splat(VECTOR, uvs[2 * i2 + 1])
                )
            tint = multiply(tint, sample_lanes(view, texture, wrap, filtering, u, v, bits, scratch))
        _put_material(view, ambient, ray, mask, material, tint)
        put_integers(ray + START, mask, splat(INTEGERS, primitive))
    return behind_lanes


@kernel
def _fill_other(view: SceneView, ambient: Vec3, packet: int, lane: int, primitive: int) -> bool:
    """Fill in one ray that has met a shape or a plane; tells whether it came from behind."""
    ray = packet + 8 * lane
    d = lane_at(ray + DIRECTION)
    surface = make_surface(view, primitive, load(_float64, ray + T_BEST), lane_at(ray + ORIGIN), d)
    behind = dot(surface.geometric, d) > 0.0
    two_sided = view.material_flags[N_MATERIAL_FLAGS * surface.material + FLAG_TWO_SIDED] != 0
    put_lane(ray + POSITION, surface.position)
    put_lane(ray + ERROR, surface.error)
    put_lane(ray + GEOMETRIC, surface.geometric)
    put_lane(ray + NORMAL, negate(surface.shading) if behind and two_sided else surface.shading)
    vector = packet + STEP * (lane // LANES)
    _put_material(
        view, ambient, vector, mask_of(_int64(1) << lane, lane // LANES), surface.material, spread(surface.tint)
    )
    store(ray + START, _int64(surface.skip))
    return bool(behind)


@kernel
def fill_surfaces(view: SceneView, ambient: Vec3, packet: int, lanes: int) -> Any:
    """Fill in the rows of the hit for rays that have met something.

    Parameters
    ----------
    view
        The scene.
    ambient
        Sum of all ambient intensities [farmer2019 eq. 10].
    packet
        Address of the rays and hits.
    lanes
        The rays: PRIMITIVE is not -1.

    Returns
    -------
    int64
        The rays that came from behind, by the geometric normal.
    """
    behind = _int64(0)
    while lanes != 0:
        lane = count_trailing_zeros(lanes)
        primitive = load(_int64, packet + PRIMITIVE + 8 * lane)
        if primitive < view.n_triangles:
            same = _lanes_of(packet, lanes, primitive)
            face, row, moved = primitive, primitive, int64(0)
            if view.n_placements > 1:
                placement = placement_of(view, primitive)
                i = N_PLACEMENT * placement
                number = primitive - view.placements[i + PLACEMENT_FIRST]
                face, row = (
                    number + view.placements[i + PLACEMENT_FACE],
                    number + view.placements[i + PLACEMENT_MATERIAL],
                )
                kind = view.placements[i + PLACEMENT_KIND]
                if kind != PLACED_AS_IS:
                    moved = N_MAP * placement + 1
                    if kind == PLACED_MIRRORED:
                        moved = -moved
            material = int64(view.face_material[row])
            behind |= _fill_triangle(view, ambient, packet, same, primitive, face, material, moved)
        else:
            same = _int64(1) << lane
            if _fill_other(view, ambient, packet, lane, primitive):
                behind |= same
        lanes &= ~same
    return behind
