"""Many rays against a compiled scene at once: for measurements, tests and whoever asks what a ray meets.

The renderer does not come this way; it asks :mod:`tracer.accel.traverse` ray by ray from inside its kernel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.accel.build import MAX_DEPTH
from tracer.accel.traverse import closest_hit, transmit
from tracer.accel.view import view_scene
from tracer.geometry.vector import at
from tracer.jit import int64, kernel, pointer
from tracer.types import CompiledScene


class Hits(NamedTuple):
    """What n rays met first."""

    t: NDArray[np.float64]  # (n,) ray parameter, in lengths of the direction; infinite where nothing was met
    primitive: NDArray[np.int64]  # (n,) id, -1 where nothing was met
    uv: NDArray[np.float64]  # (n, 2) weights of a triangle's second and third vertex as given; 0 for other primitives


@kernel
def find_closest(
    scene: CompiledScene, origins: NDArray[np.float64], directions: NDArray[np.float64], skip: NDArray[np.int64]
) -> Hits:
    """Find the nearest primitive of each ray.

    Parameters
    ----------
    scene
        Arrays as :data:`tracer.types.FIELDS` says.
    origins, directions : float64 (n, 3), world
    skip : int64 (n,)
        Id of a flat primitive that a ray starts on; -1 for none.
    """
    view = view_scene(scene)
    n = origins.shape[0]
    t = np.empty(n)
    primitive = np.empty(n, np.int64)
    uv = np.zeros((n, 2))
    stack = np.empty(MAX_DEPTH + 4, np.int64)
    stack_t = np.empty(MAX_DEPTH + 4)
    o = pointer(origins)
    d = pointer(directions)
    for k in range(n):
        hit = closest_hit(view, at(o, 3 * k), at(d, 3 * k), skip[k], pointer(stack), pointer(stack_t))
        t[k] = hit.t
        primitive[k] = hit.primitive
        if 0 <= hit.primitive < view.n_triangles:
            for j in range(3):
                corner = scene.bvh_corners[hit.slot, j]
                if corner > 0:
                    uv[k, corner - 1] = (1.0 - hit.v - hit.w, hit.v, hit.w)[j]
    return Hits(t, primitive, uv)


@kernel
def find_transmittance(
    scene: CompiledScene,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    t_max: NDArray[np.float64],
    occluders: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Share of light that comes through in 0 < t < t_max.

    Parameters
    ----------
    scene
        Arrays as :data:`tracer.types.FIELDS` says.
    origins, directions : float64 (n, 3), world
    t_max : float64 (n,)
    occluders : int64 (1,)
        Slot of the last occluder, -1 for none; kept from ray to ray, and left there.

    Returns
    -------
    float64 (n, 3)
        Product of the kt of all surfaces crossed, RGB.
    """
    view = view_scene(scene)
    n = origins.shape[0]
    share = np.empty((n, 3))
    stack = np.empty(MAX_DEPTH + 4, np.int64)
    o = pointer(origins)
    d = pointer(directions)
    for k in range(n):
        shadow = transmit(view, at(o, 3 * k), at(d, 3 * k), t_max[k], int64(-1), occluders[0], pointer(stack))
        occluders[0] = shadow.occluder
        share[k, 0] = shadow.red
        share[k, 1] = shadow.green
        share[k, 2] = shadow.blue
    return share
