"""The table of few triangles: planes, lines and pairs as its module says, read back with numpy."""

import numpy as np
import pytest
from test_rays_brute import BOX, CORNERS, TURN

from tracer.accel import layout
from tracer.accel.wide import build_wide
from tracer.rays.brute_table import FEW, PAIRS, PLANES, RECORD_BYTES, RECORDS, SINGLES, tabulate


def parts(vertices, faces):
    """(pairs, singles; planes; records along z) of a mesh's table, and its corners in the frame, by slot."""
    bvh = build_wide(vertices, faces)
    memory = tabulate(bvh).view(np.uint8)
    assert memory.ctypes.data % 64 == 0
    pairs, singles = (memory[at : at + 24].view(np.int64) for at in (PAIRS, SINGLES))
    planes = memory[PLANES:RECORDS].view(np.float32).reshape(FEW, 10)[: (pairs + singles).sum()].astype(float)
    records = memory[RECORDS:].view(np.float64).reshape(3, FEW, RECORD_BYTES // 8)[2, : (2 * pairs + singles).sum()]
    floats = bvh.buffer.view(np.float64)
    centre, scale = floats[layout.FRAME_CENTRE : layout.FRAME_CENTRE + 3], floats[layout.FRAME_SCALE]
    return pairs, singles, planes, records, (records[:, :9].reshape(-1, 3, 3) - centre) * scale


def slots_of(pairs, singles):
    """(axis, slots) of each plane, in order."""
    slot = 0
    for axis in range(3):
        for size in [2] * pairs[axis] + [1] * singles[axis]:
            yield axis, list(range(slot, slot + size))
            slot += size


def rows_of(rng, kind):
    if kind == "box":
        return CORNERS, BOX
    if kind == "turned":
        return CORNERS @ TURN + 7.0, BOX
    loose = rng.normal(size=(20, 3, 3))
    if kind == "slivers":
        loose[:, 2] = (
            loose[:, 0] + (loose[:, 1] - loose[:, 0]) * 0.4 + rng.normal(size=(20, 3)) * 10.0 ** -np.arange(20)[:, None]
        )
        loose[5] = loose[5, 0]
    return loose.reshape(-1, 3), np.arange(60).reshape(20, 3)


@pytest.mark.parametrize("kind", ["box", "turned", "loose", "slivers"])
def test_planes_and_lines(kind):
    """Corners lie in the plane, and inside by the lines; a point beyond an edge does not."""
    pairs, singles, planes, records, corners = parts(*rows_of(np.random.default_rng(1), kind))
    assert pairs.sum() == (6 if kind in {"box", "turned"} else 0)
    assert sorted(records[:, 9].copy().view(np.int64)) == list(range(len(records)))
    for plane, (axis, slots) in zip(planes, slots_of(pairs, singles), strict=True):
        assert np.abs(plane[:2]).max() <= 1.0
        turned = corners[slots][:, :, [(axis + 1) % 3, (axis + 2) % 3, axis]]
        x, y, z = turned[..., 0], turned[..., 1], turned[..., 2]
        np.testing.assert_allclose(z + plane[0] * x + plane[1] * y + plane[2], 0.0, atol=4e-7)
        u, v = (plane[k] * x + plane[k + 1] * y + plane[k + 2] for k in (3, 6))
        inside = np.stack([u, v, plane[9] - u - v])
        assert inside[:, 0].min() >= -1e-6
        if len(slots) == 2:
            assert np.stack([plane[9] - u, plane[9] - v, u + v - plane[9]])[:, 1].min() >= -1e-6
        size = np.abs(turned[0] - turned[0][[1, 2, 0]]).max()
        if plane[9] > 1e-3 * size:
            middle = turned[0].mean(0)
            for k in range(3):
                x, y, _ = turned[0, k] * 1.3 - middle * 0.3
                u, v = (plane[m] * x + plane[m + 1] * y + plane[m + 2] for m in (3, 6))
                assert min(u, v, plane[9] - u - v) < 0.0


def test_what_is_no_parallelogram_is_no_pair():
    """A kite, a bent quadrilateral and one with a corner that is off by more than rounding."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for off, expected in (([0, 0, 0], 1), ([0, 0, 1e-6], 0), ([1e-6, 0, 0], 0), ([0.5, -0.5, 0], 0), ([0, 0, 1e-9], 1)):
        moved = square.copy()
        moved[3] += off
        assert parts(moved, faces)[0].sum() == expected
    assert parts(square, faces[:1])[0].sum() == 0


def test_nothing():
    pairs, singles, *_ = parts(np.zeros((3, 3)) * np.nan, np.array([[0, 1, 2]]))
    assert pairs.sum() + singles.sum() == 0
