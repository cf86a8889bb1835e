"""A Valkey of our own: private, one a store, back after a kill."""

import stat
from pathlib import Path

import pytest

from worker import embedded
from worker.embedded import EmbeddedServer
from worker.errors import ServerStartError, StoreInUseError
from worker.queue import Queue


def test_server_is_private_and_keeps_its_data(tmp_path: Path):
    server = EmbeddedServer(tmp_path / "v")
    server.start()
    try:
        assert stat.S_IMODE((tmp_path / "v").stat().st_mode) == 0o700
        assert stat.S_IMODE(server.socket.stat().st_mode) == 0o700
        queue = Queue(server.url)
        settings = queue.redis.config_get()
        assert (settings["port"], settings["appendonly"], settings["maxmemory-policy"]) == ("0", "yes", "noeviction")
        queue.redis.set("a", "b")
    finally:
        server.close()
    again = EmbeddedServer(tmp_path / "v")
    again.start()
    try:
        assert Queue(again.url).redis.get("a") == b"b"
    finally:
        again.close()


def test_second_server_on_a_store_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    server = EmbeddedServer(tmp_path / "v")
    monkeypatch.setattr(EmbeddedServer._take_lock, "__defaults__", (0.1,))
    with pytest.raises(StoreInUseError):
        EmbeddedServer(tmp_path / "v")
    server.close()


def test_long_path_gets_a_short_socket(tmp_path: Path):
    folder = tmp_path / ("x" * 100) / "v w"
    server = EmbeddedServer(folder)
    server.start()
    try:
        assert Queue(server.url).ping()
        assert len(str(server.socket)) < 104
        temporary = server.socket.parent
    finally:
        server.close()
    assert not temporary.exists()


def test_path_with_spaces(tmp_path: Path):
    server = EmbeddedServer(tmp_path / "a b" / "v")
    server.start()
    try:
        assert Queue(server.url).ping()
    finally:
        server.close()


def test_failed_start_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    server = EmbeddedServer(tmp_path / "v")
    (tmp_path / "v" / "appendonlydir").write_text("not a folder")
    with pytest.raises(ServerStartError, match=r"appendonlydir|Valkey did not come up"):
        server.start(timeout_s=5.0)
    server.close()
    assert embedded._MAX_SOCKET_PATH < 104
