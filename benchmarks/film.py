"""What writing a picture costs: CPU seconds and sizes of EXR and PNG by compression, and of the film writer as a whole.

Usage: ``python -m benchmarks.film PICTURE.exr`` (any linear RGB picture; a 3840 x 2160 one gives the figures that stand
in `tracer/film/writer.py`). CPU seconds of this process, the least of three runs.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from tracer.film.develop import develop_blocks, encode_8bit
from tracer.film.tile import Rect, TileHeader, decode_tile, encode_tile
from tracer.film.writer import BAND_ROWS, FilmWriter, film_sha256
from tracer.types import BLOCK_PX

SIDE = 256  # of a tile of a 3840 x 2160 picture at 16 samples
EXR_COMPRESSIONS = ("none", "zip:1", "zip:4", "zips", "piz", "htj2k256")
PNG_SETTINGS = ((1, 0), (1, 0x10), (1, 0x20), (1, 0x40), (1, 0x80), (3, 0x10), (3, 0), (6, 0x10), (6, 0))
FILTERS = {0: "all", 0x10: "sub", 0x20: "up", 0x40: "average", 0x80: "paeth"}


def main() -> None:
    picture = OpenImageIO.ImageInput.open(sys.argv[1])
    pixels = np.ascontiguousarray(picture.read_image(OpenImageIO.FLOAT)[:, :, :3])
    height, width = pixels.shape[:2]
    print(f"{width} x {height}; OpenImageIO {OpenImageIO.__version__}")
    OpenImageIO.attribute("threads", 1)
    OpenImageIO.attribute("exr_threads", -1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        for compression in EXR_COMPRESSIONS:
            seconds = least(lambda name=compression: write_exr(path / "a.exr", pixels, name))
            print(f"exr {compression:10s} {seconds:6.2f} s  {(path / 'a.exr').stat().st_size / 1e6:6.1f} MB")
        encoded = encode_8bit(pixels, "srgb")
        for level, chosen in PNG_SETTINGS:
            seconds = least(lambda a=level, b=chosen: write_png(path / "a.png", encoded, a, b))
            size = (path / "a.png").stat().st_size / 1e6
            print(f"png level {level} filter {FILTERS[chosen]:8s} {seconds:6.2f} s  {size:6.1f} MB")
        print(f"sRGB table {least(lambda: encode_bands(pixels)):6.2f} s")
        print(f"film hash  {least(lambda: film_sha256(pixels)):6.2f} s")
        print(f"FilmWriter {least(lambda: write_both(path, pixels)):6.2f} s")
        small = np.zeros((64, 64, 3), np.float32)
        print(f"FilmWriter, 64 x 64 {1e3 * least(lambda: write_both(path, small), 20):.1f} ms")
    header = TileHeader(Rect(0, 0, SIDE, SIDE), (0, 16), {"samples": 16 * SIDE * SIDE})
    values = np.random.default_rng(0).random((SIDE, SIDE, 3), np.float32)
    blocks = np.random.default_rng(0).random(((SIDE // BLOCK_PX) ** 2, 2, BLOCK_PX, BLOCK_PX, 3))
    data = encode_tile(header, values)
    print(f"tile of {SIDE} x {SIDE}: develop", end=" ")
    print(f"{1e3 * least(lambda: develop_blocks(header.rect, blocks, 16), 50):.2f} ms, encode", end=" ")
    print(f"{1e3 * least(lambda: encode_tile(header, values), 50):.2f} ms,", end=" ")
    print(f"decode {1e3 * least(lambda: decode_tile(data), 50):.2f} ms, {len(data)} bytes")


def least(run: Callable[[], object], times: int = 3) -> float:
    """Return the least CPU seconds of some runs."""
    seconds = []
    for _ in range(times):
        begin = time.process_time()
        run()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def write_exr(path: Path, pixels: NDArray[np.float32], compression: str) -> None:
    height, width = pixels.shape[:2]
    spec = OpenImageIO.ImageSpec(width, height, 3, OpenImageIO.FLOAT)
    spec.tile_width, spec.tile_height, spec.tile_depth = BAND_ROWS, BAND_ROWS, 1
    spec.attribute("compression", compression)
    output = OpenImageIO.ImageOutput.create("exr")
    output.open(str(path), spec)
    for y in range(0, height, BAND_ROWS):
        output.write_tiles(0, width, y, min(y + BAND_ROWS, height), 0, 1, pixels[y : y + BAND_ROWS])
    output.close()


def write_png(path: Path, pixels: NDArray[np.uint8], level: int, chosen: int) -> None:
    height, width = pixels.shape[:2]
    spec = OpenImageIO.ImageSpec(width, height, 3, OpenImageIO.UINT8)
    spec.attribute("png:compressionLevel", level)
    spec.attribute("png:filter", chosen)
    output = OpenImageIO.ImageOutput.create("png")
    output.open(str(path), spec)
    for y in range(0, height, BAND_ROWS):
        output.write_scanlines(y, min(y + BAND_ROWS, height), 0, pixels[y : y + BAND_ROWS])
    output.close()


def encode_bands(pixels: NDArray[np.float32]) -> None:
    for y in range(0, pixels.shape[0], BAND_ROWS):
        encode_8bit(pixels[y : y + BAND_ROWS], "srgb")


def write_both(folder: Path, pixels: NDArray[np.float32]) -> None:
    height, width = pixels.shape[:2]
    with FilmWriter(folder / "b.exr", folder / "b.png", width, height) as writer:
        for y in range(0, height, 16):
            writer.write_rows(pixels[y : y + 16])
        writer.close()


if __name__ == "__main__":
    main()
