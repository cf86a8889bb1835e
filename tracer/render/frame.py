"""A whole picture in this process: the same blocks, sums and pixels as the farm's, without queue and store."""

import threading
import time
from collections.abc import Callable
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.film.develop import develop_blocks
from tracer.film.tile import Rect, blocks_of_rect, grid_of_blocks
from tracer.render.backend import Backend, Canceled, get_backend
from tracer.render.cache import compile_cached
from tracer.render.compile import CompileStats, compile_scene
from tracer.scene import AssetResolver, SceneDoc
from tracer.types import (
    BLOCK_PX,
    COUNTERS,
    SETTING_CROP_HEIGHT,
    SETTING_CROP_WIDTH,
    SETTING_CROP_X,
    SETTING_CROP_Y,
    SETTING_SAMPLES,
    CompiledScene,
)

_CHUNK_BLOCKS: Final = 64  # blocks of one call, rounded to whole rows: enough to forget the call's cost


class Progress(NamedTuple):
    """How far a render is."""

    blocks_done: int
    blocks_total: int
    rays: int  # of all kinds, so far
    seconds: float  # since rendering began


class Film(NamedTuple):
    """A finished picture."""

    pixels: NDArray[np.float32]  # (height, width, 3) linear RGB of the crop (or the full image), not clamped
    window: tuple[int, int, int, int]  # x, y, width, height of the crop in the full image, pixels from the top left
    n_samples: int
    counters: dict[str, int]  # COUNTERS
    kernel_s: float  # seconds inside kernels, summed over threads
    wall_s: float  # seconds of rendering
    stats: CompileStats


def list_blocks(compiled: CompiledScene) -> NDArray[np.int32]:
    """Coordinates of the blocks that the crop touches, by rows.

    Returns
    -------
    int32 (n, 2)
    """
    return blocks_of_rect(Rect(*window_of(compiled)))


def window_of(compiled: CompiledScene) -> tuple[int, int, int, int]:
    """Return the rendered window (x, y, width, height), absolute pixels."""
    names = (SETTING_CROP_X, SETTING_CROP_Y, SETTING_CROP_WIDTH, SETTING_CROP_HEIGHT)
    x, y, width, height = (int(compiled.settings[name]) for name in names)
    return x, y, width, height


def render_compiled(
    compiled: CompiledScene,
    *,
    stats: CompileStats | None = None,
    cancel: NDArray[np.int64] | None = None,
    progress: Callable[[Progress], None] | None = None,
    threads: int = 1,
    backend: Backend | None = None,
) -> Film:
    """Render all of a compiled scene; parameters as for :func:`render_scene`."""
    backend = backend or get_backend()
    flag = np.zeros(1, np.int64) if cancel is None else cancel
    x0, y0, width, height = window_of(compiled)
    n_rows, n_columns = grid_of_blocks(Rect(x0, y0, width, height))
    n_samples = int(compiled.settings[SETTING_SAMPLES])
    pixels = np.empty((height, width, 3), np.float32)
    counters = np.zeros(len(COUNTERS), np.int64)
    rays = [i for i, name in enumerate(COUNTERS) if name.endswith("_rays")]
    step = max(1, _CHUNK_BLOCKS // n_columns)  # rows of blocks
    lock = threading.Lock()
    kernel_s = 0.0
    done = 0
    start = time.perf_counter()

    def render_chunk(first: int) -> None:
        nonlocal kernel_s, done
        top, bottom = (max(y0, BLOCK_PX * row) for row in (first, first + step))
        rect = Rect(x0, top, width, min(bottom, y0 + height) - top)
        chunk = blocks_of_rect(rect)
        began = time.thread_time()
        film = backend.render(compiled, chunk, (0, n_samples), flag)
        spent = time.thread_time() - began
        pixels[top - y0 : top - y0 + rect.height] = develop_blocks(rect, film.sums, n_samples)
        with lock:
            counters[:] += film.counters
            kernel_s += spent
            done += len(chunk)
            if progress is not None:
                progress(Progress(done, n_rows * n_columns, int(counters[rays].sum()), time.perf_counter() - start))

    firsts = range(y0 // BLOCK_PX, y0 // BLOCK_PX + n_rows, step)
    if threads <= 1:
        for first in firsts:
            render_chunk(first)
    else:
        with ThreadPool(threads) as pool:
            try:
                for _ in pool.imap_unordered(render_chunk, firsts):
                    pass
            except BaseException:
                # Let the other threads leave their kernels soon; a flag of the caller's own is his to see.
                flag[0] = 1
                pool.close()
                pool.join()
                raise
    return Film(
        pixels,
        (x0, y0, width, height),
        n_samples,
        dict(zip(COUNTERS, counters.tolist(), strict=True)),
        kernel_s,
        time.perf_counter() - start,
        stats or CompileStats(),
    )


def render_scene(
    scene: SceneDoc,
    assets: AssetResolver,
    *,
    cancel: NDArray[np.int64] | None = None,
    progress: Callable[[Progress], None] | None = None,
    threads: int = 1,
    cache_dir: Path | None = None,
) -> Film:
    """Compile and render a scene in this process.

    Parameters
    ----------
    scene : SceneDoc
    assets : AssetResolver
    cancel : int64 (1,) or None
        Another thread sets it to non-zero to stop the render.
    progress : callable or None
        Called now and then with a :class:`Progress`, from any of the threads, one at a time.
    threads : int
        Threads that render; the kernels do not hold the GIL. The picture is the same for any number.
    cache_dir : Path or None
        Compiled scenes are kept there; None compiles anew.

    Returns
    -------
    Film
        Its pixels are, bit for bit, those of the farm.

    Raises
    ------
    Canceled
        The flag was set.
    SceneError, LoadError
        As the backend's `compile`.
    """
    backend = get_backend()
    if cancel is not None and cancel[0] != 0:
        raise Canceled
    if cache_dir is None:
        compiled, stats = compile_scene(scene, assets)
    else:
        compiled, stats = compile_cached(scene, assets, cache_dir, backend)
    return render_compiled(compiled, stats=stats, cancel=cancel, progress=progress, threads=threads, backend=backend)
