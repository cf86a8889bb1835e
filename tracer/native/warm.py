"""Make the kernels ready ahead of use, once a host: map the image, or have it compiled and written.

Invariants: one process compiles while the others wait (flock), and they find what it made; the compiler runs in a
process of its own, because it leaves half a gigabyte behind.
"""

import fcntl
import os
import platform
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from tracer.native.entries import compiles_nothing, current_image
from tracer.native.image import ImageError, load_image
from tracer.native.key import image_path, prune_kernels
from tracer.paths import cache_root

_HAS_IMAGES: Final = sys.platform == "linux" and platform.machine() == "x86_64"  # what `tracer.native.link` knows


class ImageState(NamedTuple):
    """What there is to tell of the image of this process's kernels."""

    key: str
    path: Path
    n_bytes: int  # 0 where there is none that can be used
    compile_s: float  # seconds that its making took; 0 where that is not known
    fault: str  # why it cannot be used; empty where it can, or where there is none


def image_state() -> ImageState:
    """Look at the image of this process's kernels, as it is on disk now."""
    path = image_path()
    key = path.parent.name
    try:
        image = load_image(path, key)
    except FileNotFoundError:
        return ImageState(key, path, 0, 0.0, "")
    except (OSError, ImageError) as error:
        return ImageState(key, path, 0, 0.0, str(error))
    return ImageState(key, path, image.n_bytes, compile_seconds(), "")


def compile_seconds() -> float:
    """Return how long the making of this process's image took on this host; 0 where that is not known.

    It is kept beside the image: the image itself has the same bytes whenever it is made.
    """
    with suppress(OSError, ValueError):
        return float(_seconds_path(image_path()).read_text())
    return 0.0


def _seconds_path(path: Path) -> Path:
    return path.with_suffix(".seconds")


def warm(on_compile: Callable[[], None] | None = None) -> float:
    """Map the image of the kernels; have it made where there is none, or none that can be used.

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
        if _HAS_IMAGES and _is_writable(path.parent):
            with _locked(path.parent):
                if image_state().n_bytes == 0:  # else whoever held the lock before has made it
                    if on_compile is not None:
                        on_compile()
                    _make_image(path)
            current_image.cache_clear()
        else:
            if on_compile is not None:
                on_compile()
            import_module("tracer.native.build").compile_entries()  # by name, because it brings numba
    if current_image() is not None:
        prune_kernels(image_path().parent)
    return time.perf_counter() - start


def _is_writable(folder: Path) -> bool:
    """Make a folder if it is not there; tells whether files can be made in it."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


def _make_image(path: Path) -> None:
    """Have the image made by a process that runs these sources, wherever the name `tracer` leads otherwise."""
    start = time.perf_counter()
    making = subprocess.run(  # noqa: S603 - ourselves
        [sys.executable, "-m", "tracer.native.build", str(path.absolute())],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SMALTI_CACHE": str(cache_root().absolute())},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if making.returncode:
        told = making.stderr.strip().splitlines()
        reason = told[-1] if told else f"exit status {making.returncode}"
        warnings.warn(f"no image of the kernels: {reason}; every process compiles", RuntimeWarning, stacklevel=3)
        return
    with suppress(OSError):
        _seconds_path(path).write_text(f"{time.perf_counter() - start:.1f}\n")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock between processes."""
    with (folder / "warm.lock").open("a") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
