"""The transition table, over the whole product of states."""

import pytest

from worker.states import TERMINAL, TRANSITIONS, JobState, allowed_from, can_transition

# Written out once more by hand, so that a slip in the table is seen.
LEGAL = {
    "queued": "preparing canceling failed",
    "preparing": "rendering canceling failed",
    "rendering": "assembling canceling failed",
    "assembling": "succeeded canceling failed",
    "canceling": "canceled",
    "succeeded": "",
    "canceled": "",
    "failed": "",
}


@pytest.mark.parametrize("current", JobState)
@pytest.mark.parametrize("to", JobState)
def test_each_pair_is_legal_or_not(current: JobState, to: JobState):
    assert can_transition(current, to) is (str(to) in LEGAL[current].split())


def test_table_covers_all_states():
    assert set(TRANSITIONS) == set(JobState) == {JobState(name) for name in LEGAL}


def test_terminal_states_are_those_without_a_way_out():
    assert {state for state in JobState if not TRANSITIONS[state]} == TERMINAL


def test_every_state_is_reached_and_ends():
    reached = {JobState.QUEUED}
    while True:
        further = reached | {to for state in reached for to in allowed_from(state)}
        if further == reached:
            break
        reached = further
    assert reached == set(JobState)
    for start in JobState:
        state = start
        while state not in TERMINAL:
            state = allowed_from(state)[-1]


def test_allowed_from_is_in_the_order_of_the_states():
    assert allowed_from(JobState.RENDERING) == (JobState.ASSEMBLING, JobState.CANCELING, JobState.FAILED)
