"""Rendering in process: pictures, threads, overrides, faults, and Ctrl-C."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from client import cli

SCENE = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40, "look_at": {"eye": [0, 0, 5], "target": [0, 0, 0]}},
    "image": {"width": 40, "height": 24},
    "sampling": {"samples": 2},
    "lights": [{"type": "directional", "direction": [-1, -1, -1]}],
    "objects": [{"type": "sphere", "center": [0, 0, 0], "radius": 1}],
}


def smalti(*arguments: Any) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], prog_name="smalti")


def write(folder: Path, **changes: Any) -> Path:
    path = folder / "scene.json"
    path.write_text(json.dumps({**SCENE, **changes}))
    return path


def test_render_writes_pictures_and_a_report(tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    targets = [tmp_path / "new/a.png", tmp_path / "new/a.exr", tmp_path / "new/a.json"]
    result = smalti("render", write(tmp_path), *[one for target in targets for one in ("-o", target)])
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [f"wrote {target}" for target in targets]
    assert targets[0].read_bytes().startswith(b"\x89PNG")
    assert targets[1].read_bytes().startswith(b"\x76\x2f\x31\x01")
    report = json.loads(targets[2].read_text())
    assert report["image"] == {"width": 40, "height": 24}
    assert report["rays"]["primary_rays"] > 0
    assert sorted(path.name for path in targets[0].parent.iterdir()) == ["a.exr", "a.json", "a.png"]


def test_bytes_do_not_depend_on_threads(tmp_path: Path) -> None:
    scene = write(tmp_path)
    for threads in (1, 3):
        assert smalti("render", scene, "-o", tmp_path / f"{threads}.exr", "--threads", threads).exit_code == 0
    assert (tmp_path / "1.exr").read_bytes() == (tmp_path / "3.exr").read_bytes()


def test_overrides_and_json(tmp_path: Path) -> None:
    options = ("--samples", 1, "--size", "16x16", "--png", "linear", "--json")
    result = smalti("render", write(tmp_path), "-o", tmp_path / "a.png", *options)
    report = json.loads(result.stdout)
    assert (report["samples"], report["image"]) == (1, {"width": 16, "height": 16})
    assert len(report["film_sha256"]) == 64
    smalti("render", write(tmp_path), "-o", tmp_path / "b.png", "--samples", 1, "--size", "16x16")
    assert (tmp_path / "a.png").read_bytes() != (tmp_path / "b.png").read_bytes(), "linear and sRGB differ"


def test_a_model_and_its_companions_are_used(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("mtllib my lib.mtl\nv -1 -1 0\nv 1 -1 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    (tmp_path / "my lib.mtl").write_text("newmtl red\nKd 1 0 0\nKa 0 0 0\n")
    objects = [{"type": "mesh_asset", "asset": "m"}]
    scene = write(
        tmp_path,
        objects=objects,
        assets={"m": {"file": "m.obj"}},
        lights=[{"type": "directional", "direction": [0, 0, -1]}],
    )
    result = smalti("render", scene, "-o", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    from PIL import Image

    with Image.open(tmp_path / "a.png") as picture:
        red, green, _ = picture.getpixel((20, 12))
    assert red > 200
    assert green == 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"camera": {"type": "perspective", "fov_deg": 400}}, "/camera/fov_deg"),
        ({"objects": [{"type": "mesh_asset", "asset": "m"}], "assets": {"m": {"file": "no.obj"}}}, "/assets/m/file"),
        ({"objects": [{"type": "mesh_asset", "asset": "m"}], "assets": {"m": {"file": "bad.obj"}}}, "bad.obj"),
        (
            {
                "objects": [{"type": "mesh_asset", "asset": "m"}],
                "assets": {"m": {"file": "no.obj", "sha256": "a" * 64}},
            },
            "/assets/m/file",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    result = smalti("render", write(tmp_path, **changes), "-o", tmp_path / "a.png")
    assert result.exit_code == 3, result.output
    assert told in result.stderr
    assert not (tmp_path / "a.png").exists()


def test_unwritable_output(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = smalti("render", write(tmp_path), "-o", tmp_path / "file/a.png")
    assert result.exit_code == 2
    assert "there is no folder" in result.stderr
    assert "Traceback" not in result.output


def test_no_folder_is_made_and_nothing_rendered_for_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("client.local.render_to_files", lambda *_, **__: pytest.fail("rendered"))
    result = smalti("render", write(tmp_path), "-o", tmp_path / "none/deep/a.png")
    assert result.exit_code == 2
    assert f"there is no folder {tmp_path}/none/deep" in result.stderr
    assert not (tmp_path / "none").exists()


def test_ctrl_c_stops_the_kernels_at_once(tmp_path: Path) -> None:
    scene = write(tmp_path, image={"width": 2000, "height": 2000}, sampling={"samples": 65536})
    command = [sys.executable, "-m", "client", "render", str(scene), "-o", str(tmp_path / "a.png"), "--threads", "1"]
    environment = {**__import__("os").environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("preparing"):
            break
    time.sleep(3.0)
    started = time.monotonic()
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    assert time.monotonic() - started < 10
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert not (tmp_path / "a.png").exists()


# doctor
