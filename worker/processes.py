"""What a child process of the farm is born with.

Job: the few system calls that tie a child to its parent and make it polite.
Invariant: no child outlives a supervisor that was killed.
Source: prctl(2), PR_SET_PDEATHSIG. (The signal is sent when the *thread* that forked ends, so the supervisor starts all
its children from one thread that lives as long as it does.)
"""

import ctypes
import os
import signal
import sys
from collections.abc import Callable

_PR_SET_PDEATHSIG = 1


def born(parent_pid: int, *, nice: int = 0, death_signal: int = signal.SIGKILL) -> Callable[[], None]:
    """Return what a child runs between fork and exec.

    Parameters
    ----------
    parent_pid
        Process id of the parent that calls this.
    nice
        Niceness to add.
    death_signal
        Signal that the child gets when the parent dies (Linux only; elsewhere the supervisor's own drain has to do).
    """
    prctl = ctypes.CDLL(None, use_errno=True).prctl if sys.platform.startswith("linux") else None

    def run() -> None:
        # Only plain system calls here: between fork and exec no lock may be taken.
        os.setsid()  # a Ctrl-C in the terminal goes to the supervisor alone, which then drains
        if nice:
            os.nice(nice)
        if prctl is not None:
            prctl(_PR_SET_PDEATHSIG, death_signal, 0, 0, 0)
            if os.getppid() != parent_pid:  # it died before prctl
                os._exit(1)

    return run
