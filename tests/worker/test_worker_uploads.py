"""Assets by their content, and the keys that make a request safe to repeat."""

import hashlib

import pytest

from worker.errors import (
    AssetNotFoundError,
    AssetTooLargeError,
    HashMismatchError,
)
from worker.records import new_job_id
from worker.store import Store


def test_first_key_wins(store: Store):
    first, second = new_job_id(), new_job_id()
    assert store.put_idempotency("me", "a key / with .. anything", "hash", first) == ("hash", first)
    assert store.put_idempotency("me", "a key / with .. anything", "hash", second) == ("hash", first)
    assert store.put_idempotency("you", "a key / with .. anything", "hash", second) == ("hash", second)


def test_assets_are_checked(store: Store):
    data = b"geometry" * 1000
    name = hashlib.sha256(data).hexdigest()
    assert not store.has_asset(name)
    with pytest.raises(AssetNotFoundError):
        store.asset_path(name)
    with pytest.raises(HashMismatchError):
        store.put_asset(name, [b"other"], 10**6)
    with pytest.raises(AssetTooLargeError):
        store.put_asset(name, [data], len(data) - 1)
    assert store.put_asset(name, (data[i : i + 7] for i in range(0, len(data), 7)), len(data))
    assert not store.put_asset(name, iter([b"never read"]), 1)
    assert store.asset_path(name).read_bytes() == data
    assert not list(store.temporary.iterdir())
