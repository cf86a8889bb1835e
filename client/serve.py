"""Start the farm: the one module of the client that knows `worker`.

Invariant: what is not given stays as the environment (`SMALTI_*`) or the farm's defaults have it.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from client.errors import NotReachableError, SmaltiError, UsageError


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
    SmaltiError
        When the farm cannot start, or ended by itself.
    """
    from pydantic import ValidationError

    from worker.errors import FarmError, QueueUnavailableError, WrongStoreError
    from worker.logs import configure_logs
    from worker.settings import FarmSettings
    from worker.supervisor import Supervisor

    settings_given = {key: value for key, value in given.items() if value is not None}
    try:
        settings = FarmSettings(**settings_given)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
        raise UsageError(f"a setting is not valid: {faults}") from error
    configure_logs(settings.log_level, settings.log_file, role="supervisor", pid=os.getpid())
    farm = Supervisor(settings, ready=ready)
    if farm.run():
        if isinstance(farm.error, QueueUnavailableError):
            hint = "is Redis up, and is --redis-url (SMALTI_REDIS_URL) right?"
            raise NotReachableError(str(farm.error), hint=hint)
        if isinstance(farm.error, WrongStoreError):
            raise UsageError(str(farm.error))
        reason = str(farm.error) if isinstance(farm.error, FarmError) else "the farm ended with an error"
        raise SmaltiError(reason, hint="its log tells more")


def default_store() -> Path:
    """Return the store that the settings name."""
    from worker.settings import FarmSettings

    return FarmSettings().store
