"""The files of one scene: which are needed, loaded in one guarded batch, each once.

Invariants: a file that no object needs is never opened; beside a file whose hash the document names, only the
companions whose hashes it names are opened, so that the document alone decides what is loaded.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tracer.arrayfile import ArrayFileError
from tracer.loaders.errors import LoadError
from tracer.loaders.guard import LoadRequest, load_guarded
from tracer.loaders.handover import open_image, open_mesh, save_image, save_mesh
from tracer.loaders.limits import DEFAULT_LIMITS, LoadLimits
from tracer.loaders.mesh import MeshData
from tracer.scene import AssetRef, AssetResolver, Mesh, MeshAsset, SceneDoc, asset_ref
from tracer.scene.faults import pointer_of


class SceneFiles:
    """Loads what a scene needs and hands it out by name.

    Parameters
    ----------
    limits : LoadLimits
    cache : Path or None
        Folder in which loaded files are kept by the hash of what they were loaded from; None keeps nothing.
    version : str
        Part of the cache's keys: the version of the loaders.
    """

    def __init__(self, limits: LoadLimits = DEFAULT_LIMITS, cache: Path | None = None, version: str = "") -> None:
        self._limits = limits
        self._cache = cache
        self._version = version
        self._meshes: dict[str, MeshData] = {}
        self._images: dict[str, NDArray[np.uint8]] = {}
        self._file_names: dict[str, str] = {}

    @property
    def used(self) -> set[str]:
        """Names of the assets that were opened."""
        return set(self._file_names)

    def mesh(self, name: str) -> MeshData:
        """Return a loaded mesh asset."""
        return self._meshes[name]

    def image(self, name: str) -> NDArray[np.uint8]:
        """Return a loaded image asset, uint8 (height, width, 3)."""
        return self._images[name]

    def warnings(self) -> tuple[str, ...]:
        """Return what the loaders noted, each with the file's name."""
        return tuple(
            f"{self._file_names[name]}: {text}" for name, mesh in self._meshes.items() for text in mesh.warnings
        )

    def load(self, scene: SceneDoc, assets: AssetResolver) -> None:
        """Load every file that the scene needs.

        Raises
        ------
        LoadError
            Of the first file that cannot be used, with the place in the document that names it.
        """
        wanted = dict.fromkeys(_needs(scene))
        pointers: dict[tuple[str, str], str] = {}
        for kind, name, pointer in wanted:
            pointers.setdefault((kind, name), pointer)
        missing: list[tuple[str, str, AssetRef]] = []
        for kind, name in pointers:
            ref = asset_ref(scene, name)
            self._file_names[name] = ref.file
            if not self._take_from_cache(kind, ref):
                missing.append((kind, name, ref))
        requests = [LoadRequest(kind, assets(ref), ref.file, _companions(ref)) for kind, _, ref in missing]
        for (kind, name, ref), result in zip(missing, load_guarded(requests, self._limits), strict=True):
            if isinstance(result, LoadError):
                raise result.at(pointers[kind, name])
            if isinstance(result, MeshData):
                self._meshes[name] = result
            else:
                self._images[name] = result
            self._put_into_cache(kind, ref, result)

    def _cached_path(self, kind: str, ref: AssetRef) -> Path | None:
        """Return where a loaded file is kept; None when no hash says what it was loaded from."""
        if self._cache is None or ref.sha256 is None:
            return None
        named = sorted((name, digest or "") for name, digest in (ref.companions or {}).items())
        # The suffix decides the loader; the name stands in warnings and in the names of groups.
        text = repr((self._version, kind, Path(ref.file).name, ref.sha256, named, tuple(self._limits)))
        return self._cache / f"{hashlib.sha256(text.encode()).hexdigest()}.arrays"

    def _take_from_cache(self, kind: str, ref: AssetRef) -> bool:
        """Open a file that was loaded before; a damaged one is loaded again."""
        path = self._cached_path(kind, ref)
        if path is None:
            return False
        try:
            if kind == "mesh":
                self._meshes[ref.name] = open_mesh(path)
            else:
                self._images[ref.name] = open_image(path)
        except (OSError, ArrayFileError, KeyError):
            return False
        with suppress(OSError):
            os.utime(path)  # `trim_cache` lets go of what was not used for the longest time
        return True

    def _put_into_cache(self, kind: str, ref: AssetRef, loaded: MeshData | NDArray[np.uint8]) -> None:
        """Keep a loaded file; a full disk is no reason to fail."""
        path = self._cached_path(kind, ref)
        if path is None:
            return
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(loaded, MeshData):
                save_mesh(path, loaded, durable=True)
            else:
                save_image(path, loaded, durable=True)


def _companions(ref: AssetRef) -> list[str] | None:
    """Return what may be opened beside a file: with a hash, what has a hash; without one, its whole folder."""
    if ref.sha256 is None:
        return None
    return [name for name, digest in (ref.companions or {}).items() if digest is not None]


def _needs(scene: SceneDoc) -> Iterator[tuple[str, str, str]]:
    """Yield (kind, asset name, pointer) of every file that an object leads to."""
    used: dict[str, None] = {}
    for index, thing in enumerate(scene.objects):
        if isinstance(thing, MeshAsset):
            yield "mesh", thing.asset, f"/objects/{index}/asset"
        if thing.material is not None:
            used[thing.material] = None
        if isinstance(thing, Mesh | MeshAsset):
            used.update(dict.fromkeys((thing.materials or {}).values()))
    for name in used:
        described = scene.materials[name].diffuse_texture
        if described is not None:
            yield "image", described.asset, pointer_of("materials", name, "diffuse_texture", "asset")
