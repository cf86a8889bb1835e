"""Every file of the pathological set: sane arrays, or an error that names file and reason, in bounded time and memory."""

import time

import numpy as np
import pytest
from loader_files import DATA, data_folder

from tracer.loaders.errors import LoadError
from tracer.loaders.guard import LoadRequest, load_guarded
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.mesh import MeshData
from tracer.types import FACE_HAS_COLORS, FACE_HAS_NORMALS, FACE_HAS_UVS

# What must become of each file: the number of triangles, or a part of the reason (the table of the models' page).
_EXPECTED: dict[str, int | str] = {
    "assimp/BoxBadNormals.glb": 12,
    "assimp/BoxWithInfinites.glb": "finite",
    "assimp/IndexOutOfRange.gltf": "vertex 255, and there are only 24",
    "assimp/MissingBin.gltf": "'BoxTextured0.bin' is missing",
    "assimp/NoScene.gltf": "there are 0 scenes",
    "assimp/OutOfMemory.off": "353535235358",
    "assimp/RecursiveNodes.gltf": "its own ancestor",
    "assimp/concave_polygon.obj": 64,
    "assimp/malformed.obj": "vertex 12, and there are 8",
    "assimp/malformed2_missing_material.obj": 10,
    "assimp/space_in_material_name.obj": 64,
    "crafted/cube_duplicate_coplanar_faces.obj": 24,
    "crafted/cube_far_from_origin.obj": 12,
    "crafted/cube_inf_vertex.obj": 12,
    "crafted/cube_mixed_winding.obj": 12,
    "crafted/cube_nan_vertex.obj": 12,
    "crafted/cube_with_degenerate_faces.obj": 12,
    "crafted/cube_zero_area_collinear.obj": 15,
    "crafted/external_uri.gltf": "never opened",
    "crafted/huge_1e9.obj": 12,
    "crafted/missing_texture.obj": 1,
    "crafted/moebius_nonorientable.obj": 120,
    "crafted/nonmanifold_fan.obj": 6,
    "crafted/path_traversal.obj": 1,
    "crafted/ply_lying_count.ply": "4000000000",
    "crafted/slivers.obj": 500,
    "crafted/stacked_same_centroid.obj": 2000,
    "crafted/stl_lying_count.stl": "4000000000",
    "crafted/tiny_1e-6.obj": 12,
    "crafted/unreferenced_and_isolated.obj": 12,
    "crafted/usemtl_without_mtllib.obj": 1,
    "trimesh/busted.STL": 3878,
    "trimesh/empty.obj": "empty",
    "trimesh/empty.stl": "empty",
    "trimesh/nancolor.obj": 12,
    "trimesh/negative_indices.obj": 12,
    "trimesh/notenoughindices.obj": 1,
    "trimesh/polygonfaces.obj": 3,
    "trimesh/singlevn.obj": 2,
    "trimesh/soup.stl": 100,
    "trimesh/wallhole.obj": 66,
}

_WARNINGS = {
    "crafted/missing_texture.obj": "'does_not_exist.png' is missing",
    "crafted/path_traversal.obj": "never opened",
    "crafted/usemtl_without_mtllib.obj": "'nowhere' is not defined",
    "crafted/cube_nan_vertex.obj": "infinity or NaN",
    "crafted/cube_inf_vertex.obj": "infinity or NaN",
    "assimp/malformed2_missing_material.obj": "fewer than three corners",
    "trimesh/nancolor.obj": "colours are not finite",
}

# Far below the limits of the service: a file that needed more would be one that the table did not foresee. They are
# loaded by one process: one that ended it would take the errors of all after it along.
_LIMITS = DEFAULT_LIMITS._replace(memory_bytes=1 << 30, cpu_s=20, wall_s=120.0)


@pytest.fixture(scope="module")
def loaded():
    folder = data_folder("models/pathological")
    begin = time.monotonic()
    requests = [LoadRequest("mesh", folder / name, name.rpartition("/")[2]) for name in sorted(_EXPECTED)]
    results = dict(zip(sorted(_EXPECTED), load_guarded(requests, _LIMITS), strict=True))
    assert time.monotonic() - begin < 120
    return results


def test_the_list_is_complete():
    folder = data_folder("models/pathological")
    suffixes = {".obj", ".ply", ".stl", ".glb", ".gltf", ".off"}
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.suffix.lower() in suffixes}
    assert found == set(_EXPECTED)
    assert len(found) == 41


@pytest.mark.parametrize("name", sorted(_EXPECTED))
def test_pathological(loaded, name):
    expected, result = _EXPECTED[name], loaded[name]
    if isinstance(expected, str):
        assert isinstance(result, LoadError), "should have been refused"
        assert result.file == name.rpartition("/")[2]
        assert expected in result.reason
        assert result.mend
        assert str(DATA) not in str(result)
        return
    assert isinstance(result, MeshData), f"should have been loaded: {result}"
    mesh = result
    assert len(mesh.faces) == expected
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.positions)
    assert np.isfinite(mesh.positions).all()
    assert np.abs(mesh.positions).max() <= 1e30
    for flag, values in ((FACE_HAS_NORMALS, mesh.normals), (FACE_HAS_UVS, mesh.uvs), (FACE_HAS_COLORS, mesh.colors)):
        chosen = (mesh.face_flags & flag).astype(bool)
        assert not chosen.any() or np.isfinite(values[mesh.faces[chosen]]).all()
    assert mesh.face_group.min() >= 0
    assert mesh.face_group.max() < len(mesh.groups)
    if name in _WARNINGS:
        assert any(_WARNINGS[name] in text for text in mesh.warnings)


def test_broken_vertices_do_not_poison_the_bounds(loaded):
    for name in ("cube_nan_vertex.obj", "cube_inf_vertex.obj", "unreferenced_and_isolated.obj"):
        mesh = loaded[f"crafted/{name}"]
        corners = mesh.positions[mesh.faces].reshape(-1, 3)
        assert corners.min(axis=0).tolist() == [-1, -1, -1]
        assert corners.max(axis=0).tolist() == [1, 1, 1]
