"""Where bodies are parsed: small ones in a thread, large ones in a process of their own.

Job: keep the event loop answering while a body is parsed.
Invariant: the loop never runs the parser; no body holds the interpreter's lock for more than some tens of milliseconds.
Measured: 19 MB of inline mesh take 5 s to parse and write canonically, and within one thread block all others for up
to 0.9 s at a time (the JSON scanner does not give up the lock), and 600 MB of memory stay behind. A child costs
0.4 s and 30 MB, and takes its memory with it.
"""

import asyncio
import os
import pickle
import sys
from pathlib import Path
from typing import Final

import anyio.to_thread

from service import problems
from service.problems import Problem
from service.validation import ParsedJob, parse_job

# 512 KB hold the lock for some 30 ms at most, less than what the child's start costs.
_IN_THREAD_BYTES: Final = 512 * 1024
# A document at every limit takes 30 s on a slow core; more is a bug, not work.
_CHILD_TIMEOUT_S: Final = 120.0
_PACKAGE_ROOT: Final = str(Path(__file__).resolve().parents[1])
MAX_CHILDREN: Final = 2
"""Children at once: each may take a gigabyte for a body of 64 MB."""


def fits_thread(body: bytes) -> bool:
    """Whether a body is small enough to be parsed in a thread of this process."""
    return len(body) <= _IN_THREAD_BYTES


async def parse_in_child(body: bytes, slots: asyncio.Semaphore) -> ParsedJob:
    """Parse a large job request in a process of its own; raises the `Problem` of a bad one."""
    async with slots:
        return await _run_child(body)


async def _run_child(body: bytes) -> ParsedJob:
    child = await asyncio.create_subprocess_exec(
        sys.executable,
        "-c",
        "from service.parsing import child_main; child_main()",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        # The child finds this package even where the parent was started from another folder.
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [_PACKAGE_ROOT, os.environ.get("PYTHONPATH")]))},
    )
    try:
        async with asyncio.timeout(_CHILD_TIMEOUT_S):
            output, _ = await child.communicate(body)
    except TimeoutError:
        raise Problem(
            problems.REQUEST_INVALID, f"The body took longer than {_CHILD_TIMEOUT_S:g} s to validate."
        ) from None
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    if child.returncode != 0:
        raise RuntimeError(f"the parsing child ended with status {child.returncode}")
    outcome = await anyio.to_thread.run_sync(pickle.loads, output)
    if isinstance(outcome, Problem):
        raise outcome
    if not isinstance(outcome, ParsedJob):
        raise TypeError(type(outcome).__name__)
    return outcome


def child_main() -> None:
    """Read a body from standard input and write the pickled outcome; the whole life of a child."""
    outcome: ParsedJob | Problem
    try:
        outcome = parse_job(sys.stdin.buffer.read())
    except Problem as problem:
        outcome = problem
    sys.stdout.buffer.write(pickle.dumps(outcome))
    sys.stdout.buffer.flush()
