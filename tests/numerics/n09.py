"""N9: a ray that leaves a surface neither meets it again nor slips through it.

The renderer's way: an origin offset by the point's error bound, and the face that is left named. Convex meshes and
spheres, at coordinates of 1e-8 to 1e8, leaving at 1e-8 rad to a right angle. Going out, a ray meets
nothing; going in, it meets the far side. From placements too, turned, squeezed up to 1e6 : 1, mirrored and moved by up to
1e4 times their size: there nothing is met even where the face is not named.
"""

import math

import numpy as np
from by_packets import by_packets
from row import Row

from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.placements import place, random_turn, rows_of
from tests.tracer.rays.spawning import offset_origin
from tests.tracer.shading.hits import meet
from tracer.geometry.shapes import cross_shape, locate_on_shape
from tracer.geometry.vector import subtract
from tracer.jit import kernel
from tracer.rays import RayCaster
from tracer.rays.rows import PACKET
from tracer.render.tiny import make_scene
from tracer.shading.rows import ERROR, GEOMETRIC, POSITION
from tracer.types import MATERIAL_A, MATERIAL_ETA, N_MATERIAL, SHAPE_SPHERE, Vec3


def scene_of(vertices, faces):
    """A compiled scene of one mesh in one plain material."""
    n = len(vertices)
    material = np.zeros((1, N_MATERIAL))
    material[0, [MATERIAL_A, MATERIAL_ETA]] = 1.0
    return make_scene(
        vertex_positions=vertices,
        vertex_normals=np.zeros((n, 3)),
        vertex_uvs=np.zeros((n, 2)),
        vertex_colors=np.ones((n, 3)),
        face_vertices=faces,
        face_material=np.zeros(len(faces), np.int32),
        face_flags=np.zeros(len(faces), np.uint8),
        materials=material,
        material_flags=[[-1, 0, 0, 1]],
    )


@kernel
def offset_all(positions, errors, normals, directions, origins):
    for i in range(len(positions)):
        p = Vec3(positions[i, 0], positions[i, 1], positions[i, 2])
        e = Vec3(errors[i, 0], errors[i, 1], errors[i, 2])
        n = Vec3(normals[i, 0], normals[i, 1], normals[i, 2])
        o = offset_origin(p, e, n, Vec3(directions[i, 0], directions[i, 1], directions[i, 2]))
        origins[i, 0], origins[i, 1], origins[i, 2] = o.x, o.y, o.z


def leave_triangles(scene, primitives, u, v, directions):
    """Origins of rays that leave points of faces, as the renderer's own surfaces give them."""
    origins = np.empty((len(primitives), 3))
    for first in range(0, len(primitives), PACKET):
        k = slice(first, min(first + PACKET, len(primitives)))
        hits = meet(scene, np.zeros(3), directions[k], primitives[k], u=u[k], v=v[k])[0]
        offset_all(hits.get(POSITION), hits.get(ERROR), hits.get(GEOMETRIC), directions[k], origins[k])
    return origins


@kernel
def leave_spheres(centres, radii, starts, directions, outwards, verdicts):
    """Meet each sphere, leave along a direction; the verdict is how many roots lie ahead of the new origin."""
    for i in range(len(radii)):
        r = radii[i]
        to_world = np.array([r, 0.0, 0.0, 0.0, r, 0.0, 0.0, 0.0, r])
        to_local = np.array([1 / r, 0.0, 0.0, 0.0, 1 / r, 0.0, 0.0, 0.0, 1 / r])
        centre = Vec3(centres[i, 0], centres[i, 1], centres[i, 2])
        o = Vec3(starts[i, 0], starts[i, 1], starts[i, 2])
        d = subtract(centre, o)
        k = 1 / r
        first = cross_shape(SHAPE_SPHERE, Vec3(-d.x * k, -d.y * k, -d.z * k), Vec3(d.x * k, d.y * k, d.z * k))
        point = locate_on_shape(SHAPE_SPHERE, centre, to_world, to_local, 0, o, d, first.t0)
        n = point.normal
        # the direction: a tangent, and a little of the normal
        t = Vec3(directions[i, 0], directions[i, 1], directions[i, 2])
        along = t.x * n.x + t.y * n.y + t.z * n.z
        t = Vec3(t.x - along * n.x, t.y - along * n.y, t.z - along * n.z)
        size = math.sqrt(t.x * t.x + t.y * t.y + t.z * t.z)
        s = outwards[i]
        away = Vec3(t.x / size + s * n.x, t.y / size + s * n.y, t.z / size + s * n.z)
        q = offset_origin(point.position, point.error, n, away)
        q = subtract(q, centre)
        roots = cross_shape(SHAPE_SPHERE, Vec3(q.x * k, q.y * k, q.z * k), Vec3(away.x * k, away.y * k, away.z * k))
        verdicts[i] = (1 if roots.t0 > 0.0 else 0) + (1 if roots.t1 > 0.0 else 0)


def convex(n, rng):
    """A convex mesh with slivers: the hull of two rings of points on a sphere, close together in places."""
    angles = np.sort(rng.random(n)) * 2 * np.pi
    angles[1::4] = angles[::4][: len(angles[1::4])] + 1e-6
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    vertices = np.concatenate([ring, [[0, 0, 0.7], [0, 0, -0.6]]])
    k = np.arange(n)
    faces = [np.stack([k, (k + 1) % n, 0 * k + n], -1), np.stack([(k + 1) % n, k, 0 * k + n + 1], -1)]
    return vertices, np.concatenate(faces).astype(np.int32)


