"""A service of one's own for a while."""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from client import launch
from client.errors import SmaltiError
from client.launch import service

pytestmark = pytest.mark.farm


FAKE = {"SMALTI_BACKEND": "fake"}


def test_a_service_that_cannot_start_says_why() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(SmaltiError, match="ended with status 8") as caught,
        service(port=taken.getsockname()[1], environment=FAKE),
    ):
        pass
    assert "in use" in str(caught.value)


def test_what_it_is_given_and_what_it_leaves(tmp_path: Path) -> None:
    slow: list[None] = []
    with service(workers=1, folder=tmp_path, environment=FAKE, slow=lambda: slow.append(None)) as running:
        assert running.folder == tmp_path
        assert json.loads((tmp_path / "ready.json").read_bytes())["url"] == running.url
        assert os.getpgid(running.pid) == running.pid, "Ctrl-C does not reach it"
    with pytest.raises(ProcessLookupError):
        os.kill(running.pid, 0)
    assert (tmp_path / "store" / "jobs").is_dir()
    assert slow == []
    begun: list[None] = []
    with service(workers=0, environment=FAKE, meanwhile=lambda: begun.append(None)) as own:
        assert own.folder.is_dir()
        assert begun == [None]
    assert not own.folder.exists()


def test_what_does_not_end_in_time_is_killed_with_its_group(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "STOP_LIMIT_S", 0.2)
    code = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, start_new_session=True)
    assert process.stdout is not None
    process.stdout.readline()
    launch.stop(process)
    assert process.returncode == -signal.SIGKILL
    launch.stop(process)  # it has ended: nothing to do
