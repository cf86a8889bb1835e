"""OBJ and MTL: what every exporter writes, and what some of them should not."""

import numpy as np
import pytest
from loader_files import model_file, png_bytes

from tracer.loaders.errors import LoadError
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.obj import load_obj
from tracer.loaders.polygon import triangulate
from tracer.types import FACE_HAS_NORMALS, FACE_HAS_UVS

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _load(tmp_path, text, companions=None, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.obj", text, companions, limits)
    return load_obj(file, file.read())


def _area(mesh):
    a, b, c = (mesh.positions[mesh.faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


def test_groups_objects_materials(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red paint\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    mesh = _load(
        tmp_path,
        f"mtllib a.mtl\n{_SQUARE}o Car\ng Door\nusemtl red paint\nf 1 2 3\ng Roof\nusemtl blue\nf 1 3 4\n"
        "g Door\nusemtl red paint\nf 1 2 4\n",
    )
    assert [group.names for group in mesh.groups] == [("Door", "Car", "red paint"), ("Roof", "Car", "blue")]
    assert mesh.face_group.tolist() == [0, 1, 0]
    assert [mesh.materials[group.material].kd for group in mesh.groups] == [(1, 0, 0), (0, 0, 1)]
    assert mesh.warnings == ()


def test_corners_with_the_same_three_indices_are_one_vertex(tmp_path):
    mesh = _load(
        tmp_path,
        _SQUARE + "vt 0 0\nvt 1 1\nvn 0 0 1\nvn 0 0 3\nf 1/1/1 2/1/1 3/1/1\nf 1/1/1 3/1/1 4/1/2\nf 1/2/1 2/1/1 3/1/1\n",
    )
    assert len(mesh.positions) == 5  # 1/1/1 is shared, 1/2/1 is one of its own
    assert np.array_equal(mesh.positions[mesh.faces][1], [[0, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert mesh.uvs[mesh.faces][2, 0].tolist() == [1, 1]
    assert mesh.normals[mesh.faces][1, 2].tolist() == [0, 0, 3]  # its length is kept
    assert (mesh.face_flags == FACE_HAS_NORMALS | FACE_HAS_UVS).all()


@pytest.mark.parametrize(
    ("line", "flags"),
    [
        ("f 1 2 3", 0),
        ("f 1/1 2/1 3/1", FACE_HAS_UVS),
        ("f 1//1 2//1 3//1", FACE_HAS_NORMALS),
        ("f 1/1/1 2/1/1 3/1/1", FACE_HAS_NORMALS | FACE_HAS_UVS),
        ("f 1// 2// 3//", 0),
        ("f 1/1/ 2/1/ 3/1/", FACE_HAS_UVS),
        ("f -4//-1 2//1 3//1", FACE_HAS_NORMALS),
        ("f 1 2/1 3/1/1", 0),
        ("f\t1   2 3  # comment", 0),
        ("f 1 2 \\\n3", 0),
    ],
)
def test_forms_of_a_face_line(tmp_path, line, flags):
    # A second face of another form checks that forms do not mix.
    mesh = _load(tmp_path, _SQUARE + f"vt 0 0\nvn 0 0 1\n{line}\nf 1/1/1 3/1/1 4/1/1\n")
    assert len(mesh.faces) == 2
    assert mesh.positions[mesh.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert mesh.face_flags.tolist() == [flags, FACE_HAS_NORMALS | FACE_HAS_UVS]
    assert mesh.warnings == ()


def test_relative_indices_count_from_their_line(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n")
    assert mesh.positions[mesh.faces][:, 0, 0].tolist() == [0, 5]


@pytest.mark.parametrize(
    ("face", "vertex"), [("f 1 2 9", 9), ("f 0 1 2", 0), ("f -9 1 2", 0), ("f 1/1 2/1 99999999999/1", 99999999999)]
)
def test_positions_that_are_not_there(tmp_path, face, vertex):
    with pytest.raises(LoadError, match=f"a.obj: line 5: a face uses vertex {vertex}, and there are 4"):
        _load(tmp_path, _SQUARE + face)


def test_uvs_and_normals_that_are_not_there_are_left_out(tmp_path):
    mesh = _load(tmp_path, _SQUARE + "vt 0 0\nf 1/1 2/1 3/7\nf 1/1 3/1 4/1\nf 1//5 3//5 4//5\n")
    assert sorted(mesh.face_flags.tolist()) == [0, 0, FACE_HAS_UVS]
    assert any("texture coordinates that are not there" in text for text in mesh.warnings)
    assert any("normals that are not there" in text for text in mesh.warnings)


def test_concave_polygons_are_not_fanned_blindly(tmp_path):
    arrow = [(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)]  # corner 4 points inwards; a fan from corner 1 covers too much
    text = "".join(f"v {x} {y} 0\n" for x, y in arrow)
    mesh = _load(tmp_path, text + "f 1 2 3 4 5\nf 3 4 5 1 2\nf 5 4 3 2 1\n")
    areas = _area(mesh)[:, 2]
    assert len(areas) == 9
    assert areas[:6].min() > 0  # counter-clockwise, as the polygons are
    assert areas[6:].max() < 0
    assert np.allclose([areas[:3].sum(), areas[3:6].sum(), areas[6:].sum()], [10, 10, -10])


def test_concave_quads(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\n" + "".join(f"f {q}\n" for q in ("1 2 3 4", "2 3 4 1")))
    assert np.allclose(_area(mesh)[:, 2].reshape(2, 2).sum(axis=1), 4)
    assert (_area(mesh)[:, 2] > 0).all()


def test_bent_and_empty_polygons_keep_all_corners():
    bent = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1], [0, 1, -1.0]])
    assert len(triangulate(bent)) == 3
    assert triangulate(np.zeros((5, 3))) == [(0, 1, 2), (0, 2, 3), (0, 3, 4)]
    assert len(triangulate(np.array([[0, 0, 0], [1, 0, 0], [np.nan, 0, 0], [0, 1, 0.0]]))) == 2


def test_material_statements(tmp_path):
    (tmp_path / "a.mtl").write_text(
        "newmtl glass # the windows\nKa 1 1 1\nKd 0.1 0.2 0.3 # a comment\nKs 0.5\nNs 250\nKe 0 0 2\nNi 1.5\nd 0.25\n"
        "illum 2\nKd broken\nnewmtl old\nTr 0.75\n"
    )
    mesh = _load(tmp_path, "mtllib a.mtl\n" + _SQUARE + "usemtl glass\nf 1 2 3\nusemtl old\nf 1 3 4\n")
    glass, old = mesh.materials
    assert (glass.kd, glass.ks, glass.ke) == ((0.1, 0.2, 0.3), (0.5, 0.5, 0.5), (0, 0, 2))
    assert (glass.exponent, glass.eta, glass.opacity) == (250, 1.5, 0.25)
    assert old.opacity == 0.25
    assert mesh.warnings == (
        "material 'glass # the windows': kd 'broken' is not made of numbers and is passed over",
    ) or ("kd 'broken'" in mesh.warnings[0])


def test_textures(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "the wood.png").write_bytes(png_bytes(3, 2))
    (tmp_path / "a.mtl").write_text(
        "newmtl a\nmap_Kd maps/the wood.png\nnewmtl b\nmap_Kd -clamp on -s 1 1 1 -bm 2 maps\\the wood.png\n"
        "newmtl c\nmap_Kd gone.png\nnewmtl d\nmap_Kd a.mtl\n"
    )
    faces = "".join(f"usemtl {name}\nf 1 2 3\n" for name in "abcd")
    mesh = _load(tmp_path, "mtllib a.mtl\n" + _SQUARE + faces)
    assert [image.shape for image in mesh.images] == [(2, 3, 3), (2, 3, 3)]
    assert [material.image for material in mesh.materials] == [0, 1, -1, -1]
    assert [material.wrap for material in mesh.materials] == ["repeat", "clamp", "repeat", "repeat"]
    assert mesh.images[0][0, 0].tolist() == [255, 0, 0]
    assert any("'gone.png' is missing" in text and "'c'" in text for text in mesh.warnings)
    assert any("is not an image" in text and "'d'" in text for text in mesh.warnings)


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png",
        "%2e%2e/secret.png",
        "/etc/hostname",
        "..\\secret.png",
        "file:///etc/hostname",
        "http://x/y.png",
        "C:\\x.png",
    ],
)
def test_nothing_outside_the_folder_is_opened(tmp_path, name):
    (tmp_path / "secret.png").write_bytes(png_bytes())
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "a.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    mesh = _load(folder, "mtllib a.mtl\n" + _SQUARE + "usemtl m\nf 1 2 3\n")
    assert mesh.images == ()
    assert any("never opened" in text for text in mesh.warnings)


def test_with_a_list_of_companions_nothing_else_is_opened(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\nmap_Kd t.png\n")
    (tmp_path / "t.png").write_bytes(png_bytes())
    text = "mtllib a.mtl\n" + _SQUARE + "usemtl m\nf 1 2 3\n"
    assert len(_load(tmp_path, text, ["a.mtl", "t.png"]).images) == 1
    assert len(_load(tmp_path, text, ["./a.mtl"]).images) == 0
    assert len(_load(tmp_path, text, ["a.mtl"]).materials) == 1
    assert len(_load(tmp_path, text, []).materials) == 0


@pytest.mark.parametrize("on_disk", ["50% grey.png", "50%25%20grey.png"])
def test_names_with_percent_signs_decoded_or_as_they_are(tmp_path, on_disk):
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd 50%25%20grey.png\n")
    (tmp_path / on_disk).write_bytes(png_bytes())
    text = "mtllib a.mtl\n" + _SQUARE + "usemtl m\nf 1 2 3\n"
    assert len(_load(tmp_path, text, ["a.mtl", on_disk]).images) == 1
    assert len(_load(tmp_path, text).images) == 1
    assert len(_load(tmp_path, text, ["a.mtl"]).images) == 0


def test_library_names_with_spaces_and_several_libraries(tmp_path):
    (tmp_path / "my lib.mtl").write_text("newmtl a\nKd 1 0 0\n")
    assert len(_load(tmp_path, "mtllib my lib.mtl\n" + _SQUARE + "f 1 2 3\n").materials) == 1
    (tmp_path / "one.mtl").write_text("newmtl a\n")
    (tmp_path / "two.mtl").write_text("newmtl b\n")
    assert len(_load(tmp_path, "mtllib one.mtl two.mtl\n" + _SQUARE + "f 1 2 3\n").materials) == 2


def test_vertex_colours_are_taken_as_srgb(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0 1 0.5 0\nv 1 0 0 1 1 1\nv 0 1 0 nan 0 0\nf 1 2 3\n")
    assert np.allclose(mesh.colors, [[1, 0.21404114, 0], [1, 1, 1], [1, 1, 1]])
    assert "1 vertex colours are not finite" in mesh.warnings[0]
    mesh = _load(tmp_path, "v 0 0 0 255 0 0\nv 1 0 0 128 0 0\nv 0 1 0\nf 1 2 3\n")
    assert np.allclose(mesh.colors[:, 0], [1, 0.21586, 1], atol=1e-5)  # the third has none: white


def test_odd_vertex_lines(tmp_path):
    mesh = _load(tmp_path, "v 0 0 0 1.0\nv 1 0 0\nv 0 1e0 -0.0e-3\nvt 0.5\nvt 1 2 3\nf 1/1 2/2 3/1\n")
    assert mesh.positions[mesh.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.uvs[mesh.faces[0]].tolist() == [[0.5, 0], [1, 2], [0.5, 0]]
    with pytest.raises(LoadError, match="fewer than three numbers"):
        _load(tmp_path, "v 0 0\nf 1 1 1\n")


@pytest.mark.parametrize("text", ["", "# nothing\n", "v 0 0 0\n", "v 0 0 0\nf 1 1 1\n", "v 0 0 0\nv 1 0 0\nl 1 2\n"])
def test_empty_models_are_refused(tmp_path, text):
    with pytest.raises(LoadError, match="empty"):
        _load(tmp_path, text)


def test_more_than_allowed_is_refused(tmp_path):
    limits = DEFAULT_LIMITS._replace(faces=1)
    with pytest.raises(LoadError, match="more than the 1"):
        _load(tmp_path, _SQUARE + "f 1 2 3 4\n", limits=limits)
    with pytest.raises(LoadError, match="more than the 1"):
        _load(tmp_path, _SQUARE + "f 1 2 3\nf 1 3 4\n", limits=limits)
    with pytest.raises(LoadError, match="bytes"):
        _load(tmp_path, _SQUARE, limits=DEFAULT_LIMITS._replace(file_bytes=10))
