"""The demonstration: pictures and a table at the end, and nothing left behind however it ends."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from client import cli

pytestmark = pytest.mark.farm


def run_demo(tmp_path: Path, name: str) -> "subprocess.Popen[str]":
    camera = {"type": "perspective", "fov_deg": 40}
    document = {"version": 1, "name": name, "camera": camera, "image": {"width": 256, "height": 128}}
    (tmp_path / "demo.json").write_text(json.dumps(document))
    command = [sys.executable, "-m", "client", "demo", str(tmp_path / "demo.json"), "-o", str(tmp_path / "out")]
    environment = {**os.environ, "SMALTI_BACKEND": "fake", "TMPDIR": str(tmp_path)}
    environment["PYTHONPATH"] = str(Path(cli.__file__).parents[1])
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
    )


def left_behind(tmp_path: Path) -> list[str]:
    """Command lines of processes that speak of this test's folder."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                text = (folder / "cmdline").read_bytes() + (folder / "environ").read_bytes()
            except OSError:
                continue
            if str(tmp_path).encode() in text:
                found.append(folder.name)
    return found


def test_demo_writes_pictures_and_a_table_and_leaves_nothing(tmp_path: Path) -> None:
    process = run_demo(tmp_path, "fake")
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert (tmp_path / "out/demo.png").exists()
    assert (tmp_path / "out/demo.exr").exists()
    assert "Where the time went" in output
    assert "Skipped" in output
    assert "succeeded, 8/8 tiles" in errors
    assert "\x1b" not in output + errors
    assert left_behind(tmp_path) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demo.json", "out"]


def test_demo_is_interrupted_and_leaves_nothing(tmp_path: Path) -> None:
    process = run_demo(tmp_path, "fake tile_s=60")
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("rendering"):
            break
    while process.poll() is None:  # people are impatient: up to the very end of the process
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of its group
        time.sleep(0.02)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert left_behind(tmp_path) == []


def test_demo_that_is_killed_takes_its_service_along(tmp_path: Path) -> None:
    process = run_demo(tmp_path, "fake tile_s=60")
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("rendering"):
            break
    process.kill()
    process.communicate(timeout=60)
    deadline = time.monotonic() + 20
    while left_behind(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert left_behind(tmp_path) == []
