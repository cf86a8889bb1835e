"""A compiled scene made of a few arrays by hand, without a document."""

from typing import Any

import numpy as np

from tracer.accel import build_bvh
from tracer.types import FIELDS, CompiledScene


def make_scene(**fields: Any) -> CompiledScene:
    """Complete a compiled scene: empty arrays for what is not given, the hierarchy built from what is.

    Parameters
    ----------
    **fields
        Arrays of :class:`tracer.types.CompiledScene`, converted to the dtypes of :data:`tracer.types.FIELDS`.

    Returns
    -------
    CompiledScene
    """
    arrays: dict[str, Any] = {}
    for name, (dtype, shape) in FIELDS.items():
        if name in fields:
            arrays[name] = np.ascontiguousarray(fields[name], dtype)
        else:
            arrays[name] = np.zeros([length or 0 for length in shape], dtype)
    bvh = build_bvh(
        arrays["vertex_positions"],
        arrays["face_vertices"],
        arrays["shape_kind"],
        arrays["shape_origin"],
        arrays["shape_to_world"],
    )
    return CompiledScene(**{**arrays, **bvh._asdict()})
