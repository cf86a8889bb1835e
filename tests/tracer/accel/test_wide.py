"""The wide tree's structure: every triangle in one leaf, boxes that contain, bounded depth, files, errors."""

import numpy as np
import pytest

from tests.numerics.closed_meshes import mix
from tracer.accel import layout
from tracer.accel.emit import ORDER_BITS, ORDERS
from tracer.accel.wide import BvhError, build_wide, geometry_key, load_wide


def grid(n, dtype=np.float64):
    """A wavy square of 2 n n triangles."""
    x, y = np.meshgrid(np.linspace(-3, 5, n + 1), np.linspace(0, 7, n + 1), indexing="ij")
    vertices = np.stack([x, y, np.sin(3 * x) * np.cos(2 * y)], -1).reshape(-1, 3).astype(dtype)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    a = (i * (n + 1) + j).ravel()
    faces = [np.stack([a, a + 1, a + n + 1], -1), np.stack([a + 1, a + n + 2, a + n + 1], -1)]
    return vertices, np.concatenate(faces)


def walk(tree):
    """Yield (box, leaf ids, leaf orders, leaf vertices (n, 3, 3), depth) of every leaf, checking boxes on the way."""
    raw = tree.buffer.view(np.uint8)
    wide = bool(tree.buffer[layout.HEADER_WIDE_LEAVES])
    kind, size = (np.float64, 8) if wide else (np.float32, 4)
    todo = [(layout.HEADER_BYTES, None, 1)]
    n_nodes = 0
    while todo:
        offset, around, depth = todo.pop()
        n_nodes += 1
        assert offset % 64 == 0
        rows = raw[offset : offset + 192].view(np.float32).reshape(6, 8)
        words = raw[offset + 192 : offset + 224].view(np.int32)
        for k in range(8):
            low, high = rows[:3, k], rows[3:, k]
            if low[0] > high[0]:
                assert words[k] == 0
                continue
            if around is not None:
                assert (low >= around[0]).all()
                assert (high <= around[1]).all()
            word = int(words[k])
            place = ((word & 0x7FFFFFFF) >> 3) * layout.UNIT
            if word >= 0:
                todo.append((place, (low, high), depth + 1))
                continue
            n = (word & 7) + 1
            values = raw[place : place + 9 * n * size].view(kind).reshape(3, 3, n).transpose(2, 0, 1)
            ids = raw[place + 9 * n * size :][: 4 * n].view(np.int32)
            yield (low, high), ids >> ORDER_BITS, ids & 7, values, depth
    assert n_nodes == tree.n_nodes


def check(tree, vertices, faces):
    floats = tree.buffer.view(np.float64)
    centre = floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3]
    scale = floats[layout.FRAME_SCALE]
    assert np.log2(scale) == np.round(np.log2(scale))
    seen, deepest = [], 0
    for (low, high), ids, orders, values, depth in walk(tree):
        deepest = max(deepest, depth)
        seen += ids.tolist()
        framed = (values.astype(np.float64) - centre) * scale
        assert (framed.min((0, 1)) >= low).all()
        assert (framed.max((0, 1)) <= high).all()
        for face, order, triangle in zip(ids, orders, values, strict=True):
            given = vertices[faces[face]]
            np.testing.assert_array_equal(given[list(ORDERS[order])], triangle)
            assert [tuple(v) for v in triangle] == sorted(tuple(v) for v in given)
    assert sorted(seen) == list(range(len(faces)))
    assert deepest == tree.depth <= layout.MAX_DEPTH


@pytest.mark.parametrize("n", [1, 2, 3, 9, 60, 130])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_structure(n, dtype):
    vertices, faces = grid(n, dtype)
    tree = build_wide(vertices, faces)
    assert bool(tree.buffer[layout.HEADER_WIDE_LEAVES]) == (dtype == np.float64)
    check(tree, vertices, faces)
    if n > 50:
        assert tree.n_bytes < 100 * len(faces)


