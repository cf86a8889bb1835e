"""Materials of MTL files: statements, textures, libraries."""

from loader_files import model_file, png_bytes

from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.obj import load_obj

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _load(tmp_path, text, companions=None, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.obj", text, companions, limits)
    return load_obj(file, file.read())


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


def test_library_names_with_spaces_and_several_libraries(tmp_path):
    (tmp_path / "my lib.mtl").write_text("newmtl a\nKd 1 0 0\n")
    assert len(_load(tmp_path, "mtllib my lib.mtl\n" + _SQUARE + "f 1 2 3\n").materials) == 1
    (tmp_path / "one.mtl").write_text("newmtl a\n")
    (tmp_path / "two.mtl").write_text("newmtl b\n")
    assert len(_load(tmp_path, "mtllib one.mtl two.mtl\n" + _SQUARE + "f 1 2 3\n").materials) == 2
