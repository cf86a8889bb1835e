"""Developing: the table gives the definition's value for every float32 that could differ."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracer.film.develop import develop, develop_blocks, encode_8bit, linear_from_srgb, srgb_from_linear
from tracer.film.tile import Rect, blocks_of_rect, join_blocks


def _definition(x: np.ndarray, color_space: str) -> np.ndarray:
    """Clamp, transfer, scale, round, one number at a time."""
    out = []
    for value in x.tolist():
        clamped = min(max(value, 0.0), 1.0) if value == value else 0.0
        if color_space == "srgb":
            clamped = 12.92 * clamped if clamped <= 0.0031308 else 1.055 * clamped ** (1 / 2.4) - 0.055
        out.append(round(255 * clamped))
    return np.array(out)


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_encode_agrees_with_the_definition_around_every_step(color_space):
    encoded = (np.arange(256) + 0.5) / 255.0
    steps = linear_from_srgb(encoded) if color_space == "srgb" else encoded
    bits = steps.astype(np.float32).view(np.int32)[:, np.newaxis] + np.arange(-200, 201)
    x = bits.astype(np.int32).view(np.float32).ravel()
    assert np.array_equal(encode_8bit(x, color_space), _definition(x, color_space))


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_encode_agrees_with_the_definition_everywhere(color_space):
    rng = np.random.default_rng(7)
    x = np.concatenate([rng.random(50_000), 10.0 ** rng.uniform(-44, 3, 50_000), np.arange(256) / 255])
    x = x.astype(np.float32)
    assert np.array_equal(encode_8bit(x, color_space), _definition(x, color_space))


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_clamped_and_never_wrapped(color_space):
    x = np.array([-np.inf, -1.0, -1e-45, -0.0, 0.0, 1.0, 1.0000001, 2.0, 1e38, np.inf, np.nan], np.float32)
    assert encode_8bit(x, color_space).tolist() == [0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 0]
    assert x[3] == 0.0  # the input is left alone
    assert np.signbit(x[3])


def test_known_values_of_the_srgb_curve():
    x = np.array([0.21404114, 0.5, 0.18, 0.0031308], np.float32)
    assert encode_8bit(x, "srgb").tolist() == [128, 188, 118, 10]
    assert encode_8bit(x, "linear").tolist() == [55, 128, 46, 1]


def test_curve_and_its_inverse():
    x = np.linspace(0, 1, 1001)
    assert np.abs(linear_from_srgb(srgb_from_linear(x)) - x).max() < 1e-6  # the standard's constants meet to 6 digits


def test_develop_rounds_once():
    sums = np.array([[[[1.0, 1e300, 0.1]]], [[[2.0, 1e300, 0.2]]]])
    pixels = develop(sums, 3)
    assert pixels.dtype == np.float32
    assert pixels.shape == (1, 1, 3)
    assert pixels[0, 0, 0] == 1.0
    assert pixels[0, 0, 1] == np.inf
    assert pixels[0, 0, 2] == np.float32((0.1 + 0.2) / 3)


@given(st.integers(0, 70), st.integers(0, 70), st.integers(1, 70), st.integers(1, 70), st.integers(1, 65536))
@settings(max_examples=60, deadline=None)
def test_blocks_develop_to_the_bits_of_the_joined_sums(x, y, width, height, n_samples):
    rect = Rect(x, y, width, height)
    sums = 10.0 ** np.random.default_rng(x).uniform(-60, 60, (len(blocks_of_rect(rect)), 2, 16, 16, 3))
    pixels = develop_blocks(rect, sums, n_samples)
    assert pixels.flags.c_contiguous
    assert np.array_equal(pixels, develop(join_blocks(rect, sums), n_samples))


def test_no_samples_have_no_average():
    with pytest.raises(ValueError, match="no average"):
        develop_blocks(Rect(0, 0, 16, 16), np.zeros((1, 2, 16, 16, 3)), 0)
    with pytest.raises(ValueError, match="blocks"):
        develop_blocks(Rect(0, 0, 32, 16), np.zeros((1, 2, 16, 16, 3)), 1)
    with pytest.raises(ValueError, match="no average"):
        develop(np.zeros((2, 1, 1, 3)), 0)
