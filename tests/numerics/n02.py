"""N2: every path gives the same primitive and, bit for bit, the same t, u and v; brute force on a part of them.

The paths: single rays, many in flight, tiles of 64 as they come in a batch, few triangles without a tree, the
renderer's packets, and placements. Rays as they come (incoherent: bundles of few), as a pinhole would send them (one
origin, sorted by direction), and 64 at a time that are a few roundings apart: neighbours in a tile, each at the edge or
vertex that the first is aimed at, or all of them a little beside it. What four rays tell of all between them is held
against brute force, too (:mod:`beams`). A placement that is moved decides about the ray in its own space: brute force
does so about the same moved ray. And rays at random triangles of fine and coarse meshes in one tree
(`closed_meshes.mix`), which a builder may lose; and at meshes of so few triangles that no tree is asked (`handful`).
"""

import numpy as np
from beams import span, wrong_answers
from by_packets import BUDGETS, by_packets
from n01 import batches
from row import Row

from tests.numerics.closed_meshes import by_brute_force, cube, mix
from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.placements import place, random_turn, rows_of
from tracer.rays import RayCaster
from tracer.rays.brute import trace_brute
from tracer.rays.brute_table import FEW
from tracer.rays.caster import Hits, checked_rays
from tracer.rays.coherent import trace_coherent
from tracer.rays.leaf import ANY, CLOSEST
from tracer.rays.single import trace_single
from tracer.rays.stream import trace_stream
from tracer.types import MAP_ORIGIN, MAP_TO_OBJECT

BRUTE = 200  # rays a batch that every face is tested against
TOGETHER = 4  # rays a batch that 63 others go along with, some of them a little beside
NARROW = 12  # rays a batch that 63 others go along with all the way
BEAMS = 24  # a batch
MIX = 200  # rays a mix of fine and coarse meshes
BOX, BOX_FACES = cube()
PATHS = {
    "stream": (trace_stream, ()),
    "tiles in a row": (trace_coherent, (0,)),
    "square tiles": (trace_coherent, (16,)),
}


def fan_out(origins, directions):
    """The same targets from one origin, sorted: rays that share packets."""
    targets = origins + directions
    directions = targets - origins[0]
    order = np.lexsort((directions[:, 2], directions[:, 1], directions[:, 0], np.abs(directions).argmax(1)))
    directions = directions[order]
    keep = np.abs(directions).max(1) > 0
    return np.broadcast_to(origins[0], directions.shape)[keep].copy(), directions[keep]


