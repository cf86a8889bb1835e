"""Start the farm: the one module of the client that knows `worker`.

Invariant: what is not given stays as the environment (`SMALTI_*`) or the farm's defaults have it.
"""

import errno
import fcntl
import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from client.errors import ConflictError, NotReachableError, SmaltiError, UsageError

# A server whose supervisor was killed goes within some milliseconds; what still answers after this is not going.
_GOING_S: Final = 0.5


def run_farm(ready: Callable[[Any], None] | None = None, **given: Any) -> None:
    """Run the supervisor until it is told to stop.

    Parameters
    ----------
    ready : callable, optional
        Called with the supervisor once everything answers.
    **given
        Fields of the farm's settings; None means not given.

    Raises
    ------
    UsageError
        When a setting is out of range, or the store is not the one of the service at the given Redis.
    NotReachableError
        When the given Redis does not answer.
    ConflictError
        When the port or the store is in use.
    SmaltiError
        When the farm cannot start, or ended by itself.
    """
    from pydantic import ValidationError

    from worker.settings import FarmSettings

    settings_given = {key: value for key, value in given.items() if value is not None}
    try:
        settings = FarmSettings(**settings_given)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
        raise UsageError(f"a setting is not valid: {faults}") from error
    if settings.redis_url is None and _store_in_use(settings.store):
        raise _store_taken(settings.store)
    if settings.api:
        _try_port(settings.host, settings.port)

    # After what can be told at once: they take a second to import.
    from worker.errors import FarmError, QueueUnavailableError, StoreInUseError, WrongStoreError
    from worker.logs import configure_logs
    from worker.supervisor import Supervisor

    configure_logs(settings.log_level, settings.log_file, role="supervisor", pid=os.getpid())
    farm = Supervisor(settings, ready=ready)
    if farm.run():
        if isinstance(farm.error, QueueUnavailableError):
            hint = "is Redis up, and is --redis-url (SMALTI_REDIS_URL) right?"
            raise NotReachableError(str(farm.error), hint=hint)
        if isinstance(farm.error, WrongStoreError):
            raise UsageError(str(farm.error))
        if isinstance(farm.error, StoreInUseError):
            raise _store_taken(settings.store)
        reason = str(farm.error) if isinstance(farm.error, FarmError) else "the farm ended with an error"
        where = "the lines above tell" if settings.log_file is None else f"{settings.log_file} tells"
        raise SmaltiError(reason, hint=f"{where} more; `smalti doctor` looks for the usual causes")


def _store_taken(store: Path) -> ConflictError:
    return ConflictError(
        f"the store {store} is in use by another `smalti serve`",
        hint="end that one, use it (`smalti list`), or give another store: --store DIR (SMALTI_STORE)",
    )


def _store_in_use(store: Path) -> bool:
    """Whether another farm runs on a store: its server holds the lock, answers, and goes on doing so.

    The supervisor finds out, too, but has to wait for seconds: it cannot tell a server that is about to end from one
    that stays. Where this cannot, either (the server does not answer), it is left to the supervisor.
    """
    try:
        lock = os.open(store / "valkey" / "lock", os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False  # nobody has been here; or the supervisor tells what is wrong
    try:
        deadline = time.monotonic() + _GOING_S
        while time.monotonic() < deadline:
            with suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return False
            time.sleep(0.02)
    finally:
        os.close(lock)
    return _answers(store / "valkey" / "s")


def _answers(path: Path) -> bool:
    """Whether a server accepts connections at a unix socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(1.0)
        try:
            connection.connect(str(path.absolute()))
        except OSError:
            return False
        return True


def _try_port(host: str, port: int) -> None:
    """Raise `ConflictError` when somebody listens at the port; all else that is wrong with it the supervisor tells."""
    try:
        socket.create_server((host, port)).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConflictError(
                f"port {port} of {host} is in use",
                hint="end what listens there, use it (`smalti doctor` tells whether it is Smalti), or give another "
                "port: --port (SMALTI_PORT; 0 takes a free one)",
            ) from error


def default_store() -> Path:
    """Return the store that the settings name."""
    from worker.settings import FarmSettings

    return FarmSettings().store
