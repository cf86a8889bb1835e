"""Rays in packets, asked from Python; and brute force for the light that triangles let through.

Lanes that a packet does not use hold numbers that mean nothing, so that a kernel which reads them is caught.
"""

from typing import NamedTuple

import numpy as np

from tracer.accel.build import MAX_DEPTH
from tracer.accel.emit import sorted_order
from tracer.accel.traverse import closest_shape, shade_by_shapes
from tracer.accel.view import VIEW_BYTES, view_scene
from tracer.accel.wide import build_wide
from tracer.geometry.vector import at
from tracer.jit import int64, kernel, pointer
from tracer.rays.bundle import trace_alone, trace_bundle
from tracer.rays.leaf import ANY, CLOSEST, SHADE
from tracer.rays.packet import UNLIMITED, trace_packet
from tracer.rays.placed import trace_scene
from tracer.rays.predicate import intersect_triangle, shear_of
from tracer.rays.rows import (
    AXIS,
    LIGHT,
    LIGHT_REST,
    ORIGIN,
    PACKET,
    PRIMITIVE,
    RAY_ROWS,
    ROW,
    SHEAR,
    SKIP,
    SPEED,
    T_BEST,
    WEIGHT_1,
    WEIGHT_2,
)
from tracer.simd import address_of, load, stack_memory, store
from tracer.simd.gateway import types
from tracer.types import MATERIAL_KT, N_MATERIAL, Vec3

_float64, _int64 = types.float64, types.int64
WAYS = ("bundle", "packet", "alone", "given up")
MODES = {"closest": CLOSEST, "any": ANY, "shade": SHADE}


class Answers(NamedTuple):
    """What n rays have met."""

    t: np.ndarray  # (n,) infinite for a miss
    primitive: np.ndarray  # (n,)
    u: np.ndarray  # (n,) of the second vertex as given
    v: np.ndarray  # (n,) of the third
    ended: np.ndarray  # (n,) bool: met anything, or in the dark
    light: np.ndarray  # (n, 3)


@kernel
def put_direction(packet, lane, dx, dy, dz):
    """Fill SHEAR, SPEED and AXIS of one ray, as the predicate defines its shear."""
    _kx, _ky, kz, sx, sy, sz = shear_of(dx, dy, dz)
    along = dz if kz == 2 else (dy if kz == 1 else dx)
    ray = packet + 8 * lane
    store(ray + SHEAR, sx)
    store(ray + SHEAR + ROW, sy)
    store(ray + SHEAR + 2 * ROW, sz)
    store(ray + SPEED, abs(along))
    store(ray + AXIS, _int64(2 * kz + (1 if along < 0.0 else 0)))


@kernel
def _put_rays(packet, origins, directions, ends, skips, lanes):
    active = int64(0)
    for k in range(lanes.shape[0]):
        lane = lanes[k]
        ray = packet + 8 * lane
        for axis in range(3):
            store(ray + ORIGIN + ROW * axis, origins[k, axis])
            store(ray + LIGHT + ROW * axis, 1.0)
            store(ray + LIGHT_REST + ROW * axis, 0.0)
        put_direction(packet, lane, directions[k, 0], directions[k, 1], directions[k, 2])
        store(ray + T_BEST, ends[k])
        store(ray + SKIP, _int64(skips[k]))
        store(ray + PRIMITIVE, _int64(-1))
        store(ray + WEIGHT_1, 0.0)
        store(ray + WEIGHT_2, 0.0)
        active |= int64(1) << lane
    return active


@kernel
def _follow(tree, memory, rays, lanes, mode, way, budget, table, face_material, numbers, primitives):
    """One packet; ``numbers`` (n, 6) takes t, u, v and the light."""
    origins, directions, ends, skips = rays
    packet = (address_of(memory) + 63) & ~63
    active = _put_rays(packet, origins, directions, ends, skips, lanes)
    base, kt, faces = address_of(tree), address_of(table), address_of(face_material)
    ended = int64(0)
    left = active
    if way == 0:
        ended = trace_bundle(base, packet, active, mode, kt, faces, int64(24))
        left = int64(0)
    elif way == 1:
        ended, left = trace_packet(base, packet, active, mode, kt, faces, int64(24), int64(UNLIMITED))
    elif way == 3:
        ended, left = trace_packet(base, packet, active, mode, kt, faces, int64(24), int64(budget))
    if left != 0:
        ended |= trace_alone(base, packet, left, mode, kt, faces, int64(24))
    for k in range(lanes.shape[0]):
        ray = packet + 8 * lanes[k]
        numbers[k, 0] = load(_float64, ray + T_BEST)
        numbers[k, 1] = load(_float64, ray + WEIGHT_1)
        numbers[k, 2] = load(_float64, ray + WEIGHT_2)
        for channel in range(3):
            numbers[k, 3 + channel] = load(_float64, ray + LIGHT + ROW * channel)
        primitives[k] = load(_int64, ray + PRIMITIVE)
    return ended


