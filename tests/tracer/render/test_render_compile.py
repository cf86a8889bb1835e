"""The compiler: materials by precedence, transforms baked, faults with their place."""

import numpy as np
import pytest
from compile_scenes import TRIANGLE, compiled, vertexdata

from tracer.scene import SceneError
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    FIELDS,
    MATERIAL_KD,
    check_layout,
)


def _kd(scene, material):
    return scene.materials[material, MATERIAL_KD : MATERIAL_KD + 3].tolist()


def test_layout_of_an_empty_and_of_a_full_scene(tmp_path):
    check_layout(compiled()[0])
    row = vertexdata(tmp_path)
    scene, stats = compiled(
        TRIANGLE,
        {"type": "mesh_asset", "asset": "m"},
        {"type": "sphere", "center": [0, 0, 0], "radius": 1},
        {"type": "plane", "point": [0, 0, 0], "normal": [0, 1, 0]},
        assets={"m": row, "never": {"file": "gone.obj"}},
        lights=[{"type": "point", "position": [0, 1, 0]}],
        folder=tmp_path,
    )
    check_layout(scene)
    assert set(scene._fields) == set(FIELDS)
    assert (stats.n_triangles, stats.n_vertices, stats.n_shapes, stats.n_planes) == (3, 7, 1, 1)
    assert stats.unused_assets == ("never",)
    assert stats.n_bytes == sum(array.nbytes for array in scene)
    assert scene.face_vertices.tolist() == [[0, 1, 2], [3, 4, 5], [3, 5, 6]]


def test_material_precedence(tmp_path):
    """The group's, then the object's, then the file's own, then grey."""
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
        "g a\nusemtl red\nf 1 2 3\ng b\nusemtl red\nf 1 3 2\ng c\nusemtl unknown\nf 2 3 1\n"
    )
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\n")
    materials = {"blue": {"kd": [0, 0, 1]}, "green": {"kd": [0, 1, 0]}}
    red, green, blue, grey = [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.8, 0.8, 0.8]
    cases = [
        ({}, [red, red, grey]),
        ({"material": "blue"}, [blue, blue, blue]),
        ({"materials": {"b": "green"}}, [red, green, grey]),
        ({"material": "blue", "materials": {"b": "green"}}, [blue, green, blue]),
        ({"materials": {"red": "green"}}, [green, green, grey]),  # by the name of the file's material
        ({"materials": {"red": "green", "a": "blue"}}, [blue, green, grey]),  # the group's name goes first
    ]
    things = [{"type": "mesh_asset", "asset": "m", **more} for more, _ in cases]
    scene, _ = compiled(*things, materials=materials, assets={"m": {"file": "m.obj"}}, folder=tmp_path)
    colors = [_kd(scene, material) for material in scene.face_material]
    assert [colors[index : index + 3] for index in range(0, len(colors), 3)] == [expected for _, expected in cases]


def test_inline_groups():
    mesh = {**TRIANGLE, "faces": [[0, 1, 2]] * 3, "groups": {"top": [1, 2]}, "materials": {"top": "blue"}}
    materials = {"blue": {"kd": [0, 0, 1]}, "green": {"kd": [0, 1, 0]}}
    scene, _ = compiled({**mesh, "material": "green"}, materials=materials)
    assert [_kd(scene, material) for material in scene.face_material] == [[0, 1, 0], [0, 0, 1], [0, 1, 0]]


def test_unknown_groups_of_a_file_are_faults_with_a_pointer(tmp_path):
    row = vertexdata(tmp_path)
    things = [TRIANGLE, {"type": "mesh_asset", "asset": "m", "materials": {"Rof": "x", "a/b": "x", "Body": "x"}}]
    with pytest.raises(SceneError) as caught:
        compiled(*things, materials={"x": {}}, assets={"m": row}, folder=tmp_path)
    faults = {fault.pointer: fault for fault in caught.value.faults}
    assert set(faults) == {"/objects/1/materials/Rof", "/objects/1/materials/a~1b"}
    assert 'did you mean "Roof"' in faults["/objects/1/materials/Rof"].message
    assert faults["/objects/1/materials/Rof"].expected == 'one of "Body", "Roof"'


def test_attributes_are_flagged_by_face():
    full = {**TRIANGLE, "normals": [[0, 0, 1]] * 3, "uvs": [[0, 1]] * 3, "colors": [[1, 0, 0]] * 3}
    scene, _ = compiled(TRIANGLE, full)
    assert scene.face_flags.tolist() == [0, FACE_HAS_NORMALS | FACE_HAS_UVS | FACE_HAS_COLORS]
    assert scene.vertex_colors.tolist() == [[1, 1, 1]] * 3 + [[1, 0, 0]] * 3
    assert scene.vertex_uvs[:3].tolist() == [[0, 0]] * 3


def test_normals_of_the_file_flat_and_smooth(tmp_path):
    # Two faces of a roof that meet in an edge, with vertices of their own: STL has it so.
    roof = [[0, 0, 0], [1, 0, 0], [0, 1, 1], [1, 0, 0], [0, 0, 0], [0, -1, 1]]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in roof) + "vn 0 0 5\nf 1//1 2//1 3//1\nf 4//1 5//1 6//1\n"
    (tmp_path / "m.obj").write_text(text)

    def normals(kind):
        thing = {"type": "mesh_asset", "asset": "m", "normals": kind}
        scene, _ = compiled(thing, assets={"m": {"file": "m.obj"}}, folder=tmp_path)
        return scene.face_flags, scene.vertex_normals[scene.face_vertices]

    flags, values = normals("file")
    assert (flags == FACE_HAS_NORMALS).all()
    assert (values == [0, 0, 5]).all()
    assert (normals("flat")[0] == 0).all()
    flags, values = normals("smooth")
    assert (flags == FACE_HAS_NORMALS).all()
    ridge = values[0, 0] / np.linalg.norm(values[0, 0])
    assert np.allclose(ridge, [0, 0, 1])  # shared by both faces, though the vertices are not
    assert np.allclose(values[1, 1], values[0, 0])
    assert np.allclose(values[0, 2] / np.abs(values[0, 2]).max(), [0, -1, 1])
