"""The compiler: materials by precedence, transforms baked, faults with their place."""

import numpy as np
import pytest
from compile_scenes import TRIANGLE, compiled, document, fake_build, sha256, vertexdata
from PIL import Image

from tracer.loaders.errors import LoadError
from tracer.render.compile import compile_scene
from tracer.scene import SceneError
from tracer.types import (
    FACE_HAS_COLORS,
    FACE_HAS_NORMALS,
    FACE_HAS_UVS,
    FIELDS,
    FILTER_NEAREST,
    FLAG_FILTER,
    FLAG_TEXTURE,
    FLAG_TWO_SIDED,
    FLAG_WRAP,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KT,
    SHAPE_BOX,
    SHAPE_CYLINDER_OPEN,
    SHAPE_DISK,
    SHAPE_SPHERE,
    TEXTURE_HEIGHT,
    TEXTURE_OFFSET,
    TEXTURE_WIDTH,
    WRAP_CLAMP,
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


def test_bad_files_are_errors_with_a_pointer(tmp_path):
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    with pytest.raises(LoadError) as caught:
        compiled(TRIANGLE, {"type": "mesh_asset", "asset": "m"}, assets={"m": {"file": "bad.obj"}}, folder=tmp_path)
    assert caught.value.pointer == "/objects/1/asset"
    assert str(caught.value).startswith("bad.obj: line 2: a face uses vertex 2")
    materials = {"a/b": {"diffuse_texture": {"asset": "m"}}}
    with pytest.raises(LoadError) as caught:
        compiled(
            {**TRIANGLE, "uvs": [[0, 0]] * 3, "material": "a/b"},
            materials=materials,
            assets={"m": {"file": "bad.obj"}},
            folder=tmp_path,
        )
    assert caught.value.pointer == "/materials/a~1b/diffuse_texture/asset"


def test_what_nothing_refers_to_is_never_opened():
    def refuse(ref):
        raise AssertionError(f"{ref.name} was opened")

    scene = document(
        TRIANGLE,
        materials={"unused": {"diffuse_texture": {"asset": "t"}}},
        assets={"t": {"file": "t.png"}, "m": {"file": "m.obj"}},
    )
    compiled_scene, stats = compile_scene(scene, refuse, build=fake_build)
    assert stats.unused_assets == ("m", "t")
    assert len(compiled_scene.materials) == 1  # the default grey alone


def test_a_file_is_loaded_once(tmp_path):
    row = vertexdata(tmp_path)
    opened = []

    def resolve(ref):
        opened.append(ref)
        return tmp_path / ref.file

    scene = document(*[{"type": "mesh_asset", "asset": "m"}] * 3, assets={"m": row})
    compiled_scene, _ = compile_scene(scene, resolve, build=fake_build)
    assert [ref.name for ref in opened] == ["m"]
    assert opened[0].sha256 == row["sha256"]
    assert len(compiled_scene.face_vertices) == 6


def test_textures(tmp_path):
    pixels = np.array([[[0, 128, 255], [255, 0, 0]]], np.uint8)
    Image.fromarray(pixels).save(tmp_path / "t.png")
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "u.png")
    materials = {
        "linear": {"diffuse_texture": {"asset": "t", "color_space": "linear"}},
        "srgb": {"diffuse_texture": {"asset": "t", "wrap": "clamp", "filter": "nearest"}, "two_sided": False},
        "again": {"diffuse_texture": {"asset": "t"}},
        "black": {"diffuse_texture": {"asset": "u"}},
    }
    things = [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": name} for name in materials]
    assets = {"t": {"file": "t.png"}, "u": {"file": "u.png"}}
    scene, stats = compiled(*things, materials=materials, assets=assets, folder=tmp_path)
    assert stats.n_textures == 3  # t twice, once in each colour space
    linear, srgb, again, _ = (scene.material_flags[material] for material in scene.shape_material)
    assert again[FLAG_TEXTURE] == srgb[FLAG_TEXTURE] != linear[FLAG_TEXTURE]
    assert (srgb[FLAG_WRAP], srgb[FLAG_FILTER], srgb[FLAG_TWO_SIDED]) == (WRAP_CLAMP, FILTER_NEAREST, 0)
    texture = scene.textures[srgb[FLAG_TEXTURE]]
    assert texture[[TEXTURE_WIDTH, TEXTURE_HEIGHT]].tolist() == [2, 1]
    texels = scene.texels[texture[TEXTURE_OFFSET] :][:2]
    assert np.allclose(texels, [[0, 0.2158605, 1], [1, 0, 0]])
    texels = scene.texels[scene.textures[linear[FLAG_TEXTURE], TEXTURE_OFFSET] :][:2]
    assert np.allclose(texels, pixels[0] / 255)


def test_materials_of_files(tmp_path):
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl glass\nf 1 2 3\n")
    (tmp_path / "m.mtl").write_text("newmtl glass\nKa 1 1 1\nKd 0.4 0.4 0.4\nNs 50\nd 0.25\nNi 1.5\n")
    scene, _ = compiled({"type": "mesh_asset", "asset": "m"}, assets={"m": {"file": "m.obj"}}, folder=tmp_path)
    row = scene.materials[scene.face_material[0]]
    assert np.allclose(row[MATERIAL_KD : MATERIAL_KD + 3], 0.1)
    assert np.allclose(row[MATERIAL_KA : MATERIAL_KA + 3], 0.1)
    assert np.allclose(row[MATERIAL_KT : MATERIAL_KT + 3], 0.75)
    assert row[MATERIAL_EXPONENT] == 50


def test_companions_without_a_hash_are_not_opened_beside_a_file_with_one(tmp_path):
    data = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
    (tmp_path / "m.obj").write_bytes(data)
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\n")
    rows = {
        "a": ({"file": "m.obj"}, [1, 0, 0]),
        "b": ({"file": "m.obj", "sha256": sha256(data)}, [0.8, 0.8, 0.8]),
        "c": ({"file": "m.obj", "sha256": sha256(data), "companions": {"m.mtl": None}}, [0.8, 0.8, 0.8]),
        "d": ({"file": "m.obj", "sha256": sha256(data), "companions": {"m.mtl": "0" * 64}}, [1, 0, 0]),
    }
    things = [{"type": "mesh_asset", "asset": name} for name in rows]
    scene, _ = compiled(*things, assets={name: row for name, (row, _) in rows.items()}, folder=tmp_path)
    assert [_kd(scene, material) for material in scene.face_material] == [expected for _, expected in rows.values()]


# --- geometry ---------------------------------------------------------------------------------------------------------

_TURN = [
    {"type": "scale", "by": [2, 1, 1]},
    {"type": "rotate", "axis": [0, 0, 1], "angle_deg": 90},
    {"type": "translate", "by": [10, 0, 0]},
]


def test_a_mesh_without_a_transform_keeps_its_bits():
    positions = np.random.default_rng(1).standard_normal((3, 3)).tolist()
    normals = [[0, 0, 3], [0.1, 0, 1], [0, 0, 1e-3]]
    scene, _ = compiled({**TRIANGLE, "positions": positions, "normals": normals})
    assert scene.vertex_positions.tolist() == positions
    assert scene.vertex_normals.tolist() == normals


def test_transforms_are_baked():
    mesh = {**TRIANGLE, "normals": [[1, 1, 0]] * 3, "transform": _TURN}
    scene, _ = compiled(mesh)
    assert np.allclose(scene.vertex_positions, [[10, 0, 0], [10, 2, 0], [9, 0, 0]])
    normal = scene.vertex_normals[0]
    assert np.allclose(normal / np.abs(normal).max(), [-1, 0.5, 0])  # inverse transpose: (1/2, 1, 0), turned
    assert scene.face_vertices.tolist() == [[0, 1, 2]]


def test_mirrored_meshes_keep_their_winding_outward():
    mesh = {**TRIANGLE, "normals": [[0, 0, 1]] * 3, "transform": [{"type": "scale", "by": [-1, 1, 1]}]}
    scene, _ = compiled(mesh)
    a, b, c = scene.vertex_positions[scene.face_vertices[0]]
    assert np.cross(b - a, c - a)[2] > 0
    assert scene.vertex_normals[0, 2] > 0
    mesh["transform"] = [{"type": "scale", "by": [1, 1, -1]}]
    scene, _ = compiled(mesh)
    a, b, c = scene.vertex_positions[scene.face_vertices[0]]
    assert np.cross(b - a, c - a)[2] < 0
    assert scene.vertex_normals[0, 2] < 0


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


@pytest.mark.parametrize(
    ("shape", "kind", "places"),
    [
        # places: local point -> world point
        ({"type": "sphere", "center": [1, 2, 3], "radius": 2}, SHAPE_SPHERE, {(0, 0, 1): (1, 2, 5)}),
        (
            {"type": "box", "min": [0, 0, 0], "max": [2, 4, 6]},
            SHAPE_BOX,
            {(-1, -1, -1): (0, 0, 0), (1, 1, 1): (2, 4, 6)},
        ),
        (
            {"type": "disk", "center": [1, 0, 0], "normal": [0, 5, 0], "radius": 3},
            SHAPE_DISK,
            {(0, 0, 0): (1, 0, 0), (1, 0, 0): (4, 0, 0), (0, 1, 0): (1, 0, -3), (0, 0, 1): (1, 3, 0)},
        ),
        (
            {"type": "cylinder", "start": [0, 0, 1], "end": [0, 0, -3], "radius": 2, "capped": False},
            SHAPE_CYLINDER_OPEN,
            {(0, 0, 0): (0, 0, 1), (0, 0, 1): (0, 0, -3)},
        ),
    ],
)
@pytest.mark.parametrize(
    "transform", [None, _TURN, [{"type": "scale", "by": [-1, 1, 1]}]], ids=["none", "turn", "mirror"]
)
def test_shapes(shape, kind, places, transform):
    scene, _ = compiled({**shape, **({"transform": transform} if transform else {})})
    assert scene.shape_kind.tolist() == [kind]
    for local, world in places.items():
        placed = np.array(world, float)
        if transform == _TURN:
            placed = np.array([10 - placed[1], 2 * placed[0], placed[2]])
        elif transform:
            placed[0] *= -1
        assert np.allclose(scene.shape_origin[0] + scene.shape_to_world[0] @ local, placed)
        assert np.allclose(scene.shape_to_local[0] @ (placed - scene.shape_origin[0]), local)


def test_cylinders_are_round():
    scene, _ = compiled({"type": "cylinder", "start": [0, 1, 0], "end": [1, 2, 3], "radius": 0.5})
    x, y, z = scene.shape_to_world[0].T
    assert np.allclose([x @ y, x @ z, y @ z, x @ x, y @ y, z @ z], [0, 0, 0, 0.25, 0.25, 11])


def test_planes():
    plane = {"type": "plane", "point": [0, 2, 0], "normal": [0, 3, 0]}
    scene, _ = compiled(plane, {**plane, "transform": _TURN})
    assert scene.plane_point.tolist() == [[0, 2, 0], [8, 0, 0]]
    assert np.allclose(scene.plane_normal, [[0, 1, 0], [-1, 0, 0]])
    # A point of the plane keeps its u and v under the transform.
    u_v = scene.plane_uv[0] @ (np.array([3, 2, 5]) - scene.plane_point[0])
    assert np.allclose(u_v, [3, -5])
    assert np.allclose(scene.plane_uv[1] @ (np.array([8, 6, 5]) - scene.plane_point[1]), u_v)


@pytest.mark.parametrize(
    "thing",
    [
        {**TRIANGLE, "positions": [[0, 0, 0], [1e20, 0, 0], [0, 1, 0]]},
        {"type": "sphere", "center": [0, 0, 0], "radius": 1e20},
        {"type": "sphere", "center": [1e20, 0, 0], "radius": 1},
        {"type": "plane", "point": [1e20, 0, 0], "normal": [0, 1, 0]},
    ],
)
def test_leaving_the_range_of_coordinates_is_a_fault(thing):
    with pytest.raises(SceneError) as caught:
        compiled(TRIANGLE, {**thing, "transform": [{"type": "scale", "by": 1e20}]})
    assert caught.value.faults[0].pointer == "/objects/1/transform"


@pytest.mark.parametrize("scales", [[1e-25], [1e25], [1e-25] * 5])
def test_extreme_scales_stay_finite(scales):
    thing = {"type": "cylinder", "start": [0, 1, 0], "end": [1, 2, 3], "radius": 0.5}
    mesh = {**TRIANGLE, "normals": [[0, 0, 1]] * 3}
    transform = [{"type": "scale", "by": scale} for scale in scales]
    scene, _ = compiled({**thing, "transform": transform}, {**mesh, "transform": transform})
    assert np.allclose(scene.shape_to_local[0] @ scene.shape_to_world[0], np.eye(3))
    for array in scene:
        assert array.dtype.kind != "f" or np.isfinite(array).all()
    assert (scene.vertex_normals[:, 2] > 0).all()
