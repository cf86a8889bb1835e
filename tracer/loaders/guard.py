"""Load files that someone else wrote in a process of its own, and survive whatever they do.

Invariants: a bad file costs its job and never the process that asked; memory, CPU time, wall time and output of the
loading process are bounded by the kernel; the caller gets checked arrays or a `LoadError` with the file's name.
One process serves a whole batch, because its start costs 0.2 to 0.6 s. It is started with exec, not fork: the caller
may be a worker with compiled code and threads.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrayfile import ArrayFileError
from tracer.loaders.errors import LoadError
from tracer.loaders.files import ModelFile
from tracer.loaders.handover import open_image, open_mesh
from tracer.loaders.limits import DEFAULT_LIMITS, IN_PROCESS_JSON_BYTES, LoadLimits
from tracer.loaders.load import load_mesh
from tracer.loaders.mesh import MeshData

_PACKAGE_ROOT = Path(__file__).resolve().parents[2]


class LoadRequest(NamedTuple):
    """One file to load."""

    kind: str  # "mesh" or "image"
    path: Path
    name: str  # as its owner knows it
    companions: Collection[str] | None = None  # what may be opened beside it; None: all in its folder


def load_mesh_guarded(
    path: Path,
    name: str | None = None,
    companions: Collection[str] | None = None,
    limits: LoadLimits = DEFAULT_LIMITS,
) -> MeshData:
    """Load one model.

    Raises
    ------
    LoadError
    """
    result = load_guarded([LoadRequest("mesh", path, name or path.name, companions)], limits)[0]
    if isinstance(result, LoadError):
        raise result
    assert isinstance(result, MeshData)
    return result


def load_image_guarded(path: Path, name: str | None = None, limits: LoadLimits = DEFAULT_LIMITS) -> NDArray[np.uint8]:
    """Load one image, uint8 (height, width, 3).

    Raises
    ------
    LoadError
    """
    result = load_guarded([LoadRequest("image", path, name or path.name)], limits)[0]
    if isinstance(result, LoadError):
        raise result
    assert isinstance(result, np.ndarray)
    return result


def load_guarded(
    requests: Sequence[LoadRequest], limits: LoadLimits = DEFAULT_LIMITS
) -> list[MeshData | NDArray[np.uint8] | LoadError]:
    """Load a batch of files; each gets its arrays or its error, in the order of the requests.

    Small vertex-data JSON is read right here (see `limits.IN_PROCESS_JSON_BYTES`); for the rest one process is
    started. When that dies over a file, the files after it get an error that says so.
    """
    results: dict[int, MeshData | NDArray[np.uint8] | LoadError] = {}
    rest: list[int] = []
    for index, request in enumerate(requests):
        if _is_small_json(request):
            try:
                results[index] = load_mesh(ModelFile(request.path, request.name, request.companions, limits))
            except LoadError as error:
                results[index] = error
        else:
            rest.append(index)
    if rest:
        results.update(zip(rest, _load_in_process([requests[index] for index in rest], limits), strict=True))
    return [results[index] for index in range(len(requests))]


def _is_small_json(request: LoadRequest) -> bool:
    """Whether a file may be read in this process."""
    try:
        return (
            request.kind == "mesh"
            and request.name.lower().endswith(".json")
            and request.path.stat().st_size <= IN_PROCESS_JSON_BYTES
        )
    except OSError:
        return False


def _load_in_process(
    requests: Sequence[LoadRequest], limits: LoadLimits
) -> list[MeshData | NDArray[np.uint8] | LoadError]:
    """Start the loading process, wait for it, and gather what it left."""
    with tempfile.TemporaryDirectory(prefix="smalti-load-") as folder:
        out = Path(folder)
        order = {
            "limits": limits._asdict(),
            "out": folder,
            "requests": [
                [
                    request.kind,
                    str(request.path.absolute()),
                    request.name,
                    None if request.companions is None else sorted(request.companions),
                ]
                for request in requests
            ],
        }
        code, timed_out, stdout = _run(json.dumps(order).encode(), limits)
        answers = _parse_answers(stdout, len(requests))
        results: list[MeshData | NDArray[np.uint8] | LoadError] = []
        for index, request in enumerate(requests):
            answer = answers.get(index)
            if answer is None:
                begun = max(answers, default=-1) + 1 == index
                results.append(_death(request, code, timed_out, limits, begun=begun))
            elif "reason" in answer:
                results.append(LoadError(request.name, str(answer["reason"]), str(answer["mend"])))
            else:
                try:
                    path = out / f"{index}.arrays"
                    # The map keeps the arrays alive after the folder is gone.
                    results.append(open_mesh(path) if request.kind == "mesh" else open_image(path))
                except (ArrayFileError, OSError, KeyError) as error:
                    results.append(
                        LoadError(
                            request.name,
                            f"was lost on its way out of the loader ({error})",
                            "free some space for temporary files, then try again",
                        )
                    )
        return results


def _run(order: bytes, limits: LoadLimits) -> tuple[int, bool, bytes]:
    """Run the loading process; return its exit code, whether it was too slow, and what it said."""
    environment = {
        "PATH": os.environ.get("PATH", ""),
        "PYTHONPATH": str(_PACKAGE_ROOT),
        "PYTHONSAFEPATH": "1",
        "LANG": "C.UTF-8",
        # Threads of a linear algebra library that is never called: 0.1 s and a gigabyte of addresses.
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    with tempfile.TemporaryFile() as stdout:
        process = subprocess.Popen(
            [sys.executable, "-s", "-m", "tracer.loaders"],
            stdin=subprocess.PIPE,
            stdout=stdout,
            stderr=subprocess.DEVNULL,
            env=environment,
            close_fds=True,
        )
        try:
            process.communicate(order, timeout=limits.wall_s)
            timed_out = False
        except subprocess.TimeoutExpired:
            timed_out = True
        finally:
            process.kill()
            process.wait()
        stdout.seek(0)
        return process.returncode, timed_out, stdout.read(1 << 24)


def _parse_answers(stdout: bytes, n_requests: int) -> dict[int, dict[str, Any]]:
    """Read one JSON line for each finished request; a torn last line is no answer."""
    answers: dict[int, dict[str, Any]] = {}
    for line in stdout.splitlines():
        try:
            answer = json.loads(line)
        except ValueError:
            continue
        if isinstance(answer, dict) and answer.get("index") in range(n_requests):
            answers[answer["index"]] = answer
    return answers


def _death(request: LoadRequest, code: int, timed_out: bool, limits: LoadLimits, *, begun: bool) -> LoadError:
    """Say why there is no answer for a file."""
    if not begun:
        return LoadError(
            request.name, "was not loaded, because a file before it ended the loader", "mend that file first"
        )
    if timed_out:
        return LoadError(request.name, f"took longer than {limits.wall_s:g} s to load", "simplify it")
    if code == -signal.SIGXCPU:
        return LoadError(request.name, f"took longer than {limits.cpu_s} s of CPU time to load", "simplify it")
    if code == -signal.SIGKILL:
        return LoadError(request.name, "took more memory or CPU time to load than is allowed", "simplify it")
    name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return LoadError(request.name, f"ended the loader ({name})", "check it with another program")
