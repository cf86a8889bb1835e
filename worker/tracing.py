"""The real renderer behind the farm's view of one.

Job: call the tracer's backend seam, and turn its errors into problems that a client understands.
Invariant: the only module of the farm that imports the tracer's kernels and loaders.
See ARCHITECTURE.md, "Three seams".
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import structlog
from numpy.typing import NDArray

from tracer.loaders.errors import LoadError
from tracer.native.warm import compile_seconds, warm
from tracer.render import Canceled, compile_cached, get_backend
from tracer.render.cache import trim_cache
from tracer.scene import AssetResolver, SceneDoc, SceneError
from tracer.types import FilmBlocks
from worker.backends import CanceledError, SceneFaultError
from worker.tasks import scene_fault

log = structlog.get_logger()

MAX_CACHE_BYTES: Final = 20 * 10**9
"""Compiled scenes that this host keeps: hundreds of millions of triangles, or a thousand scenes of everyday size, and
a small part of any disk that holds a store. Nothing is lost beyond it: what is gone is compiled again."""


class TracerBackend:
    """A backend of `tracer.render`, by name."""

    def __init__(self, name: str) -> None:
        self._backend = get_backend(name)
        self.name = self._backend.name
        self.arithmetic = self._backend.arithmetic

    def warm(self) -> None:
        """Map the kernels' image; the first process of a host compiles it, while the others wait."""
        warm(lambda: log.info("compiling the kernels; this is needed once, and takes about a minute"))

    def compile(self, scene: SceneDoc, assets: AssetResolver, cache: Path) -> tuple[Any, Mapping[str, Any]]:
        """Compile a scene, or map the one that was compiled on this host before."""
        try:
            compiled, stats = compile_cached(scene, assets, cache / "scenes", self._backend)
        except SceneError as error:
            raise scene_fault(error) from error
        except LoadError as error:
            pointer = f"/scene{error.pointer}"
            fault = {"pointer": pointer, "detail": f"{error.file}: {error.reason}", "expected": error.mend}
            raise SceneFaultError(
                "asset-invalid",
                "A file of the scene cannot be used",
                str(error),
                file=error.file,
                pointer=pointer,
                errors=[fault],
            ) from error
        if not stats.from_cache:  # only then has the cache grown
            trim_cache(cache / "scenes", MAX_CACHE_BYTES)
        figures = {"triangles": stats.n_triangles, "bytes": stats.n_bytes, "kernels_compile_s": compile_seconds()}
        return compiled, {**stats._asdict(), **figures}

    def render(
        self,
        compiled: Any,
        blocks: NDArray[np.int32],
        sample_range: tuple[int, int],
        cancel: NDArray[np.int64],
    ) -> FilmBlocks:
        """Render blocks; the kernel polls the flag."""
        try:
            return self._backend.render(compiled, blocks, sample_range, cancel)
        except Canceled as error:
            raise CanceledError from error
