"""Companions: opened in the model's own folder, and nowhere else."""

import pytest
from loader_files import model_file, png_bytes

from tracer.loaders.errors import LoadError
from tracer.loaders.files import ModelFile
from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.obj import load_obj

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _load(tmp_path, text, companions=None, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.obj", text, companions, limits)
    return load_obj(file, file.read())


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


def test_model_files_name_no_path(tmp_path):
    file = ModelFile(tmp_path / "absent.obj", "their name.obj", None, DEFAULT_LIMITS)
    with pytest.raises(LoadError) as caught:
        file.read()
    assert (
        str(caught.value)
        == "their name.obj: cannot be read (No such file or directory); put it there, or name another file"
    )
