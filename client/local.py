"""Everything that happens in this process instead of at a service: the one module of the client that knows `tracer`.

Invariant: the heavy imports (numba, OpenImageIO) happen inside the functions that need them.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from client.assets import PreparedScene
from client.errors import Fault, SceneInvalidError

if TYPE_CHECKING:
    from tracer.scene import SceneDoc


@dataclass(frozen=True, slots=True)
class KernelCache:
    """The folder of compiled kernels: how many files it holds, and their size in bytes."""

    folder: Path
    files: int
    size: int
    is_writable: bool


def parse_prepared(prepared: PreparedScene) -> "SceneDoc":
    """Parse a prepared scene into the tracer's document.

    Raises
    ------
    SceneInvalidError
        With every fault.
    """
    from tracer.scene import SceneError, parse_scene

    try:
        return parse_scene(prepared.document, require_hashes=True)
    except SceneError as error:
        faults = [Fault(*fault) for fault in error.faults]
        count = "a fault" if len(faults) == 1 else f"{len(faults)} faults"
        raise SceneInvalidError(f"the scene document has {count}", faults=faults) from error


def validate_document(prepared: PreparedScene) -> dict[str, Any]:
    """Check a scene here; returns what can be said without a service."""
    from tracer.scene import scene_hash

    scene = parse_prepared(prepared)
    image = scene.image
    return {
        "scene_sha256": scene_hash(scene),
        "image": {"width": image.width, "height": image.height},
        "samples_per_pixel": scene.sampling.samples,
    }


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema of scene documents."""
    from tracer.scene import json_schema

    return dict(json_schema())


def kernel_cache() -> KernelCache:
    """Look at the cache of compiled kernels of this version and CPU."""
    from tracer.jit import KERNEL_CACHE

    folder = Path(KERNEL_CACHE)
    sizes = [path.stat().st_size for path in folder.glob("**/*.nb[ic]")] if folder.is_dir() else []
    existing = next(parent for parent in (folder, *folder.parents) if parent.exists())
    return KernelCache(folder=folder, files=len(sizes), size=sum(sizes), is_writable=os.access(existing, os.W_OK))


def warm_kernels() -> float:
    """Compile all kernels into the cache, or load them; returns seconds."""
    from tracer.jit import warm

    return float(warm(lock=True))