def bundles(origins, directions, rng):
    """64 rays for each of a few: from none to many roundings beside it, no more than one, or all of them as far beside."""
    origins, directions = np.repeat(origins[:NARROW], 64, 0), np.repeat(directions[:NARROW], 64, 0)
    n = 64 * TOGETHER
    beside = rng.choice([0.0, 1.0, -1.0], directions[:n].shape)
    beside *= 2.0 ** rng.choice([-52, -50, -44, -20], beside.shape)
    narrow = directions * (1.0 + rng.choice([0.0, 2.0**-52, -(2.0**-52)], directions.shape))
    shift = rng.choice([1.0, -1.0], (len(directions) // 64, 3)) * 2.0 ** rng.uniform(
        -48, -20, (len(directions) // 64, 3)
    )
    shifted = narrow[:n] * (1.0 + np.repeat(shift, 64, 0)[:n])
    return np.concatenate([origins[:n], origins, origins[:n]]), np.concatenate(
        [directions[:n] * (1.0 + beside), narrow, shifted]
    )


def answers(path, caster, rays, *more):
    """(t, primitive, u, v, met) by one path."""
    n = rays.n
    hits = Hits(np.empty(n), np.empty(n, np.int32), np.empty(n), np.empty(n))
    path(caster.bvh.buffer, rays.packed, 0, n, CLOSEST, *hits, *more)
    met = Hits(np.empty(0), np.empty(n, np.int32), np.empty(0), np.empty(0))
    path(caster.bvh.buffer, rays.packed, 0, n, ANY, *met, *more)
    return *hits, met.primitive


def paths_of(caster):
    """The paths that are held against single rays: name -> (function, what else it is given)."""
    if caster.bvh.n_triangles > FEW:
        return PATHS
    return {**PATHS, "without a tree": (trace_brute, (caster.few_triangles.ctypes.data,))}


def differing(caster, rays):
    """Return how many rays each path answers otherwise than single rays."""
    alone = answers(trace_single, caster, rays)
    wrong = {}
    for name, (path, more) in paths_of(caster).items():
        apart = np.zeros(rays.n, bool)
        for one, other in zip(alone, answers(path, caster, rays, *more), strict=True):
            apart |= one != other
        wrong[name] = int(apart.sum())
    return wrong


def with_limits(origins, directions, times, rng):
    """The same rays with ends of their own, many of them at the hit itself; some are no rays."""
    n = len(origins)
    at = np.where(np.isfinite(times), times, 1.0)
    factor = rng.choice([0.0, 0.5, 1.0, 1.0, 2.0, np.inf], (2, n))
    with np.errstate(invalid="ignore"):
        t_min, t_max = at * factor[0], at * factor[1]
    kind = rng.integers(0, 50, n)
    origins, directions = origins.copy(), directions.copy()
    origins[kind == 0] = np.nan
    directions[kind == 1] = 0.0
    directions[kind == 2] *= -1.0
    t_min[kind == 3] = np.nan
    return checked_rays(origins, directions, t_min, t_max)


def moved_rays(origins, directions, row):
    """Rays in a placement's own space, by the renderer's arithmetic: the direction from its shear, products in order."""
    kz = 2 - np.abs(directions[:, ::-1]).argmax(1)  # z before y before x where equal
    n = np.arange(len(kz))
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    inverse = 1.0 / directions[n, kz]
    again = directions.copy()
    again[n, kx] = (directions[n, kx] * inverse) * directions[n, kz]
    again[n, ky] = (directions[n, ky] * inverse) * directions[n, kz]
    m = row[MAP_TO_OBJECT : MAP_TO_OBJECT + 9].reshape(3, 3)
    by = lambda v: np.stack([m[k, 0] * v[:, 0] + m[k, 1] * v[:, 1] + m[k, 2] * v[:, 2] for k in range(3)], 1)  # noqa: E731
    return by(origins - row[MAP_ORIGIN : MAP_ORIGIN + 3]), by(again)


def by_placements(vertices, faces, origins, directions, rng):
    """Wrong answers of a scene with one mesh as it is, one moved, and one too far away to be met."""
    size = np.abs(vertices - vertices.mean(0)).max()
    turned = random_turn(rng) @ np.diag([1.0, rng.choice([-1.0, 1.0]), 2.0])
    shift = vertices.mean(0) - turned @ vertices.mean(0) + rng.standard_normal(3) * size
    uses = [(0, None), (0, rows_of(turned, shift)), (0, rows_of(np.eye(3), [1e9 * (size + np.abs(shift).max()), 0, 0]))]
    scene = place([(vertices, faces)], uses).scene
    hits = find_closest(scene, origins, directions)
    t, primitive, _ = by_brute_force(vertices, faces, origins, directions)
    moved = by_brute_force(vertices, faces, *moved_rays(origins, directions, scene.placement_maps[1]))
    nearer = moved[0] < t
    t, primitive = np.where(nearer, moved[0], t), np.where(nearer, moved[1] + len(faces), primitive)
    return int(((hits.t != t) | (hits.primitive != primitive)).sum())


def run_mixes(cases, rng):
    """Rays at random triangles of mixes of fine and coarse meshes: how many, and how many wrong answers."""
    wrong = 0
    for _ in range(max(cases // MIX, 1)):
        vertices, faces = mix(rng)
        vertices = vertices.astype(rng.choice([np.float32, np.float64]))
        caster = RayCaster(vertices, faces, threads=int(rng.integers(1, 3)))
        vertices = vertices.astype(np.float64)
        corners = vertices[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        corners = corners[rng.choice(len(faces), MIX, p=0.5 / len(faces) + 0.5 * area / area.sum())]
        targets = (corners * rng.dirichlet(np.ones(3), MIX)[:, :, None]).sum(1)
        origins = rng.uniform(-5, 5, (MIX, 3))
        times, primitives, counts = by_brute_force(vertices, faces, origins, targets - origins)
        hits = caster.closest_hit(origins, targets - origins)
        wrong += int(((hits.t != times) | (hits.primitive != primitives)).sum())
        wrong += int((caster.count_hits(origins, targets - origins) != counts).sum())
    return MIX * max(cases // MIX, 1), wrong


def handful(rng):
    """A mesh of 1 to `FEW` triangles: boxes, tilted and flat ones, loose triangles, slivers, points, copies, all near 1."""
    parts = []
    for _ in range(int(rng.integers(1, 5))):
        axes = random_turn(rng) if rng.random() < 0.5 else np.eye(3)
        corners = BOX * (2.0 ** rng.choice([-30, -12, -3, 0, 0, 0], 3)) @ axes + rng.normal(size=3) * 0.3
        parts.append(corners[BOX_FACES].reshape(-1, 9))
    loose = rng.normal(size=(8, 3, 3))
    loose[:3, 2] = (loose[:3, 0] + loose[:3, 1]) * 0.5 + loose[:3, 2] * 2.0 ** rng.choice([-60, -45, -26, -20], (3, 1))
    loose[3, 1:] = loose[3, 0]
    triangles = np.concatenate([*parts, loose.reshape(-1, 9)])
    triangles = np.concatenate([triangles, triangles[rng.integers(0, len(triangles), 3)]]).reshape(-1, 3, 3)
    nudged = rng.random(triangles.shape) < 0.1
    triangles[nudged] += rng.choice([-1.0, 1.0], nudged.sum()) * 2.0 ** rng.choice([-52, -30, -26, -22], nudged.sum())
    triangles = triangles[rng.permutation(len(triangles))][: int(rng.integers(1, FEW + 1))]
    return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def run_handfuls(cases, rng):
    """Rays at corners, edges and faces of meshes of few triangles: how many, and how many wrong answers."""
    wrong = 0
    for _ in range(max(cases // MIX, 1)):
        vertices, faces = handful(rng)
        scale, shift = 2.0 ** rng.choice([-100, 0, 0, 30]), rng.choice([0.0, 0.0, 1.0, 1e6]) * rng.normal(size=3)
        vertices = (vertices + shift) * scale
        if rng.random() < 0.5 and 1e-20 < scale < 1e20:
            vertices = vertices.astype(np.float32).astype(np.float64)
        a, b, c = vertices[faces[rng.integers(0, len(faces), MIX)]].transpose(1, 0, 2)
        weights = rng.choice([0.0, 0.0, 0.5, 1.0], (MIX, 1)), rng.choice([0.0, 1e-9, 0.3], (MIX, 1))
        targets = a + (b - a) * weights[0] + (c - a) * weights[1]
        origins = (rng.normal(size=(MIX, 3)) * rng.choice([0.1, 0.8, 1.5, 1e4], (MIX, 1)) + shift) * scale
        on_face = rng.random(MIX) < 0.2
        origins[on_face] = vertices[faces[rng.integers(0, len(faces), MIX)]].mean(1)[on_face]
        directions = targets - origins
        keep = np.abs(directions).max(1) > 0
        origins, directions = origins[keep], directions[keep]
        caster = RayCaster(vertices, faces)
        times, primitives, _counts = by_brute_force(vertices, faces, origins, directions)
        alone = answers(trace_single, caster, checked_rays(origins, directions, 0.0, np.inf))
        wrong += int(((alone[0] != times) | (alone[1] != primitives)).sum())
        for rays in (checked_rays(origins, directions, 0.0, np.inf), with_limits(origins, directions, times, rng)):
            wrong += differing(caster, rays)["without a tree"]
    return MIX * max(cases // MIX, 1), wrong


def run(cases, seed=2):
    total = brute = told = 0
    rng = np.random.default_rng(seed + 1000)
    wrong = dict.fromkeys(
        ("caster", "packet", "any-hit in packets", "beams", "placements", "mixes", "handfuls", *PATHS), 0
    )
    for _cell, caster, vertices, faces, origins, directions in batches(cases // 2, seed):
        together = bundles(origins, directions, rng)
        n_wrong, n_told = wrong_answers(
            caster.bvh.buffer, vertices, faces, span(origins[:BEAMS], directions[:BEAMS], rng)
        )
        wrong["beams"] += n_wrong
        told += n_told
        for o, d in ((origins, directions), fan_out(origins, directions), together):
            hits = caster.closest_hit(o, d)
            for budget in BUDGETS:
                times, primitives, met = by_packets(caster.bvh, o, d, budget=budget)
                wrong["packet"] += int(((times != hits.t) | (primitives != hits.primitive)).sum())
                wrong["any-hit in packets"] += int((met != (hits.primitive >= 0)).sum())
            true_times, true_primitives, _ = by_brute_force(vertices, faces, o[:BRUTE], d[:BRUTE])
            wrong["placements"] += by_placements(vertices, faces, o[:BRUTE], d[:BRUTE], rng)
            differs = (true_times != hits.t[:BRUTE]) | (true_primitives != hits.primitive[:BRUTE])
            wrong["caster"] += int(differs.sum())
            for rays in (checked_rays(o, d, 0.0, np.inf), with_limits(o, d, hits.t, rng)):
                for name, count in differing(caster, rays).items():
                    wrong[name] = wrong.get(name, 0) + count
            total += len(o)
            brute += len(o[:BRUTE])
    mixed, wrong["mixes"] = run_mixes(max(cases // 20, 2000), rng)
    few, wrong["handfuls"] = run_handfuls(max(cases // 20, 10_000), rng)
    total += mixed + few
    brute += mixed + few
    note = (
        ", ".join(f"{name} {count}" for name, count in wrong.items())
        + f"; {brute:,} by brute force, {told:,} beams told"
    )
    return Row("N2", "all paths = brute force", total, sum(wrong.values()), 0.0, 0.0, note)