def axis_of(directions):
    """Return what AXIS holds: 2 kz + (1 where d.kz < 0), z before y before x where equal."""
    size = np.abs(directions)
    kz = np.where((size[:, 2] >= size[:, 0]) & (size[:, 2] >= size[:, 1]), 2, np.where(size[:, 1] >= size[:, 0], 1, 0))
    return 2 * kz + (directions[np.arange(len(directions)), kz] < 0)


def clutter(seed=0):
    """Memory of a packet full of numbers that mean nothing."""
    rng = np.random.default_rng(seed)
    return rng.choice([-1.0, 1.0], RAY_ROWS * PACKET + 8) * 10.0 ** rng.uniform(-20, 20, RAY_ROWS * PACKET + 8)


def _rays(origins, directions, ends, skips):
    n = len(origins)
    return (
        np.ascontiguousarray(origins, np.float64),
        np.ascontiguousarray(directions, np.float64),
        np.ascontiguousarray(np.broadcast_to(ends, n), np.float64),
        np.ascontiguousarray(np.broadcast_to(skips, n), np.int64),
    )


def follow(
    tree, origins, directions, ends=np.inf, skips=-1, *, mode="closest", way="bundle", size=PACKET, kt=None, seed=0
):
    """Trace rays ``size`` at a time, in lanes drawn at random.

    ``way``: through `trace_bundle`; through `trace_packet`, whoever has the same axis together; through `trace_alone`;
    or through `trace_packet` until it has cost a little work, drawn at random, and then `trace_alone`. ``kt`` is
    (n_faces, 3), for "shade".
    """
    n = len(origins)
    rng = np.random.default_rng(seed)
    origins, directions, ends, skips = _rays(origins, directions, ends, skips)
    table = np.ones((1, 3)) if kt is None else np.ascontiguousarray(kt, np.float64)
    face_material = np.arange(len(table), dtype=np.int32)
    numbers, primitives, ended = np.empty((n, 6)), np.empty(n, np.int64), np.zeros(n, bool)
    kind = axis_of(directions) if way in {"packet", "given up"} else np.zeros(n, int)
    number = int64(WAYS.index(way))
    memory = clutter(seed)
    for which in np.unique(kind):
        chosen = np.flatnonzero(kind == which)
        for start in range(0, len(chosen), size):
            k = chosen[start : start + size]
            lanes = np.sort(rng.permutation(PACKET)[: len(k)]) if len(k) < PACKET else np.arange(PACKET)
            some_numbers, some_primitives = np.empty((len(k), 6)), np.empty(len(k), np.int64)
            rays = (origins[k], directions[k], ends[k], skips[k])
            bits = _follow(
                tree.buffer,
                memory,
                rays,
                lanes,
                MODES[mode],
                number,
                rng.integers(0, 99),
                table,
                face_material,
                some_numbers,
                some_primitives,
            )
            numbers[k], primitives[k] = some_numbers, some_primitives
            ended[k] = (np.int64(bits) >> lanes) & 1
            assert bits == 0 or (np.int64(bits) & ~np.bitwise_or.reduce(np.int64(1) << lanes)) == 0
    return Answers(numbers[:, 0], primitives, numbers[:, 1], numbers[:, 2], ended, numbers[:, 3:])


@kernel
def _brute_light(vertices, faces, rays, kt, light, counts):
    """Every face against every ray by the scalar predicate: product of kt, and how many are met."""
    origins, directions, ends, skips = rays
    for i in range(origins.shape[0]):
        kx, ky, kz, sx, sy, sz = shear_of(directions[i, 0], directions[i, 1], directions[i, 2])
        for f in range(faces.shape[0]):
            if f == skips[i]:
                continue
            a, b, c, _ = sorted_order(vertices, faces[f, 0], faces[f, 1], faces[f, 2])
            met, t, _u, _v, _w = intersect_triangle(
                vertices[a, kx], vertices[a, ky], vertices[a, kz],
                vertices[b, kx], vertices[b, ky], vertices[b, kz],
                vertices[c, kx], vertices[c, ky], vertices[c, kz],
                origins[i, kx], origins[i, ky], origins[i, kz], sx, sy, sz,
            )  # fmt: skip
            if met and 0.0 < t < ends[i]:
                counts[i] += 1
                for channel in range(3):
                    light[i, channel] *= kt[f, channel]


