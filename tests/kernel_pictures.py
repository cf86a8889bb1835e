"""One document rendered twice, by the kernel and by the oracle, at the same sample positions."""

import json

import numpy as np

from tests import naive
from tests.naive_scenes import read_document
from tracer.render import get_backend
from tracer.sampling.sampler import sample_2d
from tracer.scene import parse_scene
from tracer.types import BLOCK_PX, SAMPLER_INDEPENDENT, SAMPLER_SOBOL, SAMPLER_STRATIFIED

SAMPLERS = {"independent": SAMPLER_INDEPENDENT, "stratified": SAMPLER_STRATIFIED, "sobol": SAMPLER_SOBOL}


def positions_at(sampling, pixels):
    """Return where the kernel takes the samples of some pixels, (n, 2) columns and rows: (2, n, samples) from the left and the top."""
    kind, seed, samples = SAMPLERS[sampling["sampler"]], sampling["seed"], sampling["samples"]
    result = np.empty((2, len(pixels), samples))
    for i, (x, y) in enumerate(np.asarray(pixels).tolist()):
        for k in range(samples):
            u, v = sample_2d(kind, seed, x, y, k, samples, 0)
            result[:, i, k] = x + u, y + v
    return result


def positions(doc):
    """Return where the kernel takes a document's samples: (2, height, width, samples) from the left and the top, in pixels."""
    width, height = doc["image"]["width"], doc["image"]["height"]
    pixels = [(x, y) for y in range(height) for x in range(width)]
    return positions_at(doc["sampling"], pixels).reshape(2, height, width, -1)


def render_kernel(doc, resolve=None):
    """Return the kernel's sums of a document's samples, float64 (height, width, 3)."""
    backend = get_backend()
    compiled = backend.compile(parse_scene(json.dumps(doc)), resolve)
    width, height, samples = doc["image"]["width"], doc["image"]["height"], doc["sampling"]["samples"]
    columns, rows = -(-width // BLOCK_PX), -(-height // BLOCK_PX)
    blocks = np.array([(x, y) for y in range(rows) for x in range(columns)], dtype=np.int32)
    film = backend.render(compiled, blocks, (0, samples), np.zeros(1, dtype=np.int64))
    tiles = film.sums.sum(axis=1).reshape(rows, columns, BLOCK_PX, BLOCK_PX, 3).transpose(0, 2, 1, 3, 4)
    return tiles.reshape(rows * BLOCK_PX, columns * BLOCK_PX, 3)[:height, :width]


def render_oracle(doc, textures=None):
    """Return the oracle's sums at the same positions."""
    scene = read_document(doc, textures)
    x, y = positions(doc)
    return naive.trace(scene, x, scene.height - y).reshape(*x.shape, 3).sum(axis=2)
