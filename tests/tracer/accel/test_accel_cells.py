"""Records sorted by cells, held against boxes that numpy makes of the same triangles."""

import numpy as np
import pytest

from tracer.accel.sorting import LARGE, sort_mesh


def soup(n, rng, size=0.01):
    """Small triangles on a wavy sheet, and two huge ones that lie among them."""
    places = rng.uniform(-1, 1, (n, 1, 3)) * [[[3.0, 1.0, 2.0]]]
    places[..., 1] = np.sin(places[..., 0])
    triangles = places + rng.normal(size=(n, 3, 3)) * size
    triangles[n // 3] = [[-3, 0.1, -2], [3, 0.1, -2], [3, 0.1, 2]]
    triangles[n // 2] = [[-3, 0.1, -2], [3, 0.1, 2], [-3, 0.1, 2]]
    return triangles.reshape(-1, 3), np.arange(3 * n).reshape(n, 3).astype(np.int32)


def sort(vertices, faces, parts=1):
    return sort_mesh(vertices, faces, parts, map)


def boxes_of(mesh, vertices, ids, faces):
    corners = (vertices[faces[ids]].astype(np.float64) - mesh.frame[:3]) * mesh.frame[3]
    return corners.min(1), corners.max(1)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_records_are_boxes_of_their_faces(kind):
    rng = np.random.default_rng(5)
    vertices, faces = soup(LARGE + 777, rng)
    vertices = vertices.astype(kind)
    faces[-1] = [2, len(vertices) - 1, 0]  # the last vertex, which is read from elsewhere
    mesh, found = sort(vertices, faces)
    ids = found.records.view(np.int32)[:, 3]
    np.testing.assert_array_equal(np.sort(ids), np.arange(len(faces)))
    low, high = boxes_of(mesh, vertices, ids, faces)
    for exact, given in ((low, found.records[:, :3]), (-high, found.records[:, 4:7])):
        assert (given <= exact).all()
        np.testing.assert_allclose(given, exact, rtol=3e-7, atol=1e-38)
    assert (found.records[:, 7] == 0).all()


def test_groups_are_runs_of_records_below_exact_boxes():
    rng = np.random.default_rng(6)
    vertices, faces = soup(LARGE + 5, rng)
    _, found = sort(vertices, faces)
    words = found.nodes.view(np.int32)
    assert len(found.groups) > 20

    def visit(node, depth):
        """Return the rows below a node, checking boxes on the way."""
        if words[node, 7]:
            assert (node, depth) in found.groups
            rows = np.arange(words[node, 3], words[node, 3] + words[node, 7])
            assert (np.diff(found.records.view(np.int32)[rows, 3]) > 0).all()
        else:
            first = words[node, 3]
            assert first > node
            rows = np.concatenate([visit(first, depth + 1), visit(first + 1, depth + 1)])
        some = found.records[rows].min(0)
        np.testing.assert_array_equal(found.nodes[node, [0, 1, 2, 4, 5, 6]], some[[0, 1, 2, 4, 5, 6]])
        return rows

    np.testing.assert_array_equal(np.sort(visit(0, 0)), np.arange(len(faces)))
    largest = max(words[node, 7] for node, _ in found.groups)
    assert largest <= 2 * found.enough


def test_large_triangles_are_kept_apart():
    """Or the box of what they lie among would be as large as they are."""
    rng = np.random.default_rng(7)
    vertices, faces = soup(LARGE, rng)
    _, found = sort(vertices, faces)
    words = found.nodes.view(np.int32)
    ids = found.records.view(np.int32)[:, 3]
    groups = [set(ids[words[g, 3] :][: words[g, 7]].tolist()) for g, _ in found.groups]
    large = {LARGE // 3, LARGE // 2}
    assert all(group <= large for group in groups if group & large)


@pytest.mark.parametrize("broken", [0, 3])
def test_threads_do_not_change_the_order(broken):
    rng = np.random.default_rng(8)
    vertices, faces = soup(LARGE + 99, rng)
    vertices[faces[rng.choice(len(faces), broken)].ravel()] = np.nan
    mesh, one = sort(vertices, faces)
    assert mesh.n_usable == len(faces) - broken
    for parts in (2, 5):
        _, other = sort(vertices, faces, parts)
        np.testing.assert_array_equal(one.records.view(np.int32), other.records.view(np.int32))
        assert one.groups == other.groups
        n = one.n_nodes
        np.testing.assert_array_equal(one.nodes[:n].view(np.int32), other.nodes[:n].view(np.int32))
