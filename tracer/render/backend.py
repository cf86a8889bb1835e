"""The backend seam: whoever can compile a scene and render blocks of it.

Invariants: one backend serves any number of threads; what it returns depends on its arguments alone;
`arithmetic` names its class of arithmetic and stands in the hash of every render. Today there is the CPU's.
"""

from functools import partial
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tracer.native.entries import entry
from tracer.remembered import Remembered
from tracer.render.adaptive import is_adaptive, render_adaptively
from tracer.render.compile import compile_scene
from tracer.scene import AssetResolver, SceneDoc
from tracer.types import BLOCK_PX, COUNTERS, SETTING_SAMPLES, CompiledScene, FilmBlocks, check_layout

render_blocks = entry("tracer.render.blocks.render_blocks")


class Canceled(Exception):  # noqa: N818 - not a fault: what was asked for
    """The cancel flag was set while rendering."""


class Backend(Protocol):
    """What the farm and `render_scene` know of a renderer."""

    name: str
    arithmetic: str

    def compile(self, scene: SceneDoc, assets: AssetResolver) -> CompiledScene:
        """Compile a scene document and its files.

        Raises
        ------
        SceneError, LoadError
        """

    def render(
        self,
        compiled: CompiledScene,
        blocks: NDArray[np.int32],
        sample_range: tuple[int, int],
        cancel: NDArray[np.int64],
    ) -> FilmBlocks:
        """Render blocks of a compiled scene.

        Parameters
        ----------
        compiled
            Of this backend.
        blocks : int32 (n, 2)
            Block coordinates (bx, by) in units of 16 px of the absolute image grid.
        sample_range
            Half-open range of sample indices; of a scene with adaptive sampling all.
        cancel : int64 (1,)
            Another thread sets it to non-zero to stop the render.

        Raises
        ------
        Canceled
            The flag was set.
        """


class CpuBackend:
    """Float64 kernels in lanes, one thread a call, without the GIL."""

    name: str = "cpu"
    arithmetic: str = "f64-v2"

    def __init__(self) -> None:
        self._checked = Remembered(())  # the scene of the last render

    def compile(self, scene: SceneDoc, assets: AssetResolver) -> CompiledScene:
        """Compile a scene document and its files; see :class:`Backend`."""
        return compile_scene(scene, assets)[0]

    def render(
        self,
        compiled: CompiledScene,
        blocks: NDArray[np.int32],
        sample_range: tuple[int, int],
        cancel: NDArray[np.int64],
    ) -> FilmBlocks:
        """Render blocks; see :class:`Backend`.

        Raises
        ------
        ValueError
            The arrays are not what the kernel reads, or the sample range is not within the scene's samples, or not all
            of them where sampling is adaptive.
        """
        if not self._checked.are(compiled):
            check_layout(compiled)
            self._checked = Remembered(compiled)
        # One numba type for arrays from memory and from memory-mapped files alike.
        fields: list[Any] = [np.asarray(field) for field in compiled]
        scene = CompiledScene(*fields)
        blocks = np.ascontiguousarray(blocks, np.int32)
        first, end = sample_range
        n_samples = int(scene.settings[SETTING_SAMPLES])
        if blocks.ndim != 2 or blocks.shape[1] != 2 or (len(blocks) and blocks.min() < 0):
            raise ValueError("blocks: expected non-negative int32 (n, 2)")
        if not 0 <= first < end <= n_samples:
            raise ValueError(f"sample range {sample_range}: expected within 0 .. {n_samples}")
        if cancel.dtype != np.int64 or cancel.shape != (1,):
            raise ValueError("cancel: expected int64 (1,)")
        take = partial(_take_samples, cancel)
        if not is_adaptive(scene):
            return take(scene, blocks, (first, end))
        if (first, end) != (0, n_samples):
            raise ValueError(f"sample range {sample_range}: expected all {n_samples} samples of an adaptive scene")
        return render_adaptively(take, scene, blocks)


def _take_samples(
    cancel: NDArray[np.int64], scene: CompiledScene, blocks: NDArray[np.int32], sample_range: tuple[int, int]
) -> FilmBlocks:
    """Take a range of samples of all pixels of some blocks."""
    first, end = sample_range
    sums = np.zeros((len(blocks), 2, BLOCK_PX, BLOCK_PX, 3))
    counters = np.zeros(len(COUNTERS), np.int64)
    if not render_blocks(scene, blocks, first, end, cancel, sums, counters):
        raise Canceled
    n_even = (end + 1) // 2 - (first + 1) // 2
    return FilmBlocks(sums, np.array([n_even, end - first - n_even], np.int64), counters)


_BACKENDS: Final[dict[str, type[CpuBackend]]] = {"cpu": CpuBackend}


def get_backend(name: str = "cpu") -> Backend:
    """Make a backend by name.

    Raises
    ------
    KeyError
        There is none of that name.
    """
    return _BACKENDS[name]()
