"""What names compiled code, and where it is kept: one folder a key under ``<cache>/kernels``.

The key is a hash of all kernel sources, of the compiler's versions, and of the CPU. So an edit is a new folder, several
versions live side by side, and a folder that nobody has used for `KEPT_S` is let go (`prune_kernels`). In it are
numba's own cache, and the image, named by a hash of the sources that make it.
"""

import hashlib
import os
import platform
import shutil
import sys
import time
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Final

from tracer.paths import cache_root

# Folders and modules whose text decides what is compiled; the others hold no kernels.
_KERNEL_SOURCES: Final = (
    "types.py",
    "jit.py",
    "simd",
    "sampling",
    "geometry",
    "rays",
    "accel",
    "shading",
    "integrators",
    "render/blocks.py",
    "render/inside.py",
    "render/contrast.py",
)
_IMAGE_SOURCES: Final = (
    "native/build.py",
    "native/frontend.py",
    "native/entries.py",
    "native/image.py",
    "native/link.py",
)
_CPU_FIELDS: Final = frozenset(
    {"vendor_id", "cpu family", "model", "model name", "stepping", "flags"}  # x86
    | {"CPU implementer", "CPU architecture", "CPU variant", "CPU part", "Features"}  # ARM
)
KEPT_S: Final = 30 * 86400.0
"""Seconds after its last use until a folder of kernels is let go: a branch that rests for a month compiles again."""
_TOUCHED_S: Final = 3600.0
"""How old the mark of the last use may be: a mark is a write, and not every process needs one."""


def _cpu() -> str:
    """Describe the CPU that is compiled for; the words are compared, never understood."""
    name = os.environ.get("NUMBA_CPU_NAME")
    if name:
        return name
    words = []
    with suppress(OSError), Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            field, _, value = line.partition(":")
            if not field.strip():
                break  # the first core's paragraph
            if field.strip() in _CPU_FIELDS:
                words.append(f"{field.strip()}={value.strip()}")
    if words:
        return " ".join(words)
    from llvmlite import binding

    return f"{binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


def _hash_sources(names: tuple[str, ...]) -> "hashlib._Hash":
    """Hash the text of modules and folders."""
    digest = hashlib.sha256()
    folder = Path(__file__).parent.parent
    for name in names:
        path = folder / name
        for source in [path] if path.is_file() else sorted(path.glob("**/*.py")):
            digest.update(source.relative_to(folder).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest


def kernel_key() -> str:
    """Hash of the kernels' sources, the compiler's versions and the CPU that is compiled for.

    ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES`` stand for the host's CPU where they are set: an image compiled ahead
    for x86-64-v3 finds its kernels on every machine.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    digest = _hash_sources(_KERNEL_SOURCES)
    for package in ("numba", "llvmlite", "numpy"):
        digest.update(f"{package} {metadata.version(package)}\n".encode())
    features = os.environ.get("NUMBA_CPU_FEATURES", "")
    digest.update(f"{sys.version_info[:2]} {platform.machine()} {_cpu()} {features}".encode())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def kernel_folder() -> Path:
    """Directory of this process's kernels: numba's cache and the image."""
    return cache_root() / "kernels" / kernel_key()


@lru_cache(maxsize=1)
def image_path() -> Path:
    """File of the image of this process's kernels, whether it is there or not."""
    return kernel_folder() / f"{_hash_sources(_IMAGE_SOURCES).hexdigest()[:16]}.image"


def mark_use(folder: Path) -> None:
    """Note that a folder of kernels is in use."""
    with suppress(OSError):
        if time.time() - folder.stat().st_mtime > _TOUCHED_S:
            os.utime(folder)


def prune_kernels(keep: Path) -> int:
    """Delete the folders of kernels that no process has used for `KEPT_S`.

    A process that has mapped an image keeps it; one that goes on compiling into its folder makes it anew.

    Parameters
    ----------
    keep
        The folder in use.

    Returns
    -------
    int
        Folders that were deleted.
    """
    n_deleted = 0
    for folder in keep.parent.glob("*"):
        with suppress(OSError):
            if folder.name != keep.name and folder.is_dir() and time.time() - folder.stat().st_mtime > KEPT_S:
                shutil.rmtree(folder)
                n_deleted += 1
    return n_deleted