def grid(n, linear, rng):
    """A flat mesh, across the direction in which a map stretches most: what strays meets one of its other triangles."""
    x, y = np.meshgrid(np.sort(rng.uniform(-1, 1, n)), np.sort(rng.uniform(-1, 1, n)), indexing="ij")
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    plane = np.linalg.svd(linear)[2][1:]
    return np.stack([x.ravel(), y.ravel()], 1) @ plane, faces.astype(np.int32)


def leave_placements(cases, rng):
    """Rays that leave placed convex meshes: (rays, met again, met again where the face is not named)."""
    total = again = bare = 0
    for number in range(max(20, cases // 300)):
        linear = random_turn(rng) @ np.diag(10.0 ** rng.uniform(-3, 3, 3)) @ random_turn(rng)
        linear = linear * 10.0 ** rng.uniform(-6, 6) * (-1.0) ** number
        vertices, faces = convex(24, rng) if number % 4 < 2 else grid(6, linear, rng)
        size = np.abs(linear).max()
        shift = rng.standard_normal(3) * size * rng.choice([0.0, 1.0, 1e4])
        away = rows_of(np.eye(3) * size, [1e12 * (size + np.abs(shift).max()), 0, 0])
        scene = place([(vertices, faces)], [(0, rows_of(linear, shift)), (0, away)]).scene
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a) @ np.linalg.inv(linear)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        primitives, weights = rng.integers(0, len(faces), 300), rng.dirichlet((0.4, 0.4, 0.4), 300)
        out = normals[primitives]
        directions = np.cross(out, rng.normal(size=(300, 3)))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions += 10.0 ** rng.uniform(-10, 0, (300, 1)) * out
        rises = (directions * out).sum(1) > 1e-14 * np.linalg.cond(linear)
        origins = leave_triangles(scene, primitives, weights[:, 1], weights[:, 2], directions)
        total += int(rises.sum())
        again += int((rises & (find_closest(scene, origins, directions, primitives).primitive >= 0)).sum())
        bare += int((rises & (find_closest(scene, origins, directions).primitive >= 0)).sum())
    return total, again, bare


def run(cases, seed=9):
    rng = np.random.default_rng(seed)
    hit_again = leaked = bare = total = 0
    for scale in 10.0 ** np.arange(-8, 9, 4):
        for shift in (0.0, 1.0, 1e4):
            n = max(16, cases // 30)
            vertices, faces = convex(24, rng)
            vertices = np.ascontiguousarray((vertices + shift * np.array([1.0, -0.4, 0.3])) * scale)
            caster, scene = RayCaster(vertices, faces), scene_of(vertices, faces)
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            normals = np.cross(b - a, c - a)
            narrow = np.linalg.norm(normals, axis=1, keepdims=True)[:, 0] / scale**2
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            primitives = rng.integers(0, len(faces), n)
            weights = rng.dirichlet((1, 1, 1), n)
            tangent = np.cross(normals[primitives], rng.normal(size=(n, 3)))
            tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
            lift = 10.0 ** rng.uniform(-8, 0, (n, 1))
            for sign in (1.0, -1.0):
                directions = tangent + sign * lift * normals[primitives]
                # what the rounded direction really does counts: the definition of out and in
                rises = (directions * normals[primitives]).sum(1) * sign > 1e-12
                origins = leave_triangles(scene, primitives, weights[:, 1], weights[:, 2], directions)
                found = by_packets(caster.bvh, origins, directions, skips=primitives)[1]
                total += int(rises.sum())
                if sign > 0:
                    hit_again += int((rises & (found >= 0)).sum())
                    bare += int((rises & (caster.closest_hit(origins, directions).primitive >= 0)).sum())
                else:
                    # well inside a face and steep enough, the other side is farther than the offset
                    deep = (weights.min(1) > 1e-3) & (lift[:, 0] > 1e-3) & (narrow[primitives] > 1e-3) & (shift < 1e3)
                    leaked += int((deep & (found < 0)).sum())
    n = max(16, cases // 2)
    centres = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-8, 8, (n, 1))
    radii = np.linalg.norm(centres, axis=1) * 10.0 ** rng.uniform(-4, 4, n)
    starts = centres + rng.normal(size=(n, 3)) * radii[:, None] * 10
    starts = np.where(
        np.linalg.norm(starts - centres, axis=1, keepdims=True) > 1.5 * radii[:, None],
        starts,
        centres + 3 * radii[:, None],
    )
    sense = rng.choice([-1, 1], n)
    lift = 10.0 ** rng.uniform(-8, 0, n) * sense
    verdicts = np.empty(n, np.int64)
    leave_spheres(centres, radii, starts, rng.normal(size=(n, 3)), lift, verdicts)
    total += n
    sphere_again = int(((sense > 0) & (verdicts != 0)).sum())
    # a chord of 2 sin(lift) radii is there to be met only if it is longer than the offset: well above 1e-4
    sphere_leaked = int(((lift < -1e-3) & (verdicts != 1) & (radii > 1e-2 * np.linalg.norm(centres, axis=1))).sum())
    placed, placed_again, placed_bare = leave_placements(cases // 4, rng)
    total += placed
    note = f"meshes: met again {hit_again}, leaked {leaked}; spheres: met again {sphere_again}, leaked {sphere_leaked}"
    note += f"; placements: met again {placed_again}, {placed_bare} without naming the face; without naming the face that they leave, {bare} met something"
    wrong = hit_again + leaked + sphere_again + sphere_leaked + placed_again + placed_bare
    return Row("N9", "leave a surface", total, wrong, 0.0, 0.0, note)
