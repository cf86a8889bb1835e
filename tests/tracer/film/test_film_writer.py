"""The writer: right pixels, the same bytes however the rows are cut, flat memory, and clear errors."""

import hashlib
import struct
import subprocess
import sys

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from tracer.film.develop import encode_8bit
from tracer.film.errors import ImageWriteError
from tracer.film.writer import FilmWriter, film_sha256

_METADATA = {"smalti:scene_sha256": "ab" * 32, "smalti:seed": "7", "smalti:samples": "16", "Software": "Smalti 0.1"}


def _pixels(height=150, width=100):
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:height, 0:width]
    smooth = np.stack([x / width, y / height, (x + y) / (width + height)], axis=-1)
    return (1.5 * smooth + 0.05 * rng.standard_normal((height, width, 3))).astype(np.float32)


def _write(folder, pixels, cuts, **options):
    folder.mkdir()
    exr, png = folder / "result.exr", folder / "result.png"
    with FilmWriter(exr, png, pixels.shape[1], pixels.shape[0], metadata=_METADATA, **options) as writer:
        for rows in np.split(pixels, cuts):
            writer.write_rows(rows)
        digest = writer.close()
    assert sorted(path.name for path in folder.iterdir()) == ["result.exr", "result.png"]
    return exr, png, digest


def _read_exr(path):
    image = OpenImageIO.ImageInput.open(str(path))
    try:
        return image.spec(), image.read_image(OpenImageIO.FLOAT)
    finally:
        image.close()


def test_pixels_come_back(tmp_path):
    pixels = _pixels()
    exr, png, digest = _write(tmp_path / "a", pixels, [])
    spec, read = _read_exr(exr)
    assert np.array_equal(read, pixels)  # bit for bit, values above 1 and below 0 included
    assert (spec.tile_width, spec.tile_height) == (64, 64)
    assert spec.getattribute("compression") == "zip"
    with Image.open(png) as image:
        assert np.array_equal(np.asarray(image), encode_8bit(pixels, "srgb"))
    assert digest == film_sha256(pixels)
    assert digest == hashlib.sha256(b"smalti-film-1\n100 150 R,G,B\n" + pixels.astype("<f4").tobytes()).hexdigest()


