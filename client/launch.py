"""A service of one's own for a while: `smalti demo`, the benchmarks and tests use it.

Invariants: the service runs in a process group of its own, so Ctrl-C reaches only us and the end is in order; it ends
with this process, whatever happens to it (PR_SET_PDEATHSIG on Linux); its store is temporary unless one is given.
"""

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from client.errors import SmaltiError

START_LIMIT_S = 320.0  # with a first compilation of all kernels on a slow machine
SLOW_START_S = 12.0  # about 6 s with compiled kernels on two cores
STOP_LIMIT_S = 15.0  # the farm drains for at most 5 s
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, slots=True)
class RunningService:
    """A started service.

    Attributes
    ----------
    url : str
        Address of its API.
    pid : int
        Process id of the supervisor, and of its process group.
    folder : Path
        Its store, log and socket.
    start_s : float
        Seconds that the start took.
    """

    url: str
    pid: int
    folder: Path
    start_s: float


def _end_with_parent() -> None:
    """Have the kernel send SIGTERM to this new process when its parent dies (Linux)."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


@contextlib.contextmanager
def service(
    *,
    workers: int | None = None,
    folder: Path | None = None,
    port: int = 0,
    environment: dict[str, str] | None = None,
    slow: Callable[[], None] | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> Iterator[RunningService]:
    """Run a service with an embedded Valkey on loopback while the block runs.

    Parameters
    ----------
    workers : int, optional
        Worker processes; one for each core by default.
    folder : Path, optional
        Keeps store and log; a temporary one, removed at the end, by default.
    port : int
        0 takes a free one.
    environment : dict, optional
        Further variables.
    slow : callable, optional
        Called once when the start takes longer than one with compiled kernels.
    meanwhile : callable, optional
        Called while it starts: for what can be done before it is up.

    Raises
    ------
    SmaltiError
        When it does not start; the message holds the end of its log.
    """
    own_folder = folder is None
    # Short: the path of the embedded server's socket has to stay below 108 characters.
    home = Path(tempfile.mkdtemp(prefix="smalti-")) if folder is None else folder
    home.mkdir(parents=True, exist_ok=True)
    ready, log = home / "ready.json", home / "service.log"
    ready.unlink(missing_ok=True)
    command = [sys.executable, "-m", "client", "serve", "--host", "127.0.0.1", "--port", str(port)]
    command += ["--store", str(home / "store"), "--ready-file", str(ready), "--log-file", str(log)]
    if workers is not None:
        command += ["--workers", str(workers)]
    # `python -m client` must find these packages, not others of the same names in the current folder.
    python_path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")]))
    variables = {**os.environ, "PYTHONPATH": python_path, **(environment or {})}
    variables.pop("SMALTI_REDIS_URL", None)
    started = time.monotonic()
    try:
        with log.open("ab") as log_file:
            process = subprocess.Popen(  # noqa: S603 - our own module
                command,
                stdin=subprocess.DEVNULL,
                stdout=log_file,
                stderr=log_file,
                env=variables,
                start_new_session=True,
                preexec_fn=_end_with_parent,  # noqa: PLW1509 - no threads run yet that could hold a lock
            )
        try:
            if meanwhile is not None:
                meanwhile()
            url = _wait_until_ready(process, ready, log, slow)
            yield RunningService(url=url, pid=process.pid, folder=home, start_s=time.monotonic() - started)
        finally:
            stop(process)
    finally:
        if own_folder:
            shutil.rmtree(home, ignore_errors=True)


def _wait_until_ready(
    process: "subprocess.Popen[bytes]", ready: Path, log: Path, slow: Callable[[], None] | None
) -> str:
    """Wait for the ready file; returns the URL in it."""
    deadline = time.monotonic() + START_LIMIT_S
    slow_at = time.monotonic() + SLOW_START_S
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, ValueError):
            found: Any = json.loads(ready.read_text("utf-8"))
            if isinstance(found, dict) and found.get("url"):
                return str(found["url"])
        if process.poll() is not None:
            raise SmaltiError(
                f"the service ended with status {process.returncode} before it was ready{_tail(log)}",
                hint="`smalti doctor` looks for the usual causes",
            )
        if slow is not None and time.monotonic() > slow_at:
            slow()
            slow = None
        time.sleep(0.02)
    raise SmaltiError(f"the service was not ready after {START_LIMIT_S:.0f} s{_tail(log)}")


def _tail(log: Path, lines: int = 8) -> str:
    """Return the end of a log, for an error's text."""
    try:
        text = log.read_text("utf-8", "replace").strip().splitlines()[-lines:]
    except OSError:
        return ""
    return "; the end of its log: " + " | ".join(text) if text else ""


def stop(process: "subprocess.Popen[bytes]") -> None:
    """End a service in order; by force when it does not end in time. A second Ctrl-C does not leave it behind."""
    with _interrupts_deferred():
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextlib.contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Ignore SIGINT in the block: stopping takes at most `STOP_LIMIT_S`."""
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not the main thread: signals do not come here anyway
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
