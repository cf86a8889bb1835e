"""Everything that happens in this process instead of at a service: the one module of the client that knows `tracer`.

Invariant: the heavy imports (numba, OpenImageIO) happen inside the functions that need them.
"""

import json
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from client.assets import PreparedScene, absent_error
from client.errors import AssetError, Fault, SceneInvalidError, SmaltiError
from client.models import Progress
from client.progress import show_progress

if TYPE_CHECKING:
    from tracer.render import Film
    from tracer.scene import SceneDoc, SceneError


CANCEL_S = 2.0  # kernels see the flag within milliseconds; a compilation sees nothing, and ends with the process


@dataclass(frozen=True, slots=True)
class KernelCache:
    """The compiled kernels of this version and CPU.

    Attributes
    ----------
    key : str
        Hash of what they are compiled from and for.
    folder : Path
        Where they are kept.
    image_bytes : int
        Size of the image that processes map; 0 where there is none.
    compile_s : float
        Seconds that its compilation took; 0 where that is not known.
    fault : str
        Why the image that is there cannot be used; usually empty.
    files, size : int
        Files of numba's own cache, and their bytes.
    is_writable : bool
        Whether an image can be written.
    """

    key: str
    folder: Path
    image_bytes: int
    compile_s: float
    fault: str
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
        raise scene_invalid(error) from error


def asset_suffixes() -> tuple[str, ...]:
    """Return the endings of the files that the loaders read: models and images."""
    from tracer.loaders.limits import IMAGE_FORMATS, MESH_SUFFIXES

    return (*MESH_SUFFIXES, *(f".{name.lower()}" for name in IMAGE_FORMATS), ".jpg")


def parse_text(text: bytes | str, label: str) -> dict[str, Any]:
    """Parse JSON text to plain values; what the text itself has wrong is told with all that the document has wrong.

    Raises
    ------
    SceneInvalidError
        With every fault, in the words of the service.
    """
    from tracer.scene import SceneError
    from tracer.scene.text import load_json, plain

    try:
        document, faults = plain(load_json(text))
        if faults or not isinstance(document, dict):
            from tracer.scene import parse_scene  # the models: not for a text that a service will check

            parse_scene(text)
    except SceneError as error:
        raise scene_invalid(error, label) from error
    return dict(document)


def scene_invalid(error: "SceneError", label: str = "the scene document") -> SceneInvalidError:
    """Return the client's error for a scene that the tracer refused."""
    faults = [Fault(*fault) for fault in error.faults]
    count = "a fault" if len(faults) == 1 else f"{len(faults)} faults"
    return SceneInvalidError(f"{label} has {count}", faults=faults)


def validate_document(prepared: PreparedScene) -> dict[str, Any]:
    """Check a scene and that its files are here; returns what can be said without a service.

    Raises
    ------
    SceneInvalidError, AssetError
        With every fault.
    """
    from tracer.scene import scene_hash

    scene = parse_prepared(prepared)
    if prepared.absent:
        raise absent_error(prepared, prepared.absent, asked=False)
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
    """Look at the compiled kernels of this version and CPU."""
    from tracer.native.warm import image_state

    state = image_state()
    folder = state.path.parent
    sizes = [path.stat().st_size for path in folder.glob("**/*.nb[ic]")] if folder.is_dir() else []
    existing = next(parent for parent in (folder, *folder.parents) if parent.exists())
    return KernelCache(
        key=state.key,
        folder=folder,
        image_bytes=state.n_bytes,
        compile_s=state.compile_s,
        fault=state.fault,
        files=len(sizes),
        size=sum(sizes),
        is_writable=os.access(existing, os.W_OK),
    )


def warm_kernels(on_compile: Callable[[], None] | None = None) -> float:
    """Map the compiled kernels, or compile them; returns seconds.

    Parameters
    ----------
    on_compile : callable, optional
        Called before anything is compiled.
    """
    from tracer.native.warm import warm

    return warm(on_compile)


