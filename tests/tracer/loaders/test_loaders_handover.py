"""Arrays on their way out of the guarded process: the same on the other side, or an error."""

import numpy as np
import pytest
from loader_files import model_file, png_bytes

from tracer.arrayfile import ArrayFileError, save_arrays
from tracer.loaders.handover import open_image, open_mesh, save_image, save_mesh
from tracer.loaders.obj import load_obj

_OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.fixture
def mesh(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\nmap_Kd t.png\nmap_Kd gone.png\n")
    (tmp_path / "t.png").write_bytes(png_bytes())
    file = model_file(tmp_path, "a.obj", _OBJ + "vt 0 0\nvn 0 0 1\ng Door\nusemtl m\nf 1/1/1 2/1/1 3/1/1\n")
    return load_obj(file, file.read())


def test_a_mesh_is_the_same_on_the_other_side(tmp_path, mesh):
    save_mesh(tmp_path / "mesh.arrays", mesh)
    there = open_mesh(tmp_path / "mesh.arrays")
    for name in ("positions", "faces", "normals", "uvs", "face_flags", "face_group"):
        assert np.array_equal(getattr(there, name), getattr(mesh, name)), name
        assert getattr(there, name).dtype == getattr(mesh, name).dtype, name
    assert there.colors is None
    assert (there.groups, there.materials, there.warnings) == (mesh.groups, mesh.materials, mesh.warnings)
    assert [image.tolist() for image in there.images] == [image.tolist() for image in mesh.images]


def test_an_image_is_the_same_on_the_other_side(tmp_path):
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    save_image(tmp_path / "image.arrays", image)
    assert np.array_equal(open_image(tmp_path / "image.arrays"), image)


def test_what_is_cut_or_of_another_kind_is_an_error(tmp_path, mesh):
    path = tmp_path / "mesh.arrays"
    save_mesh(path, mesh)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ArrayFileError):
        open_mesh(path)
    save_arrays(path, {"positions": mesh.positions}, {}, durable=False)
    with pytest.raises(ArrayFileError, match="is not a mesh"):
        open_mesh(path)
