"""Rendering in process, for measurements: through the backend seam, without files or farm.

Invariant: what is timed is the kernel alone: compilation of scene and code happens before.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.data import DATA
from tracer.render import Film, get_backend, list_blocks, render_scene
from tracer.scene import AssetRef, parse_scene
from tracer.types import BLOCK_PX, CompiledScene


def resolver(folder: Path) -> Any:
    """Return an AssetResolver: files relative to a folder, or to SMALTI_DATA."""

    def resolve(ref: AssetRef) -> Path:
        near = folder / ref.file
        return near if near.is_file() else DATA / ref.file

    return resolve


def render_film(doc: Mapping[str, Any], folder: Path = Path()) -> Film:
    """Return the film of a scene document: pixels float32 (height, width, 3), linear; kernel_s in CPU seconds."""
    return render_scene(parse_scene(doc), resolver(folder), threads=2)


def compile_document(doc: Mapping[str, Any], folder: Path = Path()) -> CompiledScene:
    """Return the compiled scene."""
    return get_backend().compile(parse_scene(doc), resolver(folder))


def render_sums(compiled: CompiledScene, width: int, height: int, samples: int) -> tuple[NDArray[np.float64], float]:
    """Return the mean of the samples, float64 (height, width, 3), and the CPU seconds of this thread's kernel."""
    columns, rows = -(-width // BLOCK_PX), -(-height // BLOCK_PX)
    blocks = list_blocks(compiled)
    start = time.thread_time()
    film = get_backend().render(compiled, blocks, (0, samples), np.zeros(1, dtype=np.int64))
    seconds = time.thread_time() - start
    tiles = film.sums.sum(axis=1).reshape(rows, columns, BLOCK_PX, BLOCK_PX, 3)
    picture = tiles.transpose(0, 2, 1, 3, 4).reshape(rows * BLOCK_PX, columns * BLOCK_PX, 3)
    return picture[:height, :width] / samples, seconds
