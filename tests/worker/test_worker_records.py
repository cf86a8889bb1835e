"""Ids, names and the JSON of records."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.errors import BadNameError, DamagedRecordError
from worker.records import (
    JobEvent,
    JobRecord,
    check_job_id,
    check_owner,
    check_sha256,
    new_job_id,
    now,
    seconds_between,
)
from worker.states import JobState

PATHS = [
    "",
    ".",
    "..",
    "../../etc/passwd",
    "a/b",
    "0" * 25,
    "0" * 27,
    "8" + "0" * 25,
    "I" * 26,
    "0" * 25 + "\n",
    "0" * 25 + "/",
]


def test_ids_are_26_characters_and_ascend():
    ids = [new_job_id() for _ in range(2000)]
    assert ids == sorted(set(ids))
    assert all(check_job_id(one) == one for one in ids)


@pytest.mark.parametrize("text", PATHS)
def test_what_is_no_id_is_refused(text: str):
    for check in (check_job_id, check_sha256):
        with pytest.raises(BadNameError):
            check(text)


@given(st.text(max_size=80))
def test_only_plain_characters_pass(text: str):
    for check in (check_job_id, check_sha256, check_owner):
        try:
            check(text)
        except BadNameError:
            continue
        assert text.isascii()
        assert not set(text) & set("/\\.\0\n ")


def test_event_and_record_survive_their_json():
    event = JobEvent(3, now(), "state", JobState.FAILED, JobState.RENDERING, "w", {"type": "x", "tile": 3})
    assert JobEvent.from_json(event.to_json()) == event
    record = JobRecord(new_job_id(), "me", now(), None, "0" * 64, 8, 8, 0, 0, 8, 8, 1, {"tile_size": 16}, 50, 1)
    assert JobRecord.from_json(record.to_json()) == record


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b"null", b'{"seq": 1', b'{"state": "no", "previous": null}'])
def test_damaged_json_is_told(data: bytes):
    with pytest.raises(DamagedRecordError):
        JobEvent.from_json(data)
    with pytest.raises(DamagedRecordError):
        JobRecord.from_json(data)


def test_seconds_between_times():
    assert seconds_between("2026-01-01T00:00:00.250000Z", "2026-01-01T00:01:00.750000Z") == 60.5
