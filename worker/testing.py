"""A renderer for tests of the farm: instant or slow, faithful or faulty, as the scene's title says.

Job: stand in for the tracer, so that tests of faults need no kernels and last seconds.
Invariant: a pixel's sums depend on its position and on the scene's seed alone, as with the real one; so pictures of a
run with faults and of one without are compared by their hash.

The title (``"name"``) of the scene holds settings, ``"fake tile_s=0.05 fail_tile=3"``:

=============== ========================================================================================
tile_s          seconds that a tile takes, polling the cancel flag each millisecond
prepare_s       seconds that compiling takes
fail_prepare    "scene": a scene error; "error": an exception
fail_tile       index of the block column of a tile (its left edge / 16) in the top row that raises always
flaky           path of a file: a tile raises while the file does not exist, creating it
crash_block     "bx,by": the worker that renders this block dies by SIGKILL
crash_once      path of a file: `crash_block` kills only while the file does not exist, creating it
=============== ========================================================================================
"""

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.scene import AssetResolver, SceneDoc
from tracer.scene.assets import asset_ref
from tracer.types import COUNTERS, FilmBlocks
from worker.backends import CanceledError, SceneFaultError

RAYS_PER_SAMPLE = 3


class FakeBackend:
    """Renders a pattern of the pixel's position; chosen by the setting ``backend="fake"``."""

    name = "fake"
    arithmetic = "fake-v1"

    def warm(self) -> None:
        """Nothing to compile."""

    def compile(self, scene: SceneDoc, assets: AssetResolver, cache: Path) -> tuple[Any, Mapping[str, Any]]:
        """Return the settings in the scene's title; assets are resolved and must be files."""
        del cache
        title = scene.name or ""
        settings = dict(word.split("=", 1) for word in title.split()[1:] if "=" in word)
        settings["seed"] = str(scene.sampling.seed)
        time.sleep(float(settings.get("prepare_s", 0.0)))
        if settings.get("fail_prepare") == "scene":
            raise SceneFaultError("scene-invalid", "The scene cannot be rendered", "it asked for it", pointer="/scene")
        if settings.get("fail_prepare") == "error":
            raise RuntimeError("it asked for it")
        for name, asset in scene.assets.items():
            if not assets(asset_ref(scene, name)).is_file():
                raise SceneFaultError("asset-invalid", "A file cannot be read", asset.file, file=asset.file)
        return settings, {"load_s": 0.0, "build_s": 0.0, "triangles": 0, "bytes": 0, "warnings": []}

    def render(
        self,
        compiled: Any,
        blocks: NDArray[np.int32],
        sample_range: tuple[int, int],
        cancel: NDArray[np.int64],
    ) -> FilmBlocks:
        """Return ``sample count * pattern(x, y, seed)`` split evenly between the halves."""
        _misbehave(compiled, blocks)
        deadline = time.perf_counter() + float(compiled.get("tile_s", 0.0))
        while True:
            if cancel[0]:
                raise CanceledError
            remaining = deadline - time.perf_counter()
            if remaining <= 0.0:
                break
            time.sleep(min(0.001, remaining))
        n_samples = sample_range[1] - sample_range[0]
        local = np.arange(16)
        x = (blocks[:, 0, None, None] * 16 + local[None, None, :]).astype(np.float64)
        y = (blocks[:, 1, None, None] * 16 + local[None, :, None]).astype(np.float64)
        seed = float(compiled["seed"])
        pattern = np.stack(
            [
                np.modf(np.abs(np.sin(x * a + y * b + seed)) * 43758.5453)[0]
                for a, b in ((12.9, 78.2), (3.1, 9.7), (7, 1))
            ],
            axis=-1,
        )
        sums = np.repeat(pattern[:, None] * (n_samples / 2.0), 2, axis=1)
        counters = np.zeros(len(COUNTERS), np.int64)
        counters[COUNTERS.index("samples")] = n_samples * 256 * len(blocks)
        counters[COUNTERS.index("primary_rays")] = RAYS_PER_SAMPLE * n_samples * 256 * len(blocks)
        halves = np.array([(n_samples + 1) // 2, n_samples // 2], np.int64)
        return FilmBlocks(np.ascontiguousarray(sums), halves, counters)


def _misbehave(settings: Mapping[str, str], blocks: NDArray[np.int32]) -> None:
    """Fail as the settings say, if these blocks are the ones."""
    if "fail_tile" in settings and any(by == 0 and bx == int(settings["fail_tile"]) for bx, by in blocks):
        raise RuntimeError("it asked for it")
    if "flaky" in settings and _is_first(Path(settings["flaky"])):
        raise RuntimeError("only this once")
    if "crash_block" in settings:
        block = [int(part) for part in settings["crash_block"].split(",")]
        is_here = any(list(map(int, one)) == block for one in blocks)
        if is_here and ("crash_once" not in settings or _is_first(Path(settings["crash_once"]))):
            os.kill(os.getpid(), signal.SIGKILL)


def _is_first(path: Path) -> bool:
    """Create a file; whether this call did it."""
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True
