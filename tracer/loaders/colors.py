"""Vertex colours of files, on their way to linear RGB.

Invariant: PLY and OBJ mean what is seen on a screen (sRGB), in 0 to 255 or 0 to 1; glTF means linear light.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.film.develop import linear_from_srgb


def linear_colors(colors: NDArray[Any], *, is_srgb: bool = True) -> NDArray[np.float64]:
    """Scale colours to 0..1 by their type, and undo the sRGB curve.

    Parameters
    ----------
    colors : (n, 3) or more columns, unsigned integers or floats
        Columns beyond the third (alpha) are dropped.

    Returns
    -------
    float64 (n, 3)
        NaN stays NaN.
    """
    rgb = np.asarray(colors)[:, :3]
    if rgb.dtype.kind in "ui":
        scaled = rgb.astype(np.float64) / np.iinfo(rgb.dtype).max
    else:
        scaled = rgb.astype(np.float64)
        finite = scaled[np.isfinite(scaled)]
        if finite.size and finite.max() > 1.0 and finite.max() <= 255.0:
            scaled = scaled / 255.0  # floats that hold bytes
    if not is_srgb:
        return scaled
    return linear_from_srgb(np.clip(scaled, 0.0, 1.0))
