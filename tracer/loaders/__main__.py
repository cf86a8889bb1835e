"""The guarded process: takes an order from standard input, loads one file after the other, answers with JSON lines.

Invariant: limits are set before the first byte of a foreign file is read; no socket is opened, no program is
started, and no file outside the models' own folders, Python's installation and the output folder is opened by Python
code (an audit hook says no; it is the second line behind `ModelFile.read_companion`).
"""

import contextlib
import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

_FORBIDDEN = ("socket.", "subprocess.", "os.exec", "os.system", "os.fork", "os.posix_spawn", "ctypes.", "urllib.")


def main() -> None:
    """Serve one order."""
    order = json.loads(sys.stdin.buffer.read())
    limits = order["limits"]
    _set_limits(limits)
    import numpy  # noqa: F401, ICN001 - loads its libraries before the doors are closed

    folders = {str(Path(path).parent) for _, path, _, _ in order["requests"]}
    _close_doors([*folders, order["out"]])
    for index, (kind, path, name, companions) in enumerate(order["requests"]):
        answer = _serve(kind, Path(path), name, companions, limits, Path(order["out"]) / f"{index}.arrays")
        sys.stdout.write(json.dumps({"index": index, **answer}) + "\n")
        sys.stdout.flush()


def _serve(
    kind: str, path: Path, name: str, companions: list[str] | None, limits: dict[str, Any], out: Path
) -> dict[str, Any]:
    """Load one file; return an empty answer, or reason and mend."""
    from tracer.loaders.errors import LoadError
    from tracer.loaders.files import ModelFile
    from tracer.loaders.handover import save_image, save_mesh
    from tracer.loaders.images import load_image
    from tracer.loaders.limits import LoadLimits
    from tracer.loaders.load import load_mesh

    try:
        file = ModelFile(path, name, companions, LoadLimits(**limits))
        if kind == "mesh":
            save_mesh(out, load_mesh(file))
        else:
            save_image(out, load_image(file))
    except LoadError as error:
        return {"reason": error.reason, "mend": error.mend}
    except MemoryError:
        return {
            "reason": f"takes more than {limits['memory_bytes'] >> 20} MiB of memory to load",
            "mend": "simplify it",
        }
    except Exception as error:  # noqa: BLE001 - a loader may fail in any way, and all of them are the file's fault
        return {
            "reason": f"cannot be read as {Path(name).suffix} ({type(error).__name__}: {str(error)[:160]})",
            "mend": "check it with another program",
        }
    return {}


def _set_limits(limits: dict[str, Any]) -> None:
    """Bound memory, CPU time, file sizes and core dumps of this process."""
    for kind, value in (
        (resource.RLIMIT_AS, limits["memory_bytes"]),
        (resource.RLIMIT_CPU, limits["cpu_s"]),
        (resource.RLIMIT_FSIZE, limits["memory_bytes"]),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(kind)
        bound = value if hard == resource.RLIM_INFINITY else min(value, hard)
        # One second more until SIGKILL, so that the soft limit's SIGXCPU tells which limit it was.
        upper = bound + 1 if kind == resource.RLIMIT_CPU and hard == resource.RLIM_INFINITY else bound
        with contextlib.suppress(ValueError, OSError):  # macOS knows no bound of the address space
            resource.setrlimit(kind, (bound, upper))


def _close_doors(folders: list[str]) -> None:
    """Refuse sockets, programs, and files outside the given folders and Python's own."""
    roots = [*folders, sys.prefix, sys.base_prefix, sys.exec_prefix, *(path for path in sys.path if path)]
    allowed = tuple({os.path.join(os.path.abspath(root), "") for root in roots})  # noqa: PTH100, PTH118 - lexical
    # Nothing of /proc: /proc/self/root and cwd lead to every file, and /proc/self/environ tells secrets.
    system = ("/dev/null", "/dev/urandom", "/usr/lib/", "/usr/share/zoneinfo", "/lib/", "/etc/ld.so")

    def refuse(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            name = arguments[0]
            if isinstance(name, int) or name is None:
                return
            path = os.path.abspath(os.fsdecode(name))  # noqa: PTH100 - lexical: links in the folder are the owner's
            if not path.startswith(allowed) and not path.startswith(system):
                raise PermissionError("the loader opens no file outside the model's folder")
        elif event.startswith(_FORBIDDEN):
            raise PermissionError(f"the loader does not do {event}")

    sys.addaudithook(refuse)


if __name__ == "__main__":
    main()