@pytest.mark.parametrize("step", [1, 16, 63, 64, 96, 149])
def test_bytes_do_not_depend_on_how_rows_are_cut(tmp_path, step):
    pixels = _pixels()
    whole = _write(tmp_path / "whole", pixels, [])
    cut = _write(tmp_path / "cut", pixels, list(range(step, 150, step)))
    assert cut[2] == whole[2]
    for one, other in zip(whole[:2], cut[:2], strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_bytes_do_not_depend_on_the_number_of_threads(tmp_path):
    pixels = _pixels(600, 400)  # more bands than are on their way at once
    one = _write(tmp_path / "one", pixels, [100])
    many = _write(tmp_path / "many", pixels, [], threads=3)
    assert many[2] == one[2] == film_sha256(pixels)
    for a, b in zip(one[:2], many[:2], strict=True):
        assert a.read_bytes() == b.read_bytes()


def test_crop_is_a_data_window_inside_the_display_window(tmp_path):
    pixels = _pixels(70, 90)
    exr, png, _ = _write(tmp_path / "a", pixels, [], crop_origin=(37, 21), display_size=(640, 360))
    spec, read = _read_exr(exr)
    assert (spec.x, spec.y, spec.width, spec.height) == (37, 21, 90, 70)
    assert (spec.full_x, spec.full_y, spec.full_width, spec.full_height) == (0, 0, 640, 360)
    assert np.array_equal(read, pixels)
    with Image.open(png) as image:
        assert image.size == (90, 70)


def test_metadata_and_dates(tmp_path):
    exr, png, _ = _write(tmp_path / "a", _pixels(), [])
    spec, _ = _read_exr(exr)
    for name, value in _METADATA.items():
        assert spec.getattribute(name) == value
    assert spec.getattribute("DateTime") == "2000:01:01 00:00:00"
    with Image.open(png) as image:
        image.load()
        assert image.text["smalti:scene_sha256"] == "ab" * 32
        assert image.text["smalti:seed"] == "7"


def test_linear_png_says_so(tmp_path):
    pixels = _pixels()
    _, png, _ = _write(tmp_path / "linear", pixels, [], png_color_space="linear")
    chunks = _png_chunks(png)
    assert struct.unpack(">I", chunks[b"gAMA"]) == (100_000,)
    assert b"sRGB" not in chunks
    with Image.open(png) as image:
        assert np.array_equal(np.asarray(image), encode_8bit(pixels, "linear"))
    _, png, _ = _write(tmp_path / "srgb", pixels, [])
    assert b"sRGB" in _png_chunks(png)


def _png_chunks(path):
    data, position, chunks = path.read_bytes(), 8, {}
    while position < len(data):
        (length,) = struct.unpack_from(">I", data, position)
        chunks[data[position + 4 : position + 8]] = data[position + 8 : position + 8 + length]
        position += 12 + length
    return chunks


def test_nothing_under_the_final_name_before_the_end(tmp_path):
    with FilmWriter(tmp_path / "a.exr", tmp_path / "a.png", 8, 8) as writer:
        writer.write_rows(np.zeros((4, 8, 3), np.float32))
        with pytest.raises(ValueError, match="only 4 of 8 rows"):
            writer.close()
        assert not (tmp_path / "a.exr").exists()
    assert list(tmp_path.iterdir()) == []


def test_wrong_rows_are_refused(tmp_path):
    with FilmWriter(tmp_path / "a.exr", None, 8, 8) as writer:
        with pytest.raises(ValueError, match="float32"):
            writer.write_rows(np.zeros((4, 8, 3)))
        with pytest.raises(ValueError, match="float32"):
            writer.write_rows(np.zeros((4, 9, 3), np.float32))
        with pytest.raises(ValueError, match="more rows"):
            writer.write_rows(np.zeros((9, 8, 3), np.float32))


@pytest.mark.parametrize("name", ["exr", "png"])
def test_a_missing_folder_is_named(tmp_path, name):
    path = tmp_path / "gone" / f"result.{name}"
    with pytest.raises(ImageWriteError, match=f"cannot write result.{name}: "):
        FilmWriter(path if name == "exr" else None, path if name == "png" else None, 8, 8)


_FULL_DISK = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from tracer.film.errors import ImageWriteError
from tracer.film.writer import FilmWriter
name, side, limit = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
path = Path(sys.argv[4]) / f"result.{name}"
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    with FilmWriter(path if name == "exr" else None, path if name == "png" else None, side, side) as writer:
        writer.write_rows(np.random.default_rng(0).random((side, side, 3), np.float32))
        writer.close()
except ImageWriteError as error:
    print("ImageWriteError", error)
print(sorted(entry.name for entry in path.parent.iterdir()))
"""


@pytest.mark.parametrize("name", ["exr", "png"])
@pytest.mark.parametrize(("side", "limit"), [(32, 100), (256, 20_000)])
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path, name, side, limit):
    """A file size limit stands for the full disk; the small picture fails only when its buffer is flushed at the end."""
    command = [sys.executable, "-c", _FULL_DISK, name, str(side), str(limit), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    error, left = done.stdout.splitlines()
    assert error.startswith(f"ImageWriteError cannot write result.{name}: ")
    assert str(tmp_path) not in error
    assert left == "[]"


_TALL = """
import resource, sys
from pathlib import Path
import numpy as np
from tracer.film.writer import FilmWriter
rows = np.random.default_rng(0).random((64, 1024, 3), np.float32)
with FilmWriter(Path(sys.argv[1]) / "a.exr", Path(sys.argv[1]) / "a.png", 1024, 64 * 128) as writer:
    for band in range(128):
        writer.write_rows(rows)
        if band == 3:
            early = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    writer.close()
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - early) // 1024)
"""


def test_memory_is_flat(tmp_path):
    """96 MB of noise pass through; kept back, they would show."""
    done = subprocess.run(
        [sys.executable, "-c", _TALL, str(tmp_path)], capture_output=True, text=True, check=True, timeout=120
    )
    assert int(done.stdout) < 12
