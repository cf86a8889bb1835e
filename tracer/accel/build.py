"""Build a two-way bounding volume hierarchy by binned surface-area heuristic."""

import numpy as np
from numpy.typing import NDArray

from tracer.types import Bvh


def build_bvh(
    vertex_positions: NDArray[np.float64],
    face_vertices: NDArray[np.int32],
    shape_kind: NDArray[np.int32],
    shape_origin: NDArray[np.float64],
    shape_to_world: NDArray[np.float64],
) -> Bvh:
    """Build the hierarchy over all triangles and finite shapes of a scene; ``CompiledScene(**bvh._asdict(), ...)``.

    Parameters
    ----------
    vertex_positions : float64 (n_vertices, 3), world
    face_vertices : int32 (n_triangles, 3)
    shape_kind : int32 (n_shapes,)
    shape_origin : float64 (n_shapes, 3), world
    shape_to_world : float64 (n_shapes, 3, 3)
    """
    raise NotImplementedError
