"""Make the kernels ready ahead of use, once a host: map the image, or compile and write it.

Invariant: one process compiles while the others wait (flock), and they find what it made.
"""

import fcntl
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from tracer.native.entries import compiles_nothing, current_image
from tracer.native.image import ImageError, load_image
from tracer.native.key import image_path, prune_kernels
from tracer.native.link import LinkError


class ImageState(NamedTuple):
    """What there is to tell of the image of this process's kernels."""

    key: str
    path: Path
    n_bytes: int  # 0 where there is none that can be used
    fault: str  # why it cannot be used; empty where it can, or where there is none


def image_state() -> ImageState:
    """Look at the image of this process's kernels, as it is on disk now."""
    path = image_path()
    key = path.parent.name
    try:
        return ImageState(key, path, load_image(path, key).n_bytes, "")
    except FileNotFoundError:
        return ImageState(key, path, 0, "")
    except (OSError, ImageError) as error:
        return ImageState(key, path, 0, str(error))


def warm(on_compile: Callable[[], None] | None = None) -> float:
    """Map the image of the kernels; compile and write it where there is none, or none that can be used.

    Where no image can be (another system than Linux on x86-64, a folder that cannot be written), the kernels are those
    that numba compiles in this process, and keeps on disk as it can.

    Parameters
    ----------
    on_compile
        Called before anything is compiled, which takes a minute.

    Returns
    -------
    float
        Seconds that it took, waiting for another process that compiles included.
    """
    start = time.perf_counter()
    if not compiles_nothing() and image_state().n_bytes == 0:
        path = image_path()
        with _locked(path.parent):
            if image_state().n_bytes == 0:  # else whoever held the lock before has made it
                if on_compile is not None:
                    on_compile()
                _make_image(path)
        current_image.cache_clear()
    if current_image() is not None:
        prune_kernels(image_path().parent)
    return time.perf_counter() - start


def _make_image(path: Path) -> None:
    """Compile all entries; write the image if that can be."""
    # By name, because it brings numba.
    build = import_module("tracer.native.build")
    compiled = build.compile_entries()
    try:
        build.write_image(path, compiled)
    except LinkError:
        pass  # no images on this system: numba's own cache has to do
    except OSError as error:
        warnings.warn(f"no image of the kernels: {error}; every process compiles", RuntimeWarning, stacklevel=3)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock between processes; where none can be had, work is done twice and nothing else is lost."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = (folder / "warm.lock").open("a")
    except OSError:
        yield
        return
    with handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
