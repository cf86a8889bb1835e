"""What one beam says of all rays in it (:data:`tracer.rays.packet.SOLE`), against brute force on rays between.

A beam is spanned by four corner rays: from one origin through a parallelogram, or from a parallelogram to one point.
Rays between are drawn among those through the parallelogram, its rim and corners included. Of a beam from a
point that holds one triangle none may meet another one, and each passes within that one's edges; of an empty beam none
may meet anything. Where its corner rays first meet one triangle and end there, as the integrator asks, all between
first meet it, too. Of a beam that ends in a point (a lamp) and is darkened by a triangle all meet that one on their way.
"""

from typing import NamedTuple

import numpy as np

from tests.numerics.closed_meshes import by_brute_force
from tests.tracer.rays.packets import axis_of, put_direction
from tracer.jit import int64, kernel
from tracer.rays.leaf import CLOSEST
from tracer.rays.packet import ENDING, NONE, PENCIL, SOLE, UNLIMITED, trace_packet
from tracer.rays.rows import ORIGIN, PRIMITIVE, RAY_ROWS, ROW, SKIP, T_BEST, WEIGHT_2
from tracer.simd import address_of, load, store
from tracer.simd.gateway import types

_int64 = types.int64
BETWEEN = 16  # rays that each beam is held against
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
_CERTAIN_AXIS = 1.0 - 2.0**-30


class Beams(NamedTuple):
    """n beams: rays of index (beam, corner or ray between)."""

    origins: np.ndarray  # (n, 4 + BETWEEN, 3) the corners first
    directions: np.ndarray
    ends: np.ndarray  # (n,)


@kernel
def _ask(tree, memory, opaque, materials, origins, directions, ends, until_hit, answers):
    base, packet = address_of(tree), (address_of(memory) + 63) & ~63
    for beam in range(origins.shape[0]):
        for corner in range(4):
            ray = packet + 8 * corner
            for axis in range(3):
                store(ray + ORIGIN + axis * ROW, origins[beam, corner, axis])
            d = directions[beam, corner]
            put_direction(packet, corner, d[0], d[1], d[2])
            store(ray + T_BEST, ends[beam])
            store(ray + PRIMITIVE, int64(-1))
            store(ray + SKIP, int64(-1))
        answers[beam, 0] = -1
        if until_hit:
            trace_packet(base, packet, int64(15), int64(CLOSEST), int64(0), int64(0), int64(0), int64(UNLIMITED))
            face = load(_int64, packet + PRIMITIVE)
            alike = True
            for corner in range(4):
                alike = alike and load(_int64, packet + 8 * corner + PRIMITIVE) == face
            if not alike:
                face = int64(-1)
            answers[beam, 0] = face
        for corner in range(4):
            store(packet + 8 * corner + WEIGHT_2, 0.0)
        mode = int64(SOLE + PENCIL) if ends[beam] == np.inf else int64(SOLE + ENDING)
        answers[beam, 1] = trace_packet(
            base, packet, int64(15), mode, address_of(opaque), address_of(materials), int64(0), int64(UNLIMITED)
        )[0]


def span(origins, directions, rng):
    """Beams about some rays: from a point or to one, of widths from a rounding to half the way, shifted to touch."""
    n = len(origins)
    targets = origins + directions * rng.choice([0.5, 1.0, 2.0], (n, 1))
    size = np.abs(directions).max(1, keepdims=True)
    a, b = (rng.standard_normal((n, 3)) * size * 10.0 ** rng.uniform(-14, -0.5, (n, 1)) for _ in range(2))
    places = rng.uniform(-1, 1, (n, 4 + BETWEEN, 2))
    places[:, :4] = _CORNERS
    rim = rng.random((n, BETWEEN, 2)) < 0.2
    places[:, 4:][rim] = np.sign(places[:, 4:][rim])
    shift = rng.choice([0.0, 1.0, 1.0 + 2.0**-30, 1.0 + 2.0**-10, 1.5], (n, 1, 2)) * rng.choice([-1.0, 1.0], (n, 1, 2))
    offsets = (places + shift) @ np.stack([a, b], 1)
    to_point = (rng.random(n) < 0.5)[:, None, None]
    starts = origins[:, None] + np.where(to_point, offsets, 0.0)
    finishes = targets[:, None] + np.where(to_point, 0.0, offsets)
    ways = finishes - starts
    ends = np.where(to_point[:, 0, 0], 1.0, np.inf)
    axis = axis_of(ways.reshape(-1, 3)).reshape(n, -1)
    sorted_sizes = np.sort(np.abs(ways), axis=2)
    slopes = sorted_sizes[..., 1] / np.maximum(sorted_sizes[..., 2], 1e-300)
    keep = (axis == axis[:, :1]).all(1) & (slopes < _CERTAIN_AXIS).all(1)
    return Beams(starts[keep], ways[keep], ends[keep])


def answers_of(tree, n_faces, beams, *, until_hit):
    """What is said of each beam: (face that all corner rays first meet or -1, answer of SOLE); all faces are opaque."""
    answers = np.empty((len(beams.ends), 2), np.int64)
    memory = np.zeros(RAY_ROWS * 64 + 8)
    opaque, materials = np.zeros(3), np.zeros(n_faces, np.int32)
    _ask(tree, memory, opaque, materials, beams.origins, beams.directions, beams.ends, until_hit, answers)
    return answers


def wrong_answers(tree, vertices, faces, beams):
    """Count (wrong answers, answers that told something)."""
    n = len(beams.ends)
    if n == 0:
        return 0, 0
    wrong = told = 0
    corners = np.sort(vertices[faces].reshape(len(faces), 3, 3), axis=1)
    for until_hit in (False, True):
        answers = answers_of(tree, len(faces), beams, until_hit=until_hit)
        for k in range(n):
            hit, sole = answers[k]
            ending = np.isfinite(beams.ends[k])
            if sole < NONE or (until_hit and (ending or hit < 0 or sole != hit)):
                continue
            told += 1
            o, d = beams.origins[k], beams.directions[k]
            _, first, counts = by_brute_force(vertices, faces, o, d, 0.0, beams.ends[k])
            if sole == NONE:
                wrong += int((counts > 0).sum())
            elif ending:
                _, its, _ = by_brute_force(vertices, faces[sole : sole + 1], o, d, 0.0, beams.ends[k])
                wrong += int((its < 0).sum())
            elif until_hit:
                wrong += int((first != sole).sum())
            else:
                same = (corners == corners[sole]).all((1, 2))
                _, other, _ = by_brute_force(vertices, faces[~same], o, d, 0.0, beams.ends[k])
                _, its, _ = by_brute_force(vertices, faces[sole : sole + 1], o, d, -np.inf)
                wrong += int(((other >= 0) | (its < 0)).sum()) + int(same[:sole].any())
    return wrong, told
