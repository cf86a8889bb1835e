"""What all tests need of the process that they run in."""

import signal
from collections.abc import Iterator

import pytest

# Shells start background jobs with SIGINT ignored, and children inherit that: tests that press Ctrl-C would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def ctrl_c_stays_as_it_was() -> Iterator[None]:
    """Fail the test that leaves Ctrl-C changed, not the ones after it."""
    yield
    assert signal.signal(signal.SIGINT, signal.default_int_handler) is signal.default_int_handler
