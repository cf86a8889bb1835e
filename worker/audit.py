"""The audit after a fault: whether index and store agree, and nothing is left behind.

Job: one checker that every test of faults ends with, and that an operator may run at any time on a farm at rest.
Invariant: it changes nothing.
"""

import json
from itertools import pairwise
from typing import Any

from worker import contract
from worker.errors import DamagedRecordError, FarmError
from worker.queue import Queue
from worker.records import JobEvent
from worker.states import TERMINAL, JobState, can_transition
from worker.store import Store


def audit(store: Store, queue: Queue, *, at_rest: bool = True) -> list[str]:
    """Return what is wrong, one sentence each; empty when all is well.

    Parameters
    ----------
    store, queue
        The farm.
    at_rest
        Whether all jobs should have ended: then no lease, hint, claim or temporary file may be left either.
    """
    findings: list[str] = []
    open_jobs: set[str] = set()
    for job_id in store.job_ids():
        try:
            findings += _audit_job(store, queue, job_id)
            if store.last_event(job_id).state not in TERMINAL:
                open_jobs.add(job_id)
        except DamagedRecordError as error:
            findings.append(f"job {job_id}: {error}")
    findings += _audit_leases(queue)
    if at_rest:
        findings += [f"job {job_id} has not ended" for job_id in sorted(open_jobs)]
        findings += _audit_rest(store, queue)
    return findings


def _audit_job(store: Store, queue: Queue, job_id: str) -> list[str]:
    """Check one job's history, files and index."""
    findings = []
    events = store.events(job_id)
    if [event.seq for event in events] != list(range(1, len(events) + 1)):
        findings.append(f"job {job_id}: events are numbered {[event.seq for event in events]}")
    findings += _audit_history(job_id, events)
    state = events[-1].state
    progress = queue.progress(job_id)
    tiles = store.done_tiles(job_id)
    if state in TERMINAL:
        if progress is not None or job_id in queue.active_jobs():
            findings.append(f"job {job_id} is {state} and still in the index")
        if tiles:
            findings.append(f"job {job_id} is {state} and still has {len(tiles)} tiles")
        if state is JobState.SUCCEEDED:
            missing = [name for name in sorted(contract.RESULT_NAMES) if not store.has_result(job_id, name)]
            findings += [f"job {job_id} succeeded without {name}" for name in missing]
            if not missing:
                findings += _audit_report(store, job_id, events[-1])
    elif progress is not None:
        bits = int(queue.redis.bitcount(contract.KEY_DONE + job_id))
        if bits != progress.done:
            findings.append(f"job {job_id}: {progress.done} tiles counted done, {bits} marked")
        if bits > len(tiles):
            findings.append(f"job {job_id}: {bits} tiles marked done, {len(tiles)} on disk")
    return findings


def _audit_history(job_id: str, events: list[JobEvent]) -> list[str]:
    """Check that the states follow each other as the table says, and that nothing follows the end."""
    findings = []
    for before, event in pairwise(events):
        is_legal = can_transition(before.state, event.state) if event.type == "state" else event.state is before.state
        if not is_legal or event.previous is not before.state or before.state in TERMINAL:
            findings.append(
                f"job {job_id}: event {event.seq} ({event.type}) leads from {before.state} to {event.state}"
            )
    return findings


def _audit_report(store: Store, job_id: str, last: JobEvent) -> list[str]:
    """Check that report and last event tell of the same picture, with each tile counted once."""
    report: dict[str, Any] = json.loads(store.result_path(job_id, contract.REPORT).read_bytes())
    findings = []
    if report["film_sha256"] != (last.detail or {}).get("film_sha256"):
        findings.append(f"job {job_id}: report and event name different pictures")
    n_tiles = store.read_job(job_id).n_tiles
    if report["tiles"]["n"] != n_tiles or sum(report["tiles"]["workers"].values()) != n_tiles:
        findings.append(f"job {job_id}: report counts {report['tiles']} of {n_tiles} tiles")
    return findings


def _audit_leases(queue: Queue) -> list[str]:
    """Check that no tile has two owners and that each lease has a deadline."""
    leases = queue.leases()
    owned = list(leases.values())
    raw: Any = queue.redis.zrange(contract.KEY_DEADLINES, 0, -1)
    deadlines = {name.decode() for name in raw}
    findings = [f"{lease} has two owners" for lease in sorted(set(owned), key=str) if owned.count(lease) > 1]
    if deadlines != set(leases):
        findings.append(f"leases of {sorted(leases)} but deadlines of {sorted(deadlines)}")
    return findings


def _audit_rest(store: Store, queue: Queue) -> list[str]:
    """Check that a farm at rest has nothing in hand."""
    findings = [f"{worker} still has {lease}" for worker, lease in queue.leases().items()]
    allowed = {contract.KEY_EPOCH, contract.KEY_STORE, contract.KEY_WORKERS, "rq:queues"}
    keys = {key.decode() for key in queue.redis.scan_iter(count=1000)}
    # Hints of a job that has ended find nothing to do; they may still be on their way.
    findings += [f"key {key} is left" for key in sorted(keys - allowed) if not key.startswith("rq:queue:")]
    findings += [f"{path.name} is left in tmp" for path in store.temporary.iterdir()]
    return findings


def assert_sound(store: Store, queue: Queue, *, at_rest: bool = True) -> None:
    """Raise `FarmError` with all findings, if there are any."""
    findings = audit(store, queue, at_rest=at_rest)
    if findings:
        raise FarmError("\n".join(findings))
