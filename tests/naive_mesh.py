"""Many triangles of one material as one primitive of the oracle, so that a model costs numpy calls by runs, not by triangles.

Job: ``tests.naive.Triangle`` for arrays of triangles: the same equations (``tests.naive.solve``), each ray against each
triangle, but for one thing: triangles are taken in runs as they come, and a run is not asked about rays that pass by
the box around it. Boxes are wider by PAD than their corners, a million times more than rounding can amount to in scenes
of up to a few hundred units. Invariant: nothing of ``tracer`` is imported.
"""

import dataclasses
import functools

import numpy as np

from tests.naive import Material, Surface, cross, solve

RUN = 16  # triangles of one box
PAD = 1e-6
RAYS = 2048  # taken against a run at once, so that what is computed of them stays in the cache


def meets(low, high, o, d, t_min, t_max):
    """Return which rays meet a box between t_min and t_max; in doubt (0/0: along a face) they do."""
    enter, leave = np.full(d.shape[1], t_min), np.full(d.shape[1], t_max, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(3):
            t0, t1 = (low[k] - o[k]) / d[k], (high[k] - o[k]) / d[k]
            enter = np.fmax(enter, np.minimum(t0, t1))  # fmax, fmin: what is not a number does not count
            leave = np.fmin(leave, np.maximum(t0, t1))
    return enter <= leave


@dataclasses.dataclass
class Mesh:
    """Triangles in world space: ``corners`` (m, 3, 3) by triangle, corner and coordinate, the others alike."""

    corners: np.ndarray
    material: Material
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    colors: np.ndarray | None = None

    @functools.cached_property
    def boxes(self):
        """The box around all, and each run's first triangle and box."""

        def box(corners):
            return corners.min(axis=(0, 1)) - PAD, corners.max(axis=(0, 1)) + PAD

        return box(self.corners), [(k, *box(self.corners[k : k + RUN])) for k in range(0, len(self.corners), RUN)]

    def candidates(self, o, d, t_min, t_max):
        """Yield for each run and some rays at a time: the first triangle, which rays, and what solve() says, (triangles, rays)."""
        (low, high), runs = self.boxes
        (near,) = np.nonzero(meets(low, high, o, d, t_min, t_max))
        if near.size == 0:
            return
        near_o, near_d = o[:, near], d[:, near]
        for first, low, high in runs:
            (rays,) = np.nonzero(meets(low, high, near_o, near_d, t_min, t_max))
            a, b, c = self.corners[first : first + RUN].transpose(1, 2, 0)[..., None]
            for k in range(0, rays.size, RAYS):
                some = near[rays[k : k + RAYS]]
                yield first, some, solve(a, b, c, o[:, some], d[:, some], t_min, t_max)

    def hit(self, o, d, t_min, t_max):
        """Return for each ray its nearest triangle, the first one of equally near ones."""
        n = d.shape[1]
        nearest, part, u, v = np.full(n, np.inf), np.zeros(n, dtype=int), np.zeros(n), np.zeros(n)
        for first, rays, (inside, t, beta, gamma) in self.candidates(o, d, t_min, t_max):
            met = np.where(inside, t, np.inf)
            row = met.argmin(axis=0)
            (column,) = np.nonzero(met.min(axis=0) < nearest[rays])
            row, nearer = row[column], rays[column]
            nearest[nearer], part[nearer] = met[row, column], first + row
            u[nearer], v[nearer] = beta[row, column], gamma[row, column]
        return np.isfinite(nearest), nearest, part, u, v

    def crossings(self, o, d, t_min, t_max):
        """Return how often each ray goes through the surface between t_min and t_max."""
        count = np.zeros(d.shape[1], dtype=int)
        for _, rays, (inside, *_) in self.candidates(o, d, t_min, t_max):
            count[rays] += inside.sum(axis=0)
        return count

    def surface(self, o, d, t, part, beta, gamma):
        def interpolate(values):
            a, b, c = values[part].transpose(1, 2, 0)
            return (1.0 - beta - gamma) * a + beta * b + gamma * c

        n = t.size
        a, b, c = self.corners[part].transpose(1, 2, 0)
        geometric = cross(b - a, c - a)
        return Surface(
            point=interpolate(self.corners),
            normal=interpolate(self.normals) if self.normals is not None else geometric,
            geometric=geometric,
            uv=interpolate(self.uvs) if self.uvs is not None else np.zeros((2, n)),
            color=interpolate(self.colors) if self.colors is not None else np.ones((3, n)),
        )
