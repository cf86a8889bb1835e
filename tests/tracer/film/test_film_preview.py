"""The preview: means of what is done, transparent where nothing is."""

import io

import numpy as np
from PIL import Image

from tracer.film.develop import encode_8bit
from tracer.film.preview import Preview
from tracer.film.tile import Rect


def _decode(preview, color_space="linear"):
    with Image.open(io.BytesIO(preview.encode_png(color_space))) as image:
        return np.asarray(image)


def test_a_small_picture_is_itself():
    pixels = np.random.default_rng(1).random((40, 60, 3), np.float32)
    preview = Preview(Rect(0, 0, 60, 40))
    preview.add(Rect(0, 0, 60, 40), pixels)
    shown = _decode(preview, "srgb")
    assert np.array_equal(shown[:, :, :3], encode_8bit(pixels, "srgb"))
    assert (shown[:, :, 3] == 255).all()


def test_tiles_in_any_order_and_size_give_the_same_means():
    rng = np.random.default_rng(2)
    pixels = rng.random((101, 203, 3), np.float32)
    window = Rect(13, 7, 203, 101)
    pictures = []
    for size in (16, 37, 300):
        preview = Preview(window, max_side=50)  # factor 5: tiles do not begin where cells begin
        corners = [(x, y) for y in range(0, 101, size) for x in range(0, 203, size)]
        for index in rng.permutation(len(corners)):
            x, y = corners[index]
            part = pixels[y : y + size, x : x + size]
            preview.add(Rect(13 + x, 7 + y, part.shape[1], part.shape[0]), part)
        pictures.append(_decode(preview).astype(int))
    assert pictures[0].shape == (21, 41, 4)
    expected = encode_8bit(pixels[:100, :200].reshape(20, 5, 40, 5, 3).mean(axis=(1, 3)), "linear")
    assert np.abs(pictures[0][:20, :40, :3] - expected).max() <= 1
    for picture in pictures[1:]:
        assert np.abs(picture - pictures[0]).max() <= 1  # means are summed in another order


def test_what_is_not_done_is_transparent():
    preview = Preview(Rect(0, 0, 2048, 1024), max_side=256)
    preview.add(Rect(1024, 0, 64, 64), np.ones((64, 64, 3), np.float32))
    shown = _decode(preview)
    assert shown.shape == (128, 256, 4)
    assert (shown[0:8, 128:136] == 255).all()
    shown = shown.copy()
    shown[0:8, 128:136] = 0
    assert not shown.any()


def test_nan_and_infinity_do_not_spread():
    preview = Preview(Rect(0, 0, 4, 2), max_side=2)
    pixels = np.full((2, 4, 3), 0.5, np.float32)
    pixels[0, 0] = np.nan
    preview.add(Rect(0, 0, 4, 2), pixels)
    assert _decode(preview)[0, 0, :3].tolist() == [96, 96, 96]  # 3 of 4 pixels at 0.5
