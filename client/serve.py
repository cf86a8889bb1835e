"""Start the farm: the one module of the client that knows `worker`.

Invariant: what is not given stays as the environment (`SMALTI_*`) or the farm's defaults have it.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from client.errors import SmaltiError, UsageError


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
        When a setting is out of range.
    SmaltiError
        When the farm cannot start, or ended by itself.
    """
    from pydantic import ValidationError

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
    if Supervisor(settings, ready=ready).run():
        raise SmaltiError("the farm ended with an error", hint="its log tells why")


def default_store() -> Path:
    """Return the store that the settings name."""
    from worker.settings import FarmSettings

    return FarmSettings().store
