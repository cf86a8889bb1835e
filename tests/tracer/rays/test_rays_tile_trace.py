"""A tile's rays find together what each finds alone, and travel alone where they should."""

import numpy as np
import pytest
from test_paths import answers, bumpy

from tracer.rays import RayCaster
from tracer.rays.caster import checked_rays
from tracer.rays.rows import AXIS, PRIMITIVE, ROW, T_BEST
from tracer.rays.single import trace_single
from tracer.rays.tile import TILE_BYTES, UNIT_T, prepare_tile, start_tile
from tracer.rays.tile_trace import trace_tile

PLENTY = 10**9
ALL = 2**64 - 1


class Tile:
    """64 rays in a tile's memory."""

    def __init__(self, rays):
        self.memory = np.zeros(TILE_BYTES + 64, np.uint8)
        self.address = (self.memory.ctypes.data + 63) & ~63
        prepare_tile(self.address)
        self.usable = start_tile(self.address, rays.packed, 0, 0, 4) & ALL

    def row(self, offset, kind=np.float64):
        first = self.address - self.memory.ctypes.data + offset
        return self.memory[first : first + ROW].view(kind)


def towards(target, spread, rng, origin=(0.0, 0.1, 0.2)):
    """64 rays from one point to the neighbourhood of another."""
    directions = np.array(target) - origin + rng.normal(size=(64, 3)) * spread
    return np.broadcast_to(np.array(origin), (64, 3)).copy(), directions


def as_signed(bits):
    return np.array([bits], np.uint64).view(np.int64)[0]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "target", [(2, 0.3, 0.1), (-2, 0.3, 0.1), (0.2, 2, 0), (0.1, -2, 0.3), (0, 0, 2), (0.1, 0.2, -2)]
)
def test_each_axis_and_sense(dtype, target):
    vertices, faces = bumpy(24, dtype)
    caster = RayCaster(vertices, faces)
    rng = np.random.default_rng(1)
    t_min, t_max = rng.choice([0.0, 0.9], 64), rng.choice([np.inf, 1.0], 64)
    rays = checked_rays(*towards(target, 0.05, rng), t_min, t_max)
    t, primitive, _u, _v, met, _count = answers(trace_single, caster, rays)
    tile = Tile(rays)
    assert tile.usable == ALL
    assert len(set(tile.row(AXIS, np.int64))) == 1
    hit, alone = trace_tile(caster.bvh.buffer.ctypes.data, tile.address, as_signed(ALL), 0, PLENTY)
    assert alone == 0
    assert [(hit >> k) & 1 for k in range(64)] == met.tolist()
    assert 0 < met.sum() < 64
    _, alone = trace_tile(caster.bvh.buffer.ctypes.data, tile.address, as_signed(ALL), 1, PLENTY)
    assert alone == 0
    np.testing.assert_array_equal(tile.row(PRIMITIVE, np.int64), primitive)
    found = primitive >= 0
    np.testing.assert_array_equal((tile.row(T_BEST) * tile.row(UNIT_T))[found], t[found])


def test_rays_that_are_not_asked_for_are_left_alone():
    vertices, faces = bumpy(12)
    caster = RayCaster(vertices, faces)
    rays = checked_rays(*towards((2, 0.3, 0.1), 0.05, np.random.default_rng(2)), 0.0, np.inf)
    tile = Tile(rays)
    some = 0x00F0_1234_0000_8001
    _, alone = trace_tile(caster.bvh.buffer.ctypes.data, tile.address, some, 1, PLENTY)
    asked = np.array([(some >> k) & 1 for k in range(64)], bool)
    assert alone == 0
    np.testing.assert_array_equal(tile.row(PRIMITIVE, np.int64) >= 0, asked)


@pytest.mark.parametrize("closest", [0, 1])
def test_given_up_after_too_much_work(closest):
    """What has met something by then has its answer where only that is asked for; the others travel alone."""
    vertices, faces = bumpy(80)
    caster = RayCaster(vertices, faces)
    rays = checked_rays(*towards((2, 0.3, 0.1), 0.3, np.random.default_rng(3)), 0.0, np.inf)
    met, alone = trace_tile(caster.bvh.buffer.ctypes.data, Tile(rays).address, as_signed(ALL), closest, 150)
    assert alone != 0
    assert met & alone == 0
    assert (met | alone) & ALL == ALL


def test_too_far_away_for_float32():
    vertices, faces = bumpy(12)
    caster = RayCaster(vertices, faces)
    origins, directions = towards((0, 0, 0), 0.1, np.random.default_rng(4), (1000.0, 1.0, 1.0))
    tile = Tile(checked_rays(origins, directions, 0.0, np.inf))
    assert trace_tile(caster.bvh.buffer.ctypes.data, tile.address, as_signed(ALL), 1, PLENTY) == (0, -1)


def test_an_empty_tree():
    caster = RayCaster(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    tile = Tile(checked_rays(*towards((2, 0.3, 0.1), 0.05, np.random.default_rng(5)), 0.0, np.inf))
    assert trace_tile(caster.bvh.buffer.ctypes.data, tile.address, as_signed(ALL), 1, PLENTY) == (0, 0)
