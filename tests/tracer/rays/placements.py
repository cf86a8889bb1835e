"""Scenes of placements made by hand, and the same scenes with every transform baked: for the tests of the top level."""

from typing import NamedTuple

import numpy as np

from tracer.accel import Placement, build_tree, join_hierarchies
from tracer.accel.placing import AffineMap
from tracer.render.geometry import transform_normals, transform_points
from tracer.render.tiny import make_scene
from tracer.types import MATERIAL_A, MATERIAL_ETA, MATERIAL_KT, N_MATERIAL, CompiledScene


class Placed(NamedTuple):
    """A scene of placements and its baked twin."""

    scene: CompiledScene
    vertices: np.ndarray  # (n, 3) world, all placements'
    faces: np.ndarray  # (m, 3) rows of these; a primitive's id is its row
    baked: CompiledScene


def rows_of(linear, origin=(0.0, 0.0, 0.0)):
    """A matrix of 4 rows."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, origin
    return tuple(map(tuple, matrix.tolist()))


def random_turn(rng):
    """A rotation matrix."""
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def place(meshes, uses, *, normals=None, kt=None):
    """Make both.

    ``meshes``: list of (vertices, faces). ``uses``: list of (mesh, rows or None). ``normals``: for each mesh. ``kt``: (m, 3),
    one material for each placed face.
    """
    trees = [build_tree(np.asarray(v, float), np.asarray(f, np.int32)) for v, f in meshes]
    first_vertex = np.cumsum([0] + [len(v) for v, _ in meshes])
    first_face = np.cumsum([0] + [len(f) for _, f in meshes])
    placements, world, world_normals, world_faces = [], [], [], []
    n_vertices = n_faces = 0
    for mesh, rows in uses:
        v, f = np.asarray(meshes[mesh][0], float), np.asarray(meshes[mesh][1])
        given = np.zeros_like(v) if normals is None else normals[mesh]
        there = None if rows is None else AffineMap.of_rows(rows)
        placements.append(Placement(mesh, len(f), int(first_face[mesh]), n_faces, there))
        if rows is not None:
            v, given = transform_points(rows, v), transform_normals(rows, given)
            if np.linalg.det(there.linear / np.abs(there.linear).max()) < 0:
                f = f[:, [0, 2, 1]]
        world.append(v)
        world_normals.append(given)
        world_faces.append(f + n_vertices)
        n_vertices, n_faces = n_vertices + len(v), n_faces + len(f)
    materials = np.zeros((n_faces if kt is not None else 1, N_MATERIAL))
    materials[:, [MATERIAL_A, MATERIAL_ETA]] = 1.0
    if kt is not None:
        materials[:, MATERIAL_KT : MATERIAL_KT + 3] = kt
    common = {
        "materials": materials,
        "material_flags": np.tile([-1, 0, 0, 1], (len(materials), 1)),
        "face_material": np.arange(n_faces) if kt is not None else np.zeros(n_faces),
    }
    n = int(first_vertex[-1])
    given = np.zeros((n, 3)) if normals is None else np.concatenate(normals)
    scene = make_scene(
        vertex_positions=np.concatenate([v for v, _ in meshes]),
        vertex_normals=given,
        vertex_uvs=np.zeros((n, 2)),
        vertex_colors=np.ones((n, 3)),
        face_vertices=np.concatenate([f + k for (_, f), k in zip(meshes, first_vertex, strict=False)]),
        face_flags=np.full(int(first_face[-1]), int(normals is not None)),
        **common,
    )
    shapes = (scene.shape_kind, scene.shape_origin, scene.shape_to_world)
    scene = scene._replace(**join_hierarchies(trees, placements, *shapes)._asdict())
    vertices, faces = np.concatenate(world), np.concatenate(world_faces)
    baked = make_scene(
        vertex_positions=vertices,
        vertex_normals=np.concatenate(world_normals),
        vertex_uvs=np.zeros((n_vertices, 2)),
        vertex_colors=np.ones((n_vertices, 3)),
        face_vertices=faces,
        face_flags=np.full(n_faces, int(normals is not None)),
        **common,
    )
    return Placed(scene, vertices, faces, baked)
