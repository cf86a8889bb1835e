"""How an image is cut into tiles.

Job: tile index <-> rectangle and blocks, pure integers.
Invariant: tiles lie on the absolute image grid (multiples of the tile size from the image's top left), and are clipped
to the rendered rectangle; blocks of 16 px lie on the same absolute grid, so a tile is a set of whole blocks and the
bytes of the picture do not depend on the tile size.
See ARCHITECTURE.md, "Three seams".
"""

from typing import Final, NamedTuple

from worker.contract import MAX_TILE_PX, MIN_TILE_PX
from worker.records import JobRecord

SAMPLES_A_TILE: Final = 1 << 20
"""Such a tile takes 0.1 s (plain scenes) to 10 s (deep glass); it costs 3 ms beside its kernel, and a worker that dies
loses one."""

LEAST_TILES: Final = 128
"""Where a picture has as many at 64 px: progress is seen, and the last tile is a small part of two workers' time."""

SMALL_TILE_PX: Final = 64
"""Below this a tile's own cost grows faster than the evenness it buys, so only many samples make tiles smaller."""


class Rect(NamedTuple):
    """Rectangle of pixels; x, y from the image's top left."""

    x: int
    y: int
    width: int
    height: int


class TileGrid(NamedTuple):
    """The tiles of one job, numbered row by row from the top left.

    Attributes
    ----------
    x, y, width, height
        Rectangle that is rendered, px of the whole image.
    tile_size
        Edge of a tile, px, a multiple of 16.
    """

    x: int
    y: int
    width: int
    height: int
    tile_size: int

    @property
    def first_column(self) -> int:
        """Column of the absolute tile grid where the rectangle begins."""
        return self.x // self.tile_size

    @property
    def first_row(self) -> int:
        """Row of the absolute tile grid where the rectangle begins."""
        return self.y // self.tile_size

    @property
    def columns(self) -> int:
        """Number of tiles side by side."""
        return (self.x + self.width - 1) // self.tile_size - self.first_column + 1

    @property
    def rows(self) -> int:
        """Number of tiles on top of each other."""
        return (self.y + self.height - 1) // self.tile_size - self.first_row + 1

    @property
    def n_tiles(self) -> int:
        """Number of tiles."""
        return self.columns * self.rows

    def tile_rect(self, index: int) -> Rect:
        """Return the pixels of tile `index`, clipped to the rendered rectangle, absolute."""
        if not 0 <= index < self.n_tiles:
            raise IndexError(index)
        row, column = divmod(index, self.columns)
        left = max(self.x, (self.first_column + column) * self.tile_size)
        top = max(self.y, (self.first_row + row) * self.tile_size)
        right = min(self.x + self.width, (self.first_column + column + 1) * self.tile_size)
        bottom = min(self.y + self.height, (self.first_row + row + 1) * self.tile_size)
        return Rect(left, top, right - left, bottom - top)


def choose_tile_size(x: int, y: int, width: int, height: int, samples: int) -> int:
    """Return the edge of a tile for a job that does not name one, px.

    The largest power of two, 16 to 512, with at most `SAMPLES_A_TILE` samples a tile and, above 64 px, at least
    `LEAST_TILES` tiles.

    Parameters
    ----------
    x, y, width, height
        Rectangle that is rendered, px.
    samples
        Of a pixel.
    """
    size = MAX_TILE_PX
    while size > MIN_TILE_PX and (
        size * size * samples > SAMPLES_A_TILE
        or (size > SMALL_TILE_PX and TileGrid(x, y, width, height, size).n_tiles < LEAST_TILES)
    ):
        size //= 2
    return size


def grid_of(record: JobRecord) -> TileGrid:
    """Return the grid of a job: a pure function of what was accepted, so every process agrees on it."""
    return TileGrid(record.x, record.y, record.crop_width, record.crop_height, int(record.output["tile_size"]))
