"""Cut polygons into triangles, concave ones too.

Invariant: the triangles have the polygon's own winding and cover it; convex quads are cut along their first
diagonal, as everybody does. Source: ear clipping by mapbox-earcut, in the plane of Newell's normal.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

_FLAT: Final = 1e-6
"""Distance from the plane, in sizes of the polygon, below which it is flat: what is left of six decimals in a file."""


def triangulate(corners: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Cut one polygon.

    Parameters
    ----------
    corners : float64 (n, 3)
        n >= 3, in order.

    Returns
    -------
    list of (int, int, int)
        Triangles as indices into `corners`.
    """
    n = len(corners)
    if n == 3:
        return [(0, 1, 2)]
    fan = [(0, i, i + 1) for i in range(1, n - 1)]
    if not np.isfinite(corners).all():
        return fan
    size = float(np.abs(corners - corners[0]).max())
    if size == 0.0:
        return fan
    relative = (corners - corners[0]) / size
    following = np.roll(relative, -1, axis=0)
    normal = np.cross(relative, following).sum(axis=0)  # Newell: twice the area
    length = float(np.sqrt((normal * normal).sum()))
    if length == 0.0:
        return fan
    # A fan from corner 0 is right when all its triangles look the polygon's way.
    turns = np.cross(relative[1:-1], relative[2:]) @ normal
    if (turns >= 0.0).all():
        return fan
    import mapbox_earcut

    axis = int(np.abs(normal).argmax())
    plane = relative[:, [(axis + 1) % 3, (axis + 2) % 3]]
    cut = mapbox_earcut.triangulate_float64(np.ascontiguousarray(plane), np.array([n], np.uint32)).reshape(-1, 3)
    if len(cut) < n - 2:
        # Corners on a straight line are dropped: fine in a plane, but of a bent polygon that is a piece of it.
        distance = np.abs(relative @ (normal / length)).max()
        if len(cut) == 0 or distance > _FLAT:
            return fan
    triangles = []
    for a, b, c in cut.tolist():
        (ax, ay), (bx, by), (cx, cy) = plane[a], plane[b], plane[c]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        # Earcut's winding is its own: give each triangle the polygon's.
        triangles.append((a, b, c) if area * normal[axis] >= 0.0 else (a, c, b))
    return triangles
