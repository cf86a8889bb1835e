"""Shapes of the oracle: solved in their own space from their own equations, by brute force.

Job: sphere, plane, disk, box and cylinder for ``tests/naive.py``. Invariant: nothing of ``tracer`` is imported. Source: the
equations of the surfaces.
"""

import dataclasses

import numpy as np

from tests.naive import Material, Surface, dot, length, vec


@dataclasses.dataclass
class Shape:
    """A shape that is solved in its own space; ``matrix`` maps it to the world.

    A subclass gives ``roots(o, d)``: a list of arrays of candidate t, NaN where there is none, and ``outward(p)``: the outward
    normal at points of its surface. The ray is transformed without making the direction unit, so t is the same in both spaces.
    """

    material: "Material"
    matrix: np.ndarray

    def local(self, o, d):
        inverse = np.linalg.inv(self.matrix)
        return inverse[:3, :3] @ o + inverse[:3, 3:], inverse[:3, :3] @ d

    def hit(self, o, d, t_min, t_max):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            nearest = np.full(d.shape[1], np.inf)
            for t in self.roots(*self.local(o, d)):
                nearest = np.where((t >= t_min) & (t <= t_max) & (t < nearest), t, nearest)
        nothing = np.zeros_like(nearest)
        return np.isfinite(nearest), nearest, nothing.astype(int), nothing, nothing

    def crossings(self, o, d, t_min, t_max):
        """Return how often each ray goes through the surface between t_min and t_max (shadow rays pay kt each time)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return sum(((t >= t_min) & (t <= t_max)).astype(int) for t in self.roots(*self.local(o, d)))

    def surface(self, o, d, t, _part, _u, _v):
        lo, ld = self.local(o, d)
        normal = np.linalg.inv(self.matrix)[:3, :3].T @ self.outward(lo + t * ld)
        n = t.size
        return Surface(point=o + t * d, normal=normal, geometric=normal, uv=np.zeros((2, n)), color=np.ones((3, n)))


@dataclasses.dataclass
class Sphere(Shape):
    center: list
    radius: float

    def roots(self, o, d):
        # |o + t d - c|^2 = r^2, solved about the point of the ray nearest to the centre, where nothing cancels
        m = o - vec(self.center)
        dd = dot(d, d)
        t_near = -dot(m, d) / dd
        rest = m + t_near * d
        half = np.sqrt((self.radius**2 - dot(rest, rest)) / dd)  # NaN where the ray passes by
        return [t_near - half, t_near + half]

    def outward(self, p):
        return p - vec(self.center)


@dataclasses.dataclass
class Plane(Shape):
    point: list
    normal: list

    def roots(self, o, d):
        return [dot(vec(self.point) - o, vec(self.normal)) / dot(d, vec(self.normal))]

    def outward(self, p):
        return np.repeat(vec(self.normal), p.shape[1], axis=1)


@dataclasses.dataclass
class Disk(Shape):
    center: list
    normal: list
    radius: float

    def roots(self, o, d):
        t = dot(vec(self.center) - o, vec(self.normal)) / dot(d, vec(self.normal))
        return [np.where(length(o + t * d - vec(self.center)) <= self.radius, t, np.nan)]

    def outward(self, p):
        return np.repeat(vec(self.normal), p.shape[1], axis=1)


@dataclasses.dataclass
class Box(Shape):
    low: list
    high: list

    def roots(self, o, d):
        candidates = []
        for axis in range(3):
            others = [k for k in range(3) if k != axis]
            for bound in (self.low[axis], self.high[axis]):
                t = (bound - o[axis]) / d[axis]
                inside = np.ones(t.shape, dtype=bool)
                for k in others:
                    p = o[k] + t * d[k]
                    inside &= (p >= self.low[k]) & (p <= self.high[k])
                candidates.append(np.where(inside, t, np.nan))
        return candidates

    def outward(self, p):
        # the face is the one whose plane is nearest
        distances = np.concatenate([p - vec(self.low), vec(self.high) - p])
        face = np.argmin(np.abs(distances), axis=0)
        normal = np.zeros_like(p)
        normal[face % 3, np.arange(face.size)] = np.where(face < 3, -1.0, 1.0)
        return normal


@dataclasses.dataclass
class Cylinder(Shape):
    start: list
    end: list
    radius: float
    capped: bool = True

    def roots(self, o, d):
        axis = vec(np.subtract(self.end, self.start))
        height = float(length(axis)[0])
        axis = axis / height
        m = o - vec(self.start)
        # side: the parts of m and d across the axis must differ by the radius
        mp, dp = m - dot(m, axis) * axis, d - dot(d, axis) * axis
        dd = dot(dp, dp)
        t_near = -dot(mp, dp) / dd
        rest = mp + t_near * dp
        half = np.sqrt((self.radius**2 - dot(rest, rest)) / dd)
        candidates = []
        for t in (t_near - half, t_near + half):
            along = dot(m + t * d, axis)
            candidates.append(np.where((along >= 0.0) & (along <= height), t, np.nan))
        if self.capped:
            for along in (0.0, height):
                t = (along - dot(m, axis)) / dot(d, axis)
                across = m + t * d - along * axis
                candidates.append(np.where(length(across) <= self.radius, t, np.nan))
        return candidates

    def outward(self, p):
        axis = vec(np.subtract(self.end, self.start))
        height = float(length(axis)[0])
        axis = axis / height
        m = p - vec(self.start)
        along = dot(m, axis)
        across = m - along * axis
        normal = across / length(across)
        if self.capped:
            # nearest of the three surfaces
            distances = np.abs(np.stack([length(across) - self.radius, along, along - height]))
            nearest = np.argmin(distances, axis=0)
            normal = np.where(nearest == 1, -axis, np.where(nearest == 2, axis, normal))
        return normal
