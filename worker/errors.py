"""What can go wrong in the farm.

::

    FarmError
    |-- StoreError
    |   |-- BadNameError            an id, hash or file name that the store refuses (path traversal among them)
    |   |-- JobNotFoundError
    |   |-- AssetNotFoundError
    |   |-- HashMismatchError       uploaded bytes are not those that the name says
    |   |-- AssetTooLargeError
    |   |-- ConflictError           an event of that number exists already
    |   |-- IllegalTransitionError  carries `current` and `allowed`
    |   |-- DamagedRecordError      a file of the store cannot be read back
    |   `-- StoreFullError          no space, no inodes or over quota
    |-- QueueError
    |   |-- QueueUnavailableError   Redis does not answer
    |   |-- QueueFullError          Redis refuses to write (out of memory)
    |   `-- StaleIndexError         the index was wiped or is being rebuilt
    |-- IdempotencyConflictError    same key, other request
    |-- JobActiveError              the call needs a job that has ended
    |-- ServerStartError            the embedded Valkey did not come up
    |-- StoreInUseError             another supervisor holds this store
    `-- WrongStoreError             the queue's server belongs to another store
"""

from collections.abc import Sequence

from worker.states import JobState


class FarmError(Exception):
    """The farm could not do what was asked."""

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or (self.__doc__ or "").splitlines()[0])


class StoreError(FarmError):
    """The store could not do what was asked."""


class BadNameError(StoreError):
    """The store has no such kind of name."""


class JobNotFoundError(StoreError):
    """There is no such job."""


class AssetNotFoundError(StoreError):
    """There is no such asset."""


class HashMismatchError(StoreError):
    """The bytes do not have the hash that their name says."""


class AssetTooLargeError(StoreError):
    """The asset is larger than allowed."""


class ConflictError(StoreError):
    """An event of that number exists already."""


class IllegalTransitionError(StoreError):
    """The job's state does not allow this.

    Attributes
    ----------
    current : JobState
        State the job is in.
    allowed : tuple of JobState
        States that may follow.
    """

    def __init__(self, current: JobState, to: JobState, allowed: Sequence[JobState]) -> None:
        super().__init__(f"a job that is {current} cannot become {to}")
        self.current = current
        self.to = to
        self.allowed = tuple(allowed)


class DamagedRecordError(StoreError):
    """A file of the store cannot be read back."""


class StoreFullError(StoreError):
    """The store has no space left."""


class QueueError(FarmError):
    """The queue could not do what was asked."""


class QueueUnavailableError(QueueError):
    """The queue's server does not answer."""


class QueueFullError(QueueError):
    """The queue's server is out of memory and refuses to write."""


class StaleIndexError(QueueError):
    """The index was wiped and is being rebuilt from the store."""


class IdempotencyConflictError(FarmError):
    """The idempotency key was used for another request."""


class JobActiveError(FarmError):
    """The job has not ended yet.

    Attributes
    ----------
    current : JobState
        State the job is in.
    """

    def __init__(self, current: JobState) -> None:
        super().__init__(f"the job is {current}; cancel it first or wait")
        self.current = current


class ServerStartError(FarmError):
    """The embedded Valkey did not come up."""


class StoreInUseError(FarmError):
    """Another supervisor is using this store."""


class WrongStoreError(FarmError):
    """The queue's server belongs to a farm with another store."""