def render_to_files(
    prepared: PreparedScene,
    targets: Mapping[str, Path],
    *,
    png_color_space: str = "srgb",
    threads: int | None = None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Render a scene in this process and write its pictures; the bytes are those of the service.

    Parameters
    ----------
    prepared : PreparedScene
        The scene and its files.
    targets : Mapping
        "png", "exr", "report" → file to write; its folder exists.
    png_color_space : str
        "srgb" or "linear".
    threads : int, optional
        Threads that render; one for each core by default.
    quiet : bool
        Without progress.

    Returns
    -------
    dict
        The report, in the words of the service's report as far as they fit.

    Raises
    ------
    SceneInvalidError, AssetError
        The scene or one of its files cannot be used.
    SmaltiError
        A picture cannot be written.
    """
    from tracer.film.errors import ImageWriteError
    from tracer.film.writer import FilmWriter

    scene = parse_prepared(prepared)
    film = _render(scene, prepared, threads or _n_cores(), quiet=quiet)
    x, y, width, height = film.window
    try:
        with FilmWriter(
            targets.get("exr"),
            targets.get("png"),
            width,
            height,
            crop_origin=(x, y),
            display_size=(scene.image.width, scene.image.height),
            png_color_space="linear" if png_color_space == "linear" else "srgb",
        ) as writer:
            writer.write_rows(film.pixels)
            film_sha256 = writer.close()
    except ImageWriteError as error:
        raise SmaltiError(str(error)) from error
    report = _report(scene, film, film_sha256)
    if "report" in targets:
        targets["report"].write_text(json.dumps(report, indent=1) + "\n", "utf-8")
    return report


def _n_cores() -> int:
    from client.doctor import n_cores

    return n_cores()


def _render(scene: "SceneDoc", prepared: PreparedScene, threads: int, *, quiet: bool) -> "Film":
    """Render in a thread of its own: Python sees Ctrl-C only outside kernels, so the main thread stays out of them."""
    import numpy as np

    from tracer.loaders.errors import LoadError
    from tracer.paths import cache_root
    from tracer.render import Canceled, render_scene
    from tracer.scene import AssetRef, SceneError

    cancel = np.zeros(1, np.int64)
    seen: list[Any] = []
    outcome: list[Film | BaseException] = []
    # Not `Thread.join`: until Python 3.13 an interrupted join takes a running thread for one that has ended.
    ended = threading.Event()

    def resolve(asset: AssetRef) -> Path:
        if asset.name not in prepared.files:
            raise absent_error(prepared, [str(asset.sha256)], asked=False)
        return prepared.files[asset.name].absolute()

    def work() -> None:
        try:
            outcome.append(
                render_scene(
                    scene,
                    resolve,
                    cancel=cancel,
                    progress=lambda now: seen.__setitem__(slice(None), [now]),
                    threads=threads,
                    cache_dir=cache_root() / "scenes",
                )
            )
        except BaseException as error:  # noqa: BLE001 - it is raised again in the main thread
            outcome.append(error)
        finally:
            ended.set()

    threading.Thread(target=work, name="smalti-render", daemon=True).start()
    try:
        with show_progress("", quiet=quiet, unit="blocks") as view:
            view.update("preparing", Progress())
            while not ended.wait(0.1):
                view.update(*_progress_of(seen))
            if isinstance(outcome[0], tuple):
                view.update("succeeded", _progress_of(seen)[1])
    except BaseException:
        cancel[0] = 1
        ended.wait(CANCEL_S)
        raise
    result = outcome[0]
    if isinstance(result, SceneError):
        raise scene_invalid(result) from result
    if isinstance(result, LoadError):
        fault = Fault(result.pointer, f"{result.file}: {result.reason}", result.mend)
        raise AssetError("a file of the scene cannot be used", faults=[fault]) from result
    if isinstance(result, Canceled):
        raise KeyboardInterrupt
    if isinstance(result, BaseException):
        raise result
    return result


def _progress_of(seen: list[Any]) -> tuple[str, Progress]:
    if not seen:
        return "preparing", Progress()
    now = seen[0]
    fraction = now.blocks_done / now.blocks_total if now.blocks_total else 0.0
    return "rendering", Progress(
        tiles_done=now.blocks_done,
        tiles_total=now.blocks_total,
        fraction=fraction,
        rays=now.rays,
        rays_per_s=now.rays / now.seconds if now.seconds > 0 else None,
        eta_s=now.seconds * (1 - fraction) / fraction if fraction else None,
    )


def _report(scene: "SceneDoc", film: "Film", film_sha256: str) -> dict[str, Any]:
    from tracer.scene import scene_hash

    rays = {name: count for name, count in film.counters.items() if name.endswith("_rays")}
    samples = film.counters["samples"]
    x, y, width, height = film.window
    return {
        "film_sha256": film_sha256,
        "scene_sha256": scene_hash(scene),
        "samples": film.n_samples,
        "image": {"width": scene.image.width, "height": scene.image.height},
        "crop": {"x": x, "y": y, "width": width, "height": height},
        "seconds": {
            "preparing": {"load": film.stats.load_s, "build": film.stats.build_s, "total": film.stats.total_s},
            "rendering": film.wall_s,
            "total": film.stats.total_s + film.wall_s,
        },
        "kernel_s": film.kernel_s,
        "rays": {
            **rays,
            "total": sum(rays.values()),
            "per_sample": sum(rays.values()) / samples if samples else None,
            "per_s": sum(rays.values()) / film.wall_s if film.wall_s > 0 else None,
        },
        "samples_traced": samples,
        "skipped": {name: count for name, count in film.counters.items() if "_skipped_" in name},
        "adaptive": {
            "blocks_audited": film.counters["adaptive_blocks_audited"],
            "blocks_missed": film.counters["adaptive_blocks_missed"],
        },
        "triangles": film.stats.n_triangles,
        "trees": film.stats.n_trees,
        "placements": film.stats.n_placements,
        "bytes": {"compiled_scene": film.stats.n_bytes, "saved_by_sharing": film.stats.n_bytes_saved},
        "warnings": list(film.stats.warnings),
    }
