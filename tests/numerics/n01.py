"""N1: closed meshes at all places and scales lose no ray and count none twice. Oracle: topology."""

import numpy as np
from closed_meshes import AIMS, MESHES, rays_from_inside
from row import Row

from tracer.rays import RayCaster

OFFSETS = (0.0, 1.5e5, 1e7, 1e12)  # in mesh diameters
SCALES = (1e-6, 1.0, 1e6)
CELLS = [(name, offset, scale) for name in MESHES for offset in OFFSETS for scale in SCALES]


def placed(name, offset, scale):
    """The mesh moved and scaled; None where float64 no longer resolves its shortest edge (a degenerate cell)."""
    make, inside, reach = MESHES[name]
    vertices, faces = make()
    diameter = np.linalg.norm(vertices.max(0) - vertices.min(0))
    shift = np.array([1.0, -0.7, 0.5]) * offset * diameter
    moved = (vertices + shift) * scale
    edges = moved[faces] - moved[np.roll(faces, 1, 1)]
    shortest = np.linalg.norm(edges, axis=2).min()
    if np.spacing(np.abs(moved).max()) > shortest / 8:
        return None
    return moved, faces, (np.array(inside) + shift) * scale, reach * scale


def batches(cases, seed, chunk=100_000):
    """Yield (cell, caster, vertices, faces, origins, directions) until there were ``cases`` rays."""
    cells = [(cell, where) for cell in CELLS if (where := placed(*cell)) is not None]
    each = max(1, cases // (len(cells) * len(AIMS)))
    rng = np.random.default_rng(seed)
    for cell, (vertices, faces, centre, reach) in cells:
        caster = RayCaster(vertices, faces)
        for aim in AIMS:
            for first in range(0, each, chunk):
                n = min(chunk, each - first)
                origins, directions = rays_from_inside(vertices, faces, aim, n, rng, centre, reach)
                usable = np.abs(directions).max(1) > 0
                yield (*cell, aim), caster, vertices, faces, origins[usable], directions[usable]


def run(cases, seed=1):
    total = misses = wrong = disagree = 0
    for _cell, caster, _vertices, _faces, origins, directions in batches(cases, seed):
        found = caster.closest_hit(origins, directions).primitive >= 0
        total += len(origins)
        misses += int((~found).sum())
        wrong += int((caster.count_hits(origins, directions) % 2 == 0).sum())
        disagree += int((caster.any_hit(origins, directions) != found).sum())
    degenerate = sorted({(name, offset) for name, offset, scale in CELLS if placed(name, offset, scale) is None})
    note = f"misses {misses}, parity {wrong}, any-hit {disagree}; degenerate cells {degenerate}"
    return Row("N1", "closed meshes, single rays", total, misses + wrong + disagree, 0.0, 0.0, note)