def brute_light(vertices, faces, origins, directions, ends=np.inf, skips=-1, kt=None):
    """Return (light (n, 3), number of triangles met (n,)); powers of two for kt make the product exact."""
    n = len(origins)
    rays = _rays(origins, directions, ends, skips)
    light, counts = np.ones((n, 3)), np.zeros(n, np.int64)
    table = np.zeros((len(faces), 3)) if kt is None else np.ascontiguousarray(kt, np.float64)
    _brute_light(
        np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32), rays, table, light, counts
    )
    return light, counts


# --- whole scenes, as the integrator asks them ----------------------------------------------------------------------


@kernel
def _scene_closest(scene, memory, rays, start, end, t, primitive, uv):
    origins, directions, ends, skips = rays
    view = view_scene(scene, stack_memory(VIEW_BYTES))
    packet = (address_of(memory) + 63) & ~63
    stack = np.empty(MAX_DEPTH + 4, np.int64)
    o, d = pointer(origins), pointer(directions)
    lanes = np.arange(end - start)
    active = _put_rays(packet, origins[start:end], directions[start:end], ends[start:end], skips[start:end], lanes)
    trace_scene(view, address_of(scene.trees), packet, active, int64(CLOSEST), int64(0), int64(0), int64(0))
    for lane in range(end - start):
        ray, k = packet + 8 * lane, start + lane
        there, what = load(_float64, ray + T_BEST), load(_int64, ray + PRIMITIVE)
        hit = closest_shape(view, at(o, 3 * k), at(d, 3 * k), skips[k], there, what, pointer(stack))
        t[k] = hit.t
        primitive[k] = hit.primitive
        if 0 <= hit.primitive < view.n_triangles:
            uv[k, 0] = load(_float64, ray + WEIGHT_1)
            uv[k, 1] = load(_float64, ray + WEIGHT_2)


@kernel
def _scene_light(scene, memory, rays, start, end, light):
    origins, directions, ends, skips = rays
    view = view_scene(scene, stack_memory(VIEW_BYTES))
    packet = (address_of(memory) + 63) & ~63
    stack = np.empty(MAX_DEPTH + 4, np.int64)
    o, d = pointer(origins), pointer(directions)
    lanes = np.arange(end - start)
    active = _put_rays(packet, origins[start:end], directions[start:end], ends[start:end], skips[start:end], lanes)
    kt = address_of(scene.materials) + 8 * MATERIAL_KT
    faces, stride = address_of(scene.face_material), int64(8 * N_MATERIAL)
    dark = trace_scene(view, address_of(scene.trees), packet, active, int64(SHADE), kt, faces, stride)
    for lane in range(end - start):
        ray, k = packet + 8 * lane, start + lane
        left = Vec3(
            load(_float64, ray + LIGHT), load(_float64, ray + LIGHT + ROW), load(_float64, ray + LIGHT + 2 * ROW)
        )
        if (dark >> lane) & 1 == 0:
            left = shade_by_shapes(view, at(o, 3 * k), at(d, 3 * k), ends[k], skips[k], left, pointer(stack))
        light[k, 0], light[k, 1], light[k, 2] = left.x, left.y, left.z


class SceneHits(NamedTuple):
    """What n rays met first in a scene."""

    t: np.ndarray
    primitive: np.ndarray
    uv: np.ndarray


def find_closest(scene, origins, directions, skips=-1):
    """Find the nearest primitive of each ray, 64 rays at a time."""
    n = len(origins)
    rays = _rays(origins, directions, np.inf, skips)
    hits = SceneHits(np.empty(n), np.empty(n, np.int64), np.zeros((n, 2)))
    memory = clutter()
    for start in range(0, n, PACKET):
        _scene_closest(scene, memory, rays, start, min(n, start + PACKET), *hits)
    return hits


def find_light(scene, origins, directions, ends=np.inf, skips=-1):
    """Share of light (n, 3) that comes through in 0 < t < end, 64 rays at a time."""
    n = len(origins)
    rays = _rays(origins, directions, ends, skips)
    light = np.empty((n, 3))
    memory = clutter()
    for start in range(0, n, PACKET):
        _scene_light(scene, memory, rays, start, min(n, start + PACKET), light)
    return light


def tree_of(vertices, faces, dtype=np.float64):
    """Build a wide tree whose leaves hold numbers of a type."""
    return build_wide(np.asarray(vertices, dtype), np.asarray(faces, np.int32))
