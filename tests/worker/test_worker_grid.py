"""Tiles cover the rendered rectangle exactly once, on the absolute grid."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.grid import LEAST_TILES, SAMPLES_A_TILE, TileGrid, choose_tile_size, grid_of
from worker.records import JobRecord, new_job_id, now

GRIDS = st.builds(
    TileGrid,
    st.integers(0, 130),
    st.integers(0, 130),
    st.integers(1, 140),
    st.integers(1, 140),
    st.sampled_from([16, 32, 48, 64, 96, 256]),
)


@given(GRIDS)
def test_tiles_partition_the_rectangle(grid: TileGrid):
    seen: set[tuple[int, int]] = set()
    for index in range(grid.n_tiles):
        rect = grid.tile_rect(index)
        pixels = {(x, y) for x in range(rect.x, rect.x + rect.width) for y in range(rect.y, rect.y + rect.height)}
        assert pixels
        assert not pixels & seen
        assert len({(x // grid.tile_size, y // grid.tile_size) for x, y in pixels}) == 1
        seen |= pixels
    assert len(seen) == grid.width * grid.height
    assert min(seen) == (grid.x, grid.y)


@given(GRIDS)
def test_rows_come_from_the_top(grid: TileGrid):
    starts = [grid.tile_rect(row * grid.columns).y for row in range(grid.rows)]
    assert starts == sorted(set(starts))


@pytest.mark.parametrize("index", [-1, 4])
def test_no_tile_outside(index: int):
    with pytest.raises(IndexError):
        TileGrid(0, 0, 32, 32, 16).tile_rect(index)


def test_grid_of_a_record():
    record = JobRecord(new_job_id(), "me", now(), None, "0" * 64, 100, 50, 10, 20, 30, 25, 1, {"tile_size": 32}, 50, 4)
    assert grid_of(record) == TileGrid(10, 20, 30, 25, 32)
    assert grid_of(dataclasses.replace(record, output={"tile_size": 16})).n_tiles == 3 * 2


@pytest.mark.parametrize(
    ("width", "height", "samples", "size"),
    [
        (3840, 2160, 16, 256),
        (3840, 2160, 1, 256),
        (1920, 1080, 16, 128),
        (640, 360, 16, 64),
        (64, 64, 1, 64),
        (64, 64, 256, 64),
        (64, 64, 257, 32),
        (64, 64, 65536, 16),
        (20000, 20000, 1, 512),
    ],
)
def test_tile_size_by_the_amount_of_work(width: int, height: int, samples: int, size: int):
    assert choose_tile_size(0, 0, width, height, samples) == size


@given(st.integers(0, 5000), st.integers(0, 5000), st.integers(1, 9000), st.integers(1, 9000), st.integers(1, 65536))
def test_chosen_tiles_are_small_enough_and_many(x: int, y: int, width: int, height: int, samples: int):
    size = choose_tile_size(x, y, width, height, samples)
    assert size in {16, 32, 64, 128, 256, 512}
    assert size == 16 or size * size * samples <= SAMPLES_A_TILE
    assert size <= 64 or TileGrid(x, y, width, height, size).n_tiles >= LEAST_TILES
