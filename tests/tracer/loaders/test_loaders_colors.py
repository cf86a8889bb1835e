"""Vertex colours on their way to linear light."""

import numpy as np
import pytest

from tracer.loaders.colors import linear_colors


@pytest.mark.parametrize(
    "colors",
    [
        np.array([[0, 128, 255, 7]], np.uint8),
        np.array([[0, 128 * 257, 65535]], np.uint16),
        np.array([[0.0, 128 / 255, 1.0]]),
        np.array([[0.0, 128.0, 255.0]], np.float32),  # floats that hold bytes
    ],
)
def test_all_forms_of_a_colour_are_the_same_light(colors):
    assert linear_colors(colors) == pytest.approx(np.array([[0.0, 0.21586050, 1.0]]), abs=1e-7)
    assert linear_colors(colors, is_srgb=False) == pytest.approx(np.array([[0.0, 128 / 255, 1.0]]), abs=1e-7)


def test_floats_are_taken_for_bytes_only_within_bytes():
    assert linear_colors(np.array([[0.5, 1.0, 300.0]]), is_srgb=False).tolist() == [[0.5, 1.0, 300.0]]
    assert linear_colors(np.array([[-1.0, 1.0, 300.0]])).tolist() == [[0.0, 1.0, 1.0]]


def test_what_is_no_number_stays_none():
    found = linear_colors(np.array([[np.nan, 1.0, 0.0]]))
    assert np.isnan(found[0, 0])
    assert found[0, 1:].tolist() == [1.0, 0.0]
