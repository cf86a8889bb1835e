"""``make mutants`` (N25): break the numerics in a copy, one small change at a time; the suite must fail each.

    python -m tests.numerics.mutants [--only NAME,NAME] [--list]

What must notice is the stress suite at its small size or, where that does not reach, the unit test that is named. Each
mutant compiles the kernels that its tests use anew: half a minute to two minutes apiece. A run without an end is noticed, too.
Invariants: the sources here are never touched; a change that no longer fits the sources is an error, not a pass; nor is
a test that fails otherwise than by an assertion.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.numerics.mutant_list import MUTANTS, Mutant

REPOSITORY = Path(__file__).parents[2]
NO_END_S = 600.0  # compiled and run several times over


def _verdict(tests: str, done: "subprocess.CompletedProcess[str]") -> str:
    """What a run of tests says: "caught by ...", "SURVIVED" or "BROKEN: ..."."""
    if tests.startswith("tests/"):
        if done.returncode == 1 and re.search(r"AssertionError|: assert ", done.stdout):
            return "caught by " + tests.rpartition("/")[2]
    else:
        caught = [line.split()[0] for line in done.stdout.splitlines() if line.split()[1:2] == ["FAIL"]]
        if caught:
            return f"caught by {', '.join(caught)}"
    if done.returncode:
        told = (done.stderr.strip() or done.stdout.strip()).splitlines()
        return f"BROKEN: {(told or ['no message'])[-1]}"
    return "SURVIVED"


def apply(mutant: Mutant, tracer: Path) -> None:
    """Change a copy of the sources.

    Raises
    ------
    ValueError
        The sources no longer hold what the mutant changes.
    """
    path = tracer / mutant.file
    text = path.read_text()
    if mutant.before not in text:
        raise ValueError(f"{mutant.name}: {mutant.file} no longer holds {mutant.before!r}")
    path.write_text(text.replace(mutant.before, mutant.after))


def try_mutant(mutant: Mutant, folder: Path) -> str:
    """Apply a mutant to a copy and run its tests there; returns the verdict."""
    for name in ("tracer", "benchmarks", "tests", "worker"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "results"))
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    apply(mutant, folder / "tracer")
    variables = {**os.environ, "SMALTI_CACHE": str(folder / "cache"), "PYTHONPATH": str(folder)}
    if mutant.tests.startswith("tests/"):
        options = ["-x", "--tb=line", "-n0", "-p", "no:cacheprovider", f"--timeout={NO_END_S:.0f}"]
        command = [sys.executable, "-m", "pytest", *options, mutant.tests]
    else:
        command = [sys.executable, "-m", "tests.numerics", "--scale", "0", "--processes", "1", "--only", mutant.tests]
    with subprocess.Popen(
        command,
        cwd=folder,
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        try:
            output, errors = running.communicate(timeout=NO_END_S)
        except subprocess.TimeoutExpired:
            return f"caught by {mutant.tests}: no end in {NO_END_S:.0f} s"
        finally:
            if running.poll() is None:
                os.killpg(running.pid, signal.SIGKILL)  # the stress suite's processes, too
    return _verdict(mutant.tests, subprocess.CompletedProcess(command, running.returncode, output, errors))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(mutant.name for mutant in MUTANTS))
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    names = set(options.only.split(","))
    if options.list:
        print("\n".join(f"{mutant.name:30s} {mutant.file:24s} {mutant.tests}" for mutant in MUTANTS))
        return 0
    failed = 0
    for mutant in (mutant for mutant in MUTANTS if mutant.name in names):
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            verdict = try_mutant(mutant, Path(folder))
        failed += not verdict.startswith("caught")
        print(f"{mutant.name:30s} {verdict} ({time.perf_counter() - start:.0f} s)", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
