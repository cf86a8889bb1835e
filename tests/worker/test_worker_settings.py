"""The farm's settings: the same in every process, and of one mind with the tracer."""

from pathlib import Path

import pytest

from tracer.paths import cache_root
from worker.settings import FarmSettings


@pytest.mark.parametrize(
    ("own", "shared", "expected"),
    [("own", "shared", "own"), (None, "shared", "shared/smalti"), (None, None, "home/.cache/smalti")],
)
def test_caches_are_where_the_tracer_has_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own: str | None, shared: str | None, expected: str
):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name, value in {"SMALTI_CACHE": own, "XDG_CACHE_HOME": shared}.items():
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, str(tmp_path / value))
    assert FarmSettings().cache == cache_root() == tmp_path / expected


def test_settings_reach_children_through_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    settings = FarmSettings(store=tmp_path / "a store", backend="fake", workers=3, api=False, ready_file=tmp_path / "r")
    environment = settings.child_environment({"OTHER": "kept"}, redis_url="unix:///a%20b", ready_file=None)
    assert environment["OTHER"] == "kept"
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert FarmSettings() == settings.model_copy(update={"redis_url": "unix:///a%20b", "ready_file": None})


def test_setting_that_is_none_is_not_inherited():
    environment = FarmSettings(redis_url=None).child_environment({"SMALTI_REDIS_URL": "redis://elsewhere"})
    assert "SMALTI_REDIS_URL" not in environment
