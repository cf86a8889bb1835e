"""N6: what is no ray misses by every path, has nothing to visit, and leaves its neighbours' answers alone.

No rays are, by the definition of `RayCaster.closest_hit`: a NaN anywhere, an origin beyond 1e100, an infinite or zero
direction, an empty interval max(tmin, 0) < t < tmax. They stand among rays that are some, of which a part is extreme:
directions of any length that float64 has, denormals among their components, origins up to 1e100 away, limits at the
ends of float64. Oracle of these: brute force.
"""

import numpy as np
from by_packets import by_packets
from n02 import answers, paths_of
from row import Row

from tests.numerics.closed_meshes import by_brute_force, flat_boxes, needle, sphere, torus
from tracer.jit import kernel
from tracer.rays import RayCaster
from tracer.rays import state as s
from tracer.rays.caster import checked_rays
from tracer.rays.leaf import COUNT
from tracer.rays.single import trace_single
from tracer.rays.start import END, LANES, SCRATCH_BYTES, reach_of, start_rays
from tracer.rays.stream import trace_stream
from tracer.simd import address_of, load, stack_memory, store
from tracer.simd.gateway import types

_int64 = types.int64
_SLOTS_BYTES, _STATES_BYTES = 8 * LANES, LANES * s.STATE_BYTES
BATCH = 2048  # the caster looks for company from 1,024 on
MESHES = (lambda: sphere(6, 6), torus, needle, flat_boxes)
PLACES = ((0.0, 1.0), (0.0, 1.0), (1e5, 1.0), (1e9, 1e6), (0.0, 1e-80), (3.0, 1e60))
INF, NAN = np.inf, np.nan
BAD_ORIGINS = (NAN, INF, -INF, np.nextafter(1e100, INF), -1e101, 1.7e308)
BAD_INTERVALS = (
    (NAN, INF), (0, NAN), (NAN, NAN), (INF, INF), (1, 1), (2, 1), (5e-324, 5e-324), (0, 0), (0, -1), (-5, 0),
    (-5, -0.0), (-INF, -1), (-INF, -INF), (1e308, 1e-308),
)  # fmt: skip


@kernel
def first_nodes(tree, rays, nodes):
    """Where each ray starts to look: `END` for nowhere."""
    base = address_of(tree)
    reach = reach_of(base)
    states, slots, rest = stack_memory(_STATES_BYTES), stack_memory(_SLOTS_BYTES), stack_memory(SCRATCH_BYTES)
    for k in range(LANES):
        store(slots + 8 * k, states + k * s.STATE_BYTES)
    for i in range(0, nodes.shape[0], LANES):
        count = min(nodes.shape[0] - i, LANES)
        start_rays(slots, base, reach, rays, i, count, _int64(0), rest)
        for k in range(count):
            nodes[i + k] = load(_int64, states + k * s.STATE_BYTES + s.NODE)


def are_rays(origins, directions, t_min, t_max):
    """The definition, (n,) bool."""
    with np.errstate(over="ignore", invalid="ignore"):
        place = (np.abs(origins) <= 1e100).all(1)
        way = np.isfinite(directions).all(1) & (directions != 0).any(1)
        return place & way & (np.maximum(t_min, 0.0) < t_max)  # a NaN stays one, and compares as false


def stretch(rays, chosen, reach, rng):
    """Make extreme rays of ordinary ones, in place; they remain rays."""
    origins, directions, t_min, t_max = rays
    n = len(origins)
    kind = np.where(chosen, rng.integers(0, 5, n), -1)
    with np.errstate(all="ignore"):
        lengths = 2.0 ** rng.integers(-1022, 1000, (n, 1))
        directions[kind == 0] = (directions * lengths)[kind == 0]
        tiny = rng.choice([5e-324, -5e-324, 1e-310, 0.0, -0.0], (n, 3))
        spared = np.arange(3) == np.abs(directions).argmax(1)[:, None]
        directions[kind == 1] = np.where(spared, directions, tiny)[kind == 1]
        back = 10.0 ** rng.uniform(0, 99, (n, 1)) * directions / np.abs(directions).max(1, keepdims=True)
        origins[kind == 2] = np.clip(origins - reach * back, -1e100, 1e100)[kind == 2]
    t_min[kind == 3] = rng.choice([-INF, -1.0, -0.0, 5e-324, 1e-300], n)[kind == 3]
    t_max[kind == 4] = rng.choice([1.7976931348623157e308, 1.0, 1e-3, 5e-324, 1e300], n)[kind == 4]


def spoil(rays, chosen, rng):
    """Make what is no ray, in place: one thing wrong with it, or two."""
    origins, directions, t_min, t_max = rays
    n = len(origins)
    for again in (1.0, 0.2):
        kind = np.where(chosen & (rng.random(n) < again), rng.integers(0, 4, n), -1)
        axis = rng.integers(0, 3, n)
        rows = np.flatnonzero(kind == 0)
        origins[rows, axis[rows]] = rng.choice(BAD_ORIGINS, len(rows))
        rows = np.flatnonzero(kind == 1)
        directions[rows, axis[rows]] = rng.choice([NAN, INF, -INF], len(rows))
        rows = np.flatnonzero(kind == 2)
        directions[rows] = rng.choice([0.0, -0.0], (len(rows), 3))
        rows = np.flatnonzero(kind == 3)
        t_min[rows], t_max[rows] = np.array(BAD_INTERVALS)[rng.integers(0, len(BAD_INTERVALS), len(rows))].T


