"""The real renderer as the farm sees it."""

from pathlib import Path
from typing import Any

import pytest

from tracer.scene import parse_scene
from worker import tracing
from worker.backends import SceneFaultError

SCENE = {
    "version": 1,
    "camera": {"type": "perspective", "fov_deg": 40},
    "image": {"width": 16, "height": 16},
}


def refuse(_asset: Any) -> Path:
    raise AssertionError("the scene has no files")


def test_the_cache_is_trimmed_when_it_has_grown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimmed = []
    monkeypatch.setattr(tracing, "trim_cache", lambda folder, limit: trimmed.append((folder, limit)))
    scene = parse_scene({**SCENE, "objects": [{"type": "sphere", "center": [0, 0, -3], "radius": 1}]})
    backend = tracing.TracerBackend("cpu")
    assert backend.compile(scene, refuse, tmp_path)[1]["from_cache"] is False
    assert backend.compile(scene, refuse, tmp_path)[1]["from_cache"] is True
    assert trimmed == [(tmp_path / "scenes", tracing.MAX_CACHE_BYTES)]
    assert list(trimmed[0][0].glob("scenes/*.arrays")), "the folder that is trimmed is the one that is filled"


def test_figures_tell_how_long_the_kernels_took_to_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "compile_seconds", lambda: 58.25)
    assert tracing.TracerBackend("cpu").compile(parse_scene(SCENE), refuse, tmp_path)[1]["kernels_compile_s"] == 58.25


def test_an_unusable_file_is_told_with_place_reason_and_mend(tmp_path: Path) -> None:
    (tmp_path / "empty.obj").write_text("# nothing\n")
    asset = {"file": "empty.obj", "sha256": "ab" * 32}
    scene = parse_scene(
        {**SCENE, "objects": [{"type": "mesh_asset", "asset": "model"}], "assets": {"model": asset}},
        require_hashes=True,
    )
    with pytest.raises(SceneFaultError) as caught:
        tracing.TracerBackend("cpu").compile(scene, lambda ref: tmp_path / ref.file, tmp_path / "cache")
    assert caught.value.kind == "asset-invalid"
    assert caught.value.more == {
        "file": "empty.obj",
        "pointer": "/scene/objects/0/asset",
        "errors": [
            {
                "pointer": "/scene/objects/0/asset",
                "detail": "empty.obj: is empty: there are no vertices in it",
                "expected": "a mesh needs at least one triangle",
            }
        ],
    }
