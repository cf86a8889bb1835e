"""The farm's view of what renders.

Job: choose a backend by name and give it the three calls that tasks make; the tracer is imported only here and there
only when a worker asks, so that the API never loads it.
Invariant: tasks, store and queue know no backend by name.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tracer.scene import AssetResolver, SceneDoc
    from tracer.types import FilmBlocks


class CanceledError(Exception):
    """The cancel flag was raised while rendering."""


class SceneFaultError(Exception):
    """The scene cannot be rendered: the sender's fault, not the farm's.

    Attributes
    ----------
    kind
        Last part of the problem's type.
    title, detail
        For people.
    more
        Members of the problem beside these: pointer, file, errors.
    """

    def __init__(self, kind: str, title: str, detail: str, **more: Any) -> None:
        super().__init__(detail)
        self.kind, self.title, self.detail, self.more = kind, title, detail, more


class FarmBackend(Protocol):
    """What a worker needs of a renderer."""

    name: str
    arithmetic: str

    def warm(self) -> None:
        """Compile and load kernels, once a host."""

    def compile(self, scene: "SceneDoc", assets: "AssetResolver", cache: Path) -> tuple[Any, Mapping[str, Any]]:
        """Return the compiled scene and figures of its making (load_s, build_s, triangles, bytes, warnings).

        Raises `SceneFaultError`.
        """

    def render(
        self, compiled: Any, blocks: "NDArray[np.int32]", sample_range: tuple[int, int], cancel: "NDArray[np.int64]"
    ) -> "FilmBlocks":
        """Render blocks; raises `CanceledError` when ``cancel[0]`` is not 0."""


def load_backend(name: str) -> FarmBackend:
    """Return the backend of that name; ValueError for an unknown one."""
    if name == "fake":
        from worker.testing import FakeBackend

        return FakeBackend()
    if name == "cpu":
        from worker.tracing import TracerBackend

        return TracerBackend(name)
    raise ValueError(f"no backend {name!r}")