def batch(n, rng):
    """A mesh, and rays at it: (vertices, faces, rays, which are some)."""
    vertices, faces = MESHES[rng.integers(len(MESHES))]()
    shift, scale = PLACES[rng.integers(len(PLACES))]
    size = np.abs(vertices).max()
    vertices = (vertices + np.array([1.0, -0.6, 0.3]) * shift * size) * scale
    corners = vertices[faces[rng.integers(0, len(faces), n)]]
    targets = (corners * rng.choice([0.0, 0.5, 1.0, 1.0], (n, 3, 1))).sum(1) / 3  # some in a face, some beside it
    targets = np.where(rng.random((n, 1)) < 0.7, (corners * rng.dirichlet(np.ones(3), n)[:, :, None]).sum(1), targets)
    reach = size * scale
    origins = targets + rng.normal(size=(n, 3)) * reach * rng.choice([0.3, 2.0])
    if rng.random() < 0.5:  # a pinhole's, in order: neighbours go together
        origins[:] = origins[0]
        slopes = targets - origins
        targets = targets[np.lexsort((slopes[:, 1], slopes[:, 0], np.abs(slopes).argmax(1)))]
    rays = [origins, targets - origins, np.zeros(n), np.full(n, INF)]
    rays[1][~(rays[1] != 0).any(1)] = 1.0
    stretch(rays, rng.random(n) < 0.3, reach, rng)
    spoil(rays, rng.random(n) < rng.choice([0.02, 0.3, 0.9]), rng)
    if 1e-7 < scale < 1e7 and rng.random() < 0.3:
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            rays[:2] = [array.astype(np.float32) for array in rays[:2]]
    return vertices, faces, rays, are_rays(*rays)


def expected(vertices, faces, rays, are_some):
    """(t, primitive, crossings): of rays by brute force, of others by definition."""
    n = len(are_some)
    t, primitive, crossings = np.full(n, INF), np.full(n, -1), np.zeros(n, np.int64)
    some = [array[are_some] for array in rays]
    t[are_some], primitive[are_some], crossings[are_some] = by_brute_force(vertices, faces, *some)
    return t, primitive, crossings


def counted(path, caster, rays):
    """Crossings by one path."""
    counts = np.full(rays.n, -7, np.int32)
    none = np.empty(0)
    path(caster.bvh.buffer, rays.packed, 0, rays.n, COUNT, none, counts, none, none)
    return counts


def differing(caster, given, are_some, right):
    """Wrong answers of each path, and rays that are none and look further all the same."""
    t, primitive, crossings = right
    rays = checked_rays(*given)
    alone = answers(trace_single, caster, rays)
    weights = [np.where(primitive >= 0, weight, 0.0) for weight in alone[2:4]]
    paths = {"single": (trace_single, ()), **paths_of(caster)}
    found = {name: answers(path, caster, rays, *more) for name, (path, more) in paths.items()}
    hits = caster.closest_hit(*given)
    found["caster"] = (*hits, caster.any_hit(*given))
    wrong = {}
    for name, answer in found.items():
        apart = (answer[4] != 0) != (primitive >= 0)
        for one, other in zip((t, primitive, *weights), answer, strict=False):
            apart |= one != other  # a NaN differs
        wrong[name] = int(apart.sum())
    for name, counts in (
        ("count, single", counted(trace_single, caster, rays)),
        ("count, stream", counted(trace_stream, caster, rays)),
        ("count, caster", caster.count_hits(*given)),
    ):
        wrong[name] = int((counts != crossings).sum())
    nodes = np.empty(rays.n, np.int64)
    first_nodes(caster.bvh.buffer, rays.packed, nodes)
    wrong["visits"] = int((nodes[~are_some] != END).sum())
    return wrong


def in_packets(caster, given, right):
    """Rays that the renderer's packets may hold, and wrong answers of these.

    They begin at their origins, which are finite, and so are their directions: what else would be a fault of the
    renderer, which compiles finite numbers alone. Their ends may be anywhere.
    """
    keep = (given[2] <= 0) & ~np.isnan(given[3]) & are_rays(*given[:2], np.zeros(1), np.ones(1))
    origins, directions, t_max = (given[k][keep].astype(np.float64) for k in (0, 1, 3))
    t, primitive, met = by_packets(caster.bvh, origins, directions, t_max)
    right = [column[keep] for column in right]
    return len(t), int(((t != right[0]) | (primitive != right[1]) | (met != (right[1] >= 0))).sum())


def run(cases, seed=6):
    rng = np.random.default_rng(seed)
    total = none = bundled = 0
    wrong = {}
    while total < cases:
        n = min(BATCH, cases - total)
        vertices, faces, rays, are_some = batch(n, rng)
        caster = RayCaster(vertices, faces)
        right = expected(vertices, faces, rays, are_some)
        found = differing(caster, rays, are_some, right)
        n_bundled, found["packets"] = in_packets(caster, rays, right)
        wrong = {name: wrong.get(name, 0) + count for name, count in found.items()}
        bundled += n_bundled
        total += n
        none += n - int(are_some.sum())
    note = (
        ", ".join(f"{name} {count}" for name, count in wrong.items()) + f"; {none:,} are none, {bundled:,} in packets"
    )
    return Row("N6", "rays that are none among others, all paths", total, sum(wrong.values()), 0.0, 0.0, note)
