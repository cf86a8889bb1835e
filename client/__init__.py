"""The command line and the Python client, over HTTP alone.

`client.local` renders in process and is the one module here that imports the tracer; `client.serve` starts the farm.
Invariant: importing this package loads nothing heavy; `Client` and the errors are found on first use (PEP 562).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from client.api import Client
    from client.errors import SmaltiError
    from client.models import Job, JobPage, Progress

__all__ = ["Client", "Job", "JobPage", "Progress", "SmaltiError"]

_HOMES = {
    "Client": "client.api",
    "Job": "client.models",
    "JobPage": "client.models",
    "Progress": "client.models",
    "SmaltiError": "client.errors",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'client' has no attribute {name!r}")
