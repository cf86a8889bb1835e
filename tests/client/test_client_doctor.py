"""The doctor: what it finds here, and what it says of what is wrong."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from client import cli, doctor, local


def smalti(*arguments: Any) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], prog_name="smalti")


def levels(findings: list[doctor.Finding]) -> dict[str, str]:
    return {finding.what: finding.level for finding in findings}


def test_doctor_finds_this_installation_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SMALTI_URL", "")
    found = levels(doctor.examine())
    assert found.pop("service") in {"ok", "note"}
    assert set(found) == {"python", "versions", "packages", "processor", "kernel cache", "data", "disk"}
    assert "bad" not in found.values()
    assert found["data"] == "note", "there is none here"
    (tmp_path / "seed").mkdir()
    monkeypatch.setenv("SMALTI_DATA", str(tmp_path))
    assert levels(doctor.examine())["data"] == "ok"


def test_doctor_sees_a_shadowed_package(tmp_path: Path) -> None:
    (tmp_path / "worker.py").write_text("")
    code = (
        "import sys; sys.path.insert(0, '.'); from client import doctor; print(*[f.text for f in doctor._packages()])"
    )
    environment = {**__import__("os").environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment, check=True
    )
    assert "`worker` is shadowed" in result.stdout
    assert str(tmp_path) in result.stdout


def test_doctor_goes_on_after_a_check_that_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    def explode() -> Any:
        raise OSError("kaboom")

    monkeypatch.setattr(doctor, "_processor", explode)
    found = doctor.examine()
    assert ("bad", "processor", "OSError: kaboom") in [(one.level, one.what, one.text) for one in found]
    assert "disk" in levels(found)


def cache_findings(monkeypatch: pytest.MonkeyPatch, **fields: Any) -> list[tuple[str, str]]:
    given = {"image_bytes": 0, "compile_s": 0.0, "fault": "", "files": 0, "size": 0, "is_writable": True, **fields}
    cache = local.KernelCache(key="0123abcd", folder=Path("/cache/kernels/0123abcd"), **given)
    monkeypatch.setattr(local, "kernel_cache", lambda: cache)
    return [(one.level, one.text) for one in doctor.examine() if one.what == "kernel cache"]


def test_doctor_tells_of_the_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    [(level, text)] = cache_findings(monkeypatch, image_bytes=150_000, compile_s=58.0)
    assert (level, "0123abcd of 150 kB, compiled in 58.0 s" in text, "/cache/kernels" in text) == ("ok", True, True)
    [(level, text)] = cache_findings(monkeypatch, fault="/cache/kernels/0123abcd/a.image is damaged")
    assert (level, "is damaged; `smalti warm`" in text) == ("note", True)
    [(level, text)] = cache_findings(monkeypatch, files=7, size=2_000_000)
    assert (level, "7 files" in text, "`smalti warm`" in text) == ("note", True, True)
    found = cache_findings(monkeypatch, is_writable=False)
    assert [level for level, _ in found] == ["note", "bad"]
    assert "the first render compiles" in found[0][1]
    assert "SMALTI_CACHE" in found[1][1]


def test_doctor_says_that_a_named_service_is_missing() -> None:
    result = smalti("doctor", "--url", "http://127.0.0.1:9", "--json")
    assert result.exit_code == 1
    assert {"bad"} == {one["level"] for one in json.loads(result.stdout) if one["what"] == "service"}
