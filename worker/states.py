"""The states of a job and the one table of its transitions.

Job: say which state may follow which; pure, without clock or storage.
Invariant: terminal states have no successor; every other state can be canceled and can fail, save that a job being
canceled can only become canceled.

::

    queued -> preparing -> rendering -> assembling -> succeeded
       |          |            |            |
       +----------+-----+------+------------+--> failed
                        v
                    canceling -> canceled
"""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class JobState(StrEnum):
    """What a job is doing; the value is what the API shows and the store keeps."""

    QUEUED = "queued"
    PREPARING = "preparing"
    RENDERING = "rendering"
    ASSEMBLING = "assembling"
    SUCCEEDED = "succeeded"
    CANCELING = "canceling"
    CANCELED = "canceled"
    FAILED = "failed"


TERMINAL: frozenset[JobState] = frozenset({JobState.SUCCEEDED, JobState.CANCELED, JobState.FAILED})

_STOPS = frozenset({JobState.CANCELING, JobState.FAILED})

TRANSITIONS: Mapping[JobState, frozenset[JobState]] = MappingProxyType(
    {
        JobState.QUEUED: _STOPS | {JobState.PREPARING},
        JobState.PREPARING: _STOPS | {JobState.RENDERING},
        JobState.RENDERING: _STOPS | {JobState.ASSEMBLING},
        JobState.ASSEMBLING: _STOPS | {JobState.SUCCEEDED},
        JobState.CANCELING: frozenset({JobState.CANCELED}),
        JobState.SUCCEEDED: frozenset(),
        JobState.CANCELED: frozenset(),
        JobState.FAILED: frozenset(),
    }
)


def can_transition(current: JobState, to: JobState) -> bool:
    """Whether `to` may follow `current`."""
    return to in TRANSITIONS[current]


def allowed_from(current: JobState) -> tuple[JobState, ...]:
    """Return the states that may follow `current`, in the order of the enumeration."""
    return tuple(state for state in JobState if state in TRANSITIONS[current])
