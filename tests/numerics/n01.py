"""N1: closed meshes at all places and scales lose no ray and count none twice. Oracle: topology.

Also two of them 1e7 diameters apart in one scene: no ray is lost there either, and none has more to visit than if its
mesh were alone (:func:`far_pair`). Where the ``embreex`` wheel is installed, what its default robust mode misses of the
same rays is told beside: at the origin alone, for it takes float32.
"""

from importlib.util import find_spec

import numpy as np
from row import Row

from tests.numerics.closed_meshes import AIMS, MESHES, rays_from_inside
from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.visits import count_visits
from tracer.accel import build_tree, join_hierarchies
from tracer.rays import RayCaster
from tracer.render.parts import MeshRecord, build_parts
from tracer.render.tiny import make_scene
from tracer.scene import IDENTITY

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


def far_pair(name, scale):
    """A mesh and its twin 1e7 diameters away, as a scene is made of them: (scene, meshes, where rays start)."""
    pairs = [(*placed(name, offset, scale), MESHES[name][0]()) for offset in (0.0, 1e7)]
    records = []
    for vertices, faces, *_ in pairs:
        none, flags = np.zeros(len(faces), np.int32), np.zeros(len(faces), np.uint8)
        records.append(MeshRecord(vertices, None, None, None, faces, flags, none, IDENTITY, ""))
    parts = build_parts(records, build_tree)
    scene = make_scene()
    hierarchies = join_hierarchies(
        parts.trees, parts.placements, scene.shape_kind, scene.shape_origin, scene.shape_to_world
    )
    return scene._replace(**parts.arrays, **hierarchies._asdict()), parts, pairs


def run_far(cases, rng):
    """Rays in far pairs: (rays, wrong answers, largest ratio of a ray's work to that in its mesh alone)."""
    total = wrong = 0
    most = 0.0
    cells = [(name, scale) for name in MESHES for scale in SCALES if placed(name, 1e7, scale) is not None]
    for name, scale in cells:
        scene, parts, pairs = far_pair(name, scale)
        for number, (vertices, faces, centre, reach, _) in enumerate(pairs):
            caster = RayCaster(vertices, faces)
            for aim in AIMS:
                n = max(4, cases // (len(cells) * 2 * len(AIMS)))
                origins, directions = rays_from_inside(vertices, faces, aim, n, rng, centre, reach)
                usable = np.abs(directions).max(1) > 0
                origins, directions = origins[usable], directions[usable]
                alone, hits = caster.closest_hit(origins, directions), find_closest(scene, origins, directions)
                same = (hits.primitive == alone.primitive + number * len(faces)) & (alone.primitive >= 0)
                wrong += int((~same).sum())
                total += len(origins)
                if aim == "random":
                    work = sum(count_visits(tree, origins[:50], directions[:50]) for tree in parts.trees)
                    work = work + len(parts.trees) - 1  # boxes of placements
                    most = max(
                        most, float((work / count_visits(caster.bvh.buffer, origins[:50], directions[:50])).max())
                    )
    return total, wrong, most


def missed_by_embree(vertices, faces, origins, directions):
    """Count the rays from inside that embreex lets out of the mesh."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    # the scene does not keep what it is made of alive
    mesh = TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    found = scene.run(origins.astype(np.float32), directions.astype(np.float32))
    del mesh
    return int((np.asarray(found) < 0).sum())


def run(cases, seed=1):
    total = misses = wrong = disagree = compared = embree = 0
    has_embree = find_spec("embreex") is not None
    for cell, caster, vertices, faces, origins, directions in batches(cases, seed):
        if has_embree and cell[1] == 0.0:
            compared += len(origins)
            embree += missed_by_embree(vertices, faces, origins, directions)
        found = caster.closest_hit(origins, directions).primitive >= 0
        total += len(origins)
        misses += int((~found).sum())
        wrong += int((caster.count_hits(origins, directions) % 2 == 0).sum())
        disagree += int((caster.any_hit(origins, directions) != found).sum())
    far, far_wrong, most = run_far(cases // 10, np.random.default_rng(seed))
    if most > 2.0:  # one frame over both has each ray visit all of its mesh
        far_wrong += 1
    degenerate = sorted({(name, offset) for name, offset, scale in CELLS if placed(name, offset, scale) is None})
    note = f"misses {misses}, parity {wrong}, any-hit {disagree}; 1e7 diameters apart: wrong {far_wrong}, work at most {most:.2f} of a mesh alone; degenerate cells {degenerate}"
    if compared:
        note += f"; embreex misses {embree:,} of {compared:,}"
    return Row("N1", "closed meshes, single rays", total + far, misses + wrong + disagree + far_wrong, 0.0, 0.0, note)
