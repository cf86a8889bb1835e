"""Polygons cut into triangles, concave, bent and empty ones too."""

import numpy as np
from loader_files import model_file

from tracer.loaders.limits import DEFAULT_LIMITS
from tracer.loaders.obj import load_obj
from tracer.loaders.polygon import triangulate

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _load(tmp_path, text, companions=None, limits=DEFAULT_LIMITS):
    file = model_file(tmp_path, "a.obj", text, companions, limits)
    return load_obj(file, file.read())


def _area(mesh):
    a, b, c = (mesh.positions[mesh.faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


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
