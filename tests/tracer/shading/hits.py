"""Rays and what they have met, 64 at a time, filled in and read from Python; lanes not used hold meaningless numbers."""

import numpy as np

from tracer.accel.view import VIEW_BYTES, view_scene
from tracer.jit import kernel, pointer
from tracer.rays.rows import ORIGIN, PACKET, PRIMITIVE, RAY_ROWS, ROW, T_BEST, WEIGHT_1, WEIGHT_2
from tracer.shading.direct import add_light, face_light
from tracer.shading.rows import DIRECTION, HIT_ROWS
from tracer.shading.surfaces import fill_surfaces
from tracer.simd import address_of, stack_memory
from tracer.types import COUNTERS, Vec3


@kernel
def _fill(scene, ambient, hits, lanes):
    return fill_surfaces(
        view_scene(scene, stack_memory(VIEW_BYTES)), Vec3(ambient[0], ambient[1], ambient[2]), address_of(hits), lanes
    )


@kernel
def _face(scene, light, hits, shadows, lanes, counters):
    return face_light(
        view_scene(scene, stack_memory(VIEW_BYTES)),
        light,
        address_of(hits),
        address_of(shadows),
        lanes,
        np.int64(0),
        pointer(counters),
    )


@kernel
def _add(scene, light, hits, shadows, lanes):
    add_light(view_scene(scene, stack_memory(VIEW_BYTES)), light, address_of(hits), address_of(shadows), lanes)


def set_of(lanes):
    """Lanes as the bits of an int64."""
    return np.bitwise_or.reduce(np.int64(1) << np.asarray(lanes, np.int64), initial=np.int64(0))


def lanes_of(bits):
    """The bits of an int64 as a mask (64,)."""
    return (np.int64(bits) >> np.arange(PACKET)) & 1 == 1


class Packet:
    """Rows of 64 values on a cache line; ``lanes`` are those in use."""

    def __init__(self, lanes=range(PACKET), n_rows=HIT_ROWS, seed=0):
        rng = np.random.default_rng(seed)
        n = n_rows * PACKET
        memory = np.empty(n + 8)
        start = -(memory.ctypes.data // 8) % 8
        self.flat = memory[start : start + n]
        self.flat[:] = rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-20, 20, n)
        self.rows = self.flat.reshape(n_rows, PACKET)
        self.words = self.rows.view(np.int64)
        self.lanes = np.asarray(list(lanes))
        self.set = set_of(self.lanes)

    def put(self, offset, values, *, words=False):
        """Write one value, or three, of each lane in use."""
        rows = self.words if words else self.rows
        values = np.asarray(values)
        for k in range(3 if values.ndim == 2 else 1):
            rows[offset // ROW + k, self.lanes] = values[:, k] if values.ndim == 2 else values

    def get(self, offset, width=3, *, words=False):
        """Read (n, 3), or (n,) for width 1."""
        rows = (self.words if words else self.rows)[offset // ROW : offset // ROW + width, self.lanes]
        return rows[0].copy() if width == 1 else rows.T.copy()


def meet(
    scene, origins, directions, primitives, *, t=np.inf, u=0.0, v=0.0, ambient=(0.0, 0.0, 0.0), lanes=None, seed=0
):
    """Fill in hits that are known; returns the packet and a mask of those that came from behind."""
    n = len(primitives)
    packet = Packet(range(n) if lanes is None else lanes, seed=seed)
    packet.put(ORIGIN, np.broadcast_to(origins, (n, 3)))
    packet.put(DIRECTION, np.broadcast_to(directions, (n, 3)))
    packet.put(PRIMITIVE, primitives, words=True)
    packet.put(T_BEST, np.broadcast_to(t, n))
    packet.put(WEIGHT_1, np.broadcast_to(u, n))
    packet.put(WEIGHT_2, np.broadcast_to(v, n))
    behind = _fill(scene, np.asarray(ambient, float), packet.flat, packet.set)
    assert (np.int64(behind) & ~packet.set) == 0
    return packet, lanes_of(behind)[packet.lanes]


def face(scene, light, packet):
    """Return (mask of the lit, shadow packet, counters by name)."""
    shadows, counters = Packet(packet.lanes, RAY_ROWS, seed=7), np.zeros(len(COUNTERS), np.int64)
    lit = _face(scene, light, packet.flat, shadows.flat, packet.set, counters)
    assert (np.int64(lit) & ~packet.set) == 0
    return lanes_of(lit)[packet.lanes], shadows, dict(zip(COUNTERS, counters.tolist(), strict=True))


def add(scene, light, packet, shadows, lit):
    """Add a light to the lit hits."""
    _add(scene, light, packet.flat, shadows.flat, set_of(packet.lanes[lit]))
