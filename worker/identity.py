"""Which store a Redis belongs to: one, so that two farms never take each other's jobs for gone.

Job: the steward says at each tick whose Redis it is; whoever comes with another store is refused.
Invariant: the word of a farm that is gone lapses by itself, so that its Redis may be given to another store.
Without this a worker with a wrong ``--store`` finds none of the jobs that it is hinted at and says nothing, and a
steward with one takes the other farm's jobs out of the index.
"""

from worker.contract import KEY_STORE, STORE_TTL_S
from worker.errors import WrongStoreError
from worker.queue import Queue
from worker.store import Store
from worker.wire import clear_errors


def check_store(store: Store, queue: Queue) -> None:
    """Raise `WrongStoreError` if the queue's server belongs to another store; nothing is said where it is nobody's."""
    with clear_errors():
        owner = queue.redis.get(KEY_STORE)
    if owner not in {None, store.identity.encode()}:
        raise WrongStoreError(
            f"the service at this Redis has another store than {store.root}: give the --store that it has "
            f"(if it has just ended, try again in {STORE_TTL_S} s)"
        )


def claim_store(store: Store, queue: Queue) -> None:
    """Say for the next seconds that the queue's server belongs to this store; `WrongStoreError` if it is another's."""
    with clear_errors():
        queue.redis.set(KEY_STORE, store.identity, nx=True, ex=STORE_TTL_S)
    check_store(store, queue)
    with clear_errors():
        queue.redis.expire(KEY_STORE, STORE_TTL_S)
