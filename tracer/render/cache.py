"""Compiled scenes on this host's disk: built once, mapped by every process.

Invariants: an entry is named by everything that decides its bytes (scene with the hashes of its files, sources of
the whole tracer, arithmetic of the backend), so it never goes stale and may be deleted at any time; it
appears whole, by a rename; one process builds while the others wait (flock); a damaged entry is built again.

Layout of the cache's folder: `scenes/<key>.arrays`, `files/<key>.arrays` (loaded models and images, so that another
camera or material does not load them again), `bvh/<key>.arrays` (trees by the geometry's own hash), `locks/`.
"""

import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tracer.accel import build_tree
from tracer.accel.wide import geometry_key
from tracer.arrayfile import ArrayFileError, load_arrays, save_arrays
from tracer.render.compile import CompileStats, compile_scene
from tracer.render.sources import SceneFiles
from tracer.scene import AssetResolver, SceneDoc, scene_hash
from tracer.types import CompiledScene, check_layout

_MIN_CACHED_BVH_TRIANGLES: Final = 2_000
"""Below, building a tree is faster than hashing, writing and syncing it."""
_ABANDONED_S: Final = 3600.0
"""A file that was begun so long ago and has no name yet: whoever wrote it is dead, for writing takes seconds."""


class HasArithmetic(Protocol):
    """What the cache asks of a backend."""

    @property
    def name(self) -> str:
        """Name of the backend."""

    @property
    def arithmetic(self) -> str:
        """Class of its arithmetic."""


@lru_cache(maxsize=1)
def builder_version() -> str:
    """Hash of the tracer's sources, and of the versions of the libraries that read models.

    All sources, because a list of those that matter would one day lack one. Takes 5 ms, once a process.
    """
    folder = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for source in sorted(folder.glob("**/*.py")):
        digest.update(source.relative_to(folder).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    for package in ("numpy", "trimesh", "Pillow", "mapbox-earcut"):
        digest.update(f"{package} {metadata.version(package)}\n".encode())
    return digest.hexdigest()[:16]


def compile_cached(
    scene: SceneDoc,
    assets: AssetResolver,
    cache_dir: Path,
    backend: HasArithmetic,
    *,
    scene_sha256: str | None = None,
) -> tuple[CompiledScene, CompileStats]:
    """Return the compiled scene, from the cache if it is there.

    Parameters
    ----------
    scene : SceneDoc
        Cached when every file that it needs has its hash in the document; compiled anew otherwise.
    assets : AssetResolver
        Asked only when something has to be loaded.
    cache_dir : Path
        Created if absent.
    backend : HasArithmetic
        Whose arithmetic stands in the key.
    scene_sha256 : str or None
        `scene_hash(scene)`, when it is known already.

    Returns
    -------
    CompiledScene
        Arrays of a copy-on-write map; `CompileStats.from_cache` tells whether it was there.

    Raises
    ------
    SceneError, LoadError
        As `compile_scene`; errors are not cached.
    """
    cache_dir = Path(cache_dir)
    files = SceneFiles(cache=cache_dir / "files", version=builder_version())
    build = _tree_builder(cache_dir / "bvh")
    if not _is_reproducible(scene):
        return compile_scene(scene, assets, SceneFiles(), build)
    text = "\n".join((scene_sha256 or scene_hash(scene), builder_version(), backend.name, backend.arithmetic))
    key = hashlib.sha256(text.encode()).hexdigest()
    path = cache_dir / "scenes" / f"{key}.arrays"
    found = _open_scene(path)
    if found is not None:
        return found
    with _locked(cache_dir / "locks" / key[:16]):
        found = _open_scene(path)  # whoever held the lock before has built it
        if found is not None:
            return found
        compiled, stats = compile_scene(scene, assets, files, build)
        with suppress(OSError):  # a full disk is no reason to fail here
            path.parent.mkdir(parents=True, exist_ok=True)
            save_arrays(path, compiled._asdict(), {"stats": stats._asdict()}, durable=True)
    # The mapped copy, not the built one: then every process has its arrays from the same place.
    mapped = _open_scene(path)
    return (mapped[0], stats) if mapped is not None else (compiled, stats)


def _is_reproducible(scene: SceneDoc) -> bool:
    """Whether the document names the content of all its files."""
    return all(asset.sha256 is not None for asset in scene.assets.values())


def _open_scene(path: Path) -> tuple[CompiledScene, CompileStats] | None:
    """Map an entry; None when it is absent or damaged."""
    try:
        arrays, meta = load_arrays(path)
        compiled = CompiledScene(**arrays)
        check_layout(compiled)
        stats: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in meta["stats"].items()}
        found = CompileStats(**{**stats, "from_cache": True})
    except (OSError, ArrayFileError, KeyError, TypeError, ValueError):
        return None
    with suppress(OSError):
        os.utime(path)  # `trim_cache` lets go of what was not used for the longest time
    return compiled, found


def _tree_builder(folder: Path) -> Callable[..., NDArray[np.int64]]:
    """Return `build_tree`, with large trees kept by the hash of what they are built from."""

    def build(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.int64]:
        if len(faces) < _MIN_CACHED_BVH_TRIANGLES:
            return build_tree(vertices, faces)
        text = f"{builder_version()} {geometry_key(vertices, faces)}"
        path = folder / f"{hashlib.sha256(text.encode()).hexdigest()}.arrays"
        with suppress(OSError, ArrayFileError, KeyError):
            tree: NDArray[np.int64] = load_arrays(path)[0]["tree"]
            with suppress(OSError):
                os.utime(path)
            return tree
        tree = build_tree(vertices, faces)
        with suppress(OSError):  # a full disk is no reason to fail here
            path.parent.mkdir(parents=True, exist_ok=True)
            save_arrays(path, {"tree": tree}, {}, durable=True)
        return tree

    return build


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock between processes; the kernel lets go of it when its holder dies.

    Where no lock can be had (a folder that cannot be written), work is done twice, and nothing else is lost.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context(path.open("ab")), fcntl.LOCK_EX)
        yield


def trim_cache(cache_dir: Path, max_bytes: int) -> int:
    """Delete the entries that were not used for the longest time until the rest fits, and what dead processes began.

    Processes that have an entry mapped keep it: the file goes when the last of them lets go.

    Returns
    -------
    int
        Bytes that were freed.
    """
    freed = 0
    for path in Path(cache_dir).glob("*/.*.part"):
        with suppress(OSError):
            status = path.stat()
            if time.time() - status.st_mtime > _ABANDONED_S:
                path.unlink()
                freed += status.st_size
    entries = []
    for path in Path(cache_dir).glob("*/*.arrays"):
        with suppress(OSError):
            status = path.stat()
            entries.append((status.st_mtime_ns, status.st_size, path))
    excess = sum(size for _, size, _ in entries) - max_bytes
    for _, size, path in sorted(entries):
        if excess <= 0:
            break
        with suppress(OSError):
            path.unlink()
            freed += size
            excess -= size
    return freed
