"""The loader is chosen by the file's name."""

import pytest
from loader_files import model_file

from tracer.loaders.errors import LoadError
from tracer.loaders.load import load_mesh


def _load(tmp_path, name, content):
    return load_mesh(model_file(tmp_path, name, content))


def test_unknown_kinds_never_reach_trimesh(tmp_path):
    for name in ("a.zip", "a.dae", "a.tar.gz", "a.3mf", "a", "a.obj.exe"):
        with pytest.raises(LoadError, match="unknown kind"):
            _load(tmp_path, name, "x")