def test_mixes_of_fine_and_coarse_meshes():
    """Groups of very different size, joined at the top: no triangle is lost there, and none stands in two leaves."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        vertices, faces = mix(rng)
        ids = np.concatenate([ids for _, ids, *_ in walk(build_wide(vertices, faces))])
        np.testing.assert_array_equal(np.sort(ids), np.arange(len(faces)))


def test_float64_vertices_that_float32_holds_take_little_room():
    vertices, faces = grid(60, np.float32)
    narrow = build_wide(vertices, faces)
    same = build_wide(vertices.astype(np.float64), faces.astype(np.uint8) if len(vertices) < 256 else faces)
    np.testing.assert_array_equal(narrow.buffer, same.buffer)
    assert narrow.n_bytes < 60 * len(faces)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_the_tree(threads):
    """Of three shares of the work one thread gets what is left over; some faces are left out."""
    vertices, faces = grid(130)
    vertices[[7, 4000]] = np.nan, np.inf, 0.0
    one = build_wide(vertices, faces)
    np.testing.assert_array_equal(one.buffer, build_wide(vertices, faces, threads=threads).buffer)


def test_identical_triangles():
    """N16: equal centroids leave nothing to split by; the depth stays bounded."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.tile([[0, 1, 2]], (100_000, 1))
    tree = build_wide(vertices, faces)
    assert tree.depth <= 20
    assert tree.n_triangles == 100_000


@pytest.mark.parametrize("copies", [40, 200])
def test_depth_is_bounded_where_sah_peels(copies):
    """Triangles shrinking geometrically towards a corner: SAH takes them off one by one.

    With 200 copies the mesh is large, and more subtrees come off at the top than are kept for threads.
    """
    size = 0.5 ** np.arange(140.0)
    vertices = (np.eye(3)[None] * size[:, None, None] + size[:, None, None]).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    repeated = np.concatenate([faces] * copies)
    tree = build_wide(vertices, repeated)
    assert tree.depth <= layout.MAX_DEPTH
    check(tree, vertices, repeated)


def test_saved_and_mapped(tmp_path):
    vertices, faces = grid(30)
    tree = build_wide(vertices, faces)
    tree.save(tmp_path / "tree.bvh")
    mapped = load_wide(tmp_path / "tree.bvh")
    np.testing.assert_array_equal(mapped.buffer, tree.buffer)
    check(mapped, vertices, faces)


@pytest.mark.parametrize("damage", ["magic", "version", "short", "empty"])
def test_damaged_files_are_refused(tmp_path, damage):
    words = build_wide(*grid(3)).buffer.copy()
    if damage == "magic":
        words[layout.HEADER_MAGIC] += 1
    elif damage == "version":
        words[layout.HEADER_VERSION] += 1
    elif damage == "short":
        words = words[:-1]
    else:
        words = words[:0]
    words.tofile(tmp_path / "tree.bvh")
    with pytest.raises(BvhError, match=r"tree\.bvh"):
        load_wide(tmp_path / "tree.bvh")


def test_geometry_key():
    vertices, faces = grid(3)
    key = geometry_key(vertices, faces)
    assert key == geometry_key(vertices.copy(), faces.copy())
    moved = vertices.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], 9)
    assert len({key, geometry_key(moved, faces), geometry_key(vertices, faces[::-1])}) == 3


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), np.zeros((1, 3), int), r"vertices: shape \(3, 2\)"),
        (np.zeros((3, 3)), np.zeros((1, 4), int), r"faces: shape \(1, 4\)"),
        (np.zeros((3, 3)), np.zeros((1, 3)), "faces: dtype float64"),
        (np.zeros((3, 3)), np.array([[0, 1, 3]]), "vertex 3 is not one of 0 .. 2"),
        (np.zeros((3, 3)), np.array([[0, -1, 2]]), "vertex -1 is not one of 0 .. 2"),
    ],
)
def test_what_cannot_be_built(vertices, faces, message):
    with pytest.raises(BvhError, match=message):
        build_wide(vertices, faces)
