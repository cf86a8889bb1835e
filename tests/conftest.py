"""What all tests need of the process that they run in."""

import signal
from collections.abc import Iterator

import pytest

# Shells start background jobs with SIGINT ignored, and children inherit that: tests that press Ctrl-C would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """Put back what handles signals: a command or a worker within a test changes it as its own process may."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
