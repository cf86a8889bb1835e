"""Texture look-up, texel by texel."""

import numpy as np
import pytest

from tracer.shading.texture import sample_texture
from tracer.types import FILTER_BILINEAR, FILTER_NEAREST, WRAP_CLAMP, WRAP_REPEAT

WIDTH, HEIGHT = 4, 3
TEXELS = np.concatenate([np.full((5, 3), 9.0), np.random.default_rng(1).random((WIDTH * HEIGHT, 3))]).astype(np.float32)
TEXTURES = np.array([0, 1, 5, 5, WIDTH, HEIGHT])  # the second texture begins at texel 5
IMAGE = TEXELS[5:].reshape(HEIGHT, WIDTH, 3)


def look_up(u, v, wrap=WRAP_REPEAT, filtering=FILTER_NEAREST):
    found = sample_texture(TEXTURES, TEXELS.reshape(-1), np.int64(1), np.int64(wrap), np.int64(filtering), u, v)
    return np.array(found)


@pytest.mark.parametrize("filtering", [FILTER_NEAREST, FILTER_BILINEAR])
@pytest.mark.parametrize("shift", [0, 1, -1, 7, -100])
def test_texel_centres(filtering, shift):
    """v grows upwards: row 0 is at the top, at v near 1."""
    for row in range(HEIGHT):
        for column in range(WIDTH):
            u, v = (column + 0.5) / WIDTH + shift, 1.0 - (row + 0.5) / HEIGHT + shift
            assert look_up(u, v, filtering=filtering) == pytest.approx(IMAGE[row, column], abs=1e-12)


def test_bilinear_weights():
    """A quarter of the way from one centre to the next, in both directions."""
    u, v = (1.5 + 0.25) / WIDTH, 1.0 - (0.5 + 0.75) / HEIGHT
    weights = np.array([[0.75 * 0.25, 0.25 * 0.25], [0.75 * 0.75, 0.25 * 0.75]])
    expected = (weights[..., None] * IMAGE[0:2, 1:3].astype(float)).sum(axis=(0, 1))
    assert look_up(u, v, filtering=FILTER_BILINEAR) == pytest.approx(expected, abs=1e-12)


def test_bilinear_across_the_seam():
    edge = look_up(0.0, 1.0 - 0.5 / HEIGHT, WRAP_REPEAT, FILTER_BILINEAR)
    assert edge == pytest.approx((IMAGE[0, 0].astype(float) + IMAGE[0, -1]) / 2, abs=1e-12)
    edge = look_up(0.0, 1.0 - 0.5 / HEIGHT, WRAP_CLAMP, FILTER_BILINEAR)
    assert edge == pytest.approx(IMAGE[0, 0], abs=1e-12)


@pytest.mark.parametrize(
    ("u", "v", "row", "column"), [(-3.0, 9.0, 0, 0), (5.0, -1.0, 2, 3), (1.0, 1.0, 0, 3), (0.0, 0.0, 2, 0)]
)
@pytest.mark.parametrize("filtering", [FILTER_NEAREST, FILTER_BILINEAR])
def test_clamp(u, v, row, column, filtering):
    assert look_up(u, v, WRAP_CLAMP, filtering) == pytest.approx(IMAGE[row, column], abs=1e-12)


@pytest.mark.parametrize("wrap", [WRAP_REPEAT, WRAP_CLAMP])
@pytest.mark.parametrize("filtering", [FILTER_NEAREST, FILTER_BILINEAR])
def test_extreme_coordinates_stay_inside(wrap, filtering):
    for u in [0.0, 1.0, -0.0, -1e-300, 1.0 - 2.0**-53, 1e15 + 0.5, -1e300, 1e300, 0.9999999999999999]:
        for v in [0.0, 1.0, -1e-300, 1e-300, 1e300, -1e15]:
            found = look_up(u, v, wrap, filtering)
            assert (found <= IMAGE.max()).all()
            assert (found >= IMAGE.min()).all()
