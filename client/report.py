"""The report of a job for people: where the time went, what was skipped.

Invariant: members that a report lacks are left out; unknown ones do no harm.
"""

from collections.abc import Mapping
from typing import Any

from client.terminal import Terminal


def print_report(terminal: Terminal, report: Mapping[str, Any], *, done_s: float | None = None) -> None:
    """Print where the time of a job went, and what was skipped.

    Parameters
    ----------
    report : Mapping
        The report as the service answers it.
    done_s : float, optional
        Seconds from the request to the result, as seen here.
    """
    del terminal, report, done_s  # the farm's report is not written yet
