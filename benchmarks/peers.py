"""What `benchmarks.jobs` asks of a peer: a picture of the mirror box, what it cost, what it looks like.

`Mitsuba` runs `peer_mitsuba.py` under an interpreter of its own; `peer_povray` and `peer_tachyon` start a program for
each picture. Invariant: seconds are CPU time of the peer's process, user and system; no peer is needed for anything.
"""

import json
import os
import re
import resource
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrorbox
from benchmarks.data import REPOSITORY

MITSUBA_PYTHON = "SMALTI_MITSUBA_PYTHON"
_PPM = re.compile(rb"P6\s(?:#[^\n]*\n)*(\d+)\s+(\d+)\s+65535\s")


class Turn(NamedTuple):
    """CPU seconds of one picture; of all else that a program started for it does, where it is one."""

    picture_s: float
    reading_s: float | None = None  # reading the scene and building what is searched
    process_s: float | None = None  # from the start of the process to its end


class AbsentError(Exception):
    """A peer is not installed; the text says how to have it."""


class Peer(Protocol):
    """Renders the mirror box as often as it is told to."""

    name: str
    version: str  # empty before the first picture

    def render(self) -> Turn:
        """Render once.

        Raises
        ------
        RuntimeError
            The peer ended without a picture, with the last line that it said.
        """

    def picture(self) -> NDArray[np.float64]:
        """Return the last picture: (rows, columns, 3), linear."""

    def close(self) -> None:
        """End what still runs."""


class Mitsuba:
    """Mitsuba in a process of its own, which reads and compiles the scene once.

    Raises
    ------
    AbsentError
        ``python`` is None.
    """

    name = "Mitsuba"

    def __init__(self, python: str | None, scene: list[mirrorbox.Part], folder: Path, size: int, samples: int) -> None:
        if python is None:
            raise AbsentError(f"set {MITSUBA_PYTHON} to an interpreter with it (`pip install mitsuba`)")
        arrays, self.path = folder / "scene.npz", folder / "mitsuba.npy"
        mirrorbox.write_arrays(arrays, scene, size, samples)
        self.version = ""
        self.process = subprocess.Popen(
            [python, str(REPOSITORY / "benchmarks" / "peer_mitsuba.py"), str(arrays), str(self.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def render(self) -> Turn:
        """Render once, by the process that runs."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        try:
            self.process.stdin.write("\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise RuntimeError(last_line(self.process.stderr.read()))
        facts = json.loads(answer)
        self.version = f"{facts['version']} llvm_ad_rgb"
        return Turn(float(facts["cpu_s"]))

    def picture(self) -> NDArray[np.float64]:
        """Return the last picture."""
        pixels: NDArray[np.float64] = np.load(self.path).astype(np.float64)
        return pixels

    def close(self) -> None:
        """End the process."""
        self.process.communicate()  # closes its input; a process that has ended before is no error


def find_program(variable: str, name: str, package: str) -> str:
    """Return the path of a program: the one that an environment variable names, else the one on the PATH.

    Raises
    ------
    AbsentError
        There is none.
    """
    wanted = os.environ.get(variable) or name
    found = shutil.which(wanted)
    if found is None:
        raise AbsentError(f"no program `{wanted}`: `apt-get install {package}`, or name one by {variable}")
    return found


def run_program(command: list[str], folder: Path) -> tuple[float, str]:
    """Run a program in a folder to its end; returns (CPU seconds, what it said).

    Raises
    ------
    RuntimeError
        It failed, with its exit status and the last line that it said.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"exit status {done.returncode}: {last_line(done.stdout)}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def last_line(text: str) -> str:
    """Return the last line that is not empty."""
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it said nothing"


def version_of(text: str) -> str:
    """Return the version that a program tells among what it said."""
    found = re.search(r"Version (\S+)", text)
    return found[1] if found else "of an unknown version"


def read_ppm(path: Path) -> NDArray[np.float64]:
    """Return a 16-bit PPM's values over 65535: (rows, columns, 3).

    Raises
    ------
    RuntimeError
        It is no such file.
    """
    data = path.read_bytes()
    header = _PPM.match(data)
    if header is None:
        raise RuntimeError(f"{path.name}: expected a binary PPM of 16 bits")
    width, height = int(header[1]), int(header[2])
    values = np.frombuffer(data, ">u2", 3 * width * height, offset=header.end())
    return values.reshape(height, width, 3) / 65535.0
