"""The real renderer as the farm sees it."""

from pathlib import Path
from typing import Any

import pytest

from tracer.scene import parse_scene
from worker import tracing


def refuse(_asset: Any) -> Path:
    raise AssertionError("the scene has no files")


def test_the_cache_is_trimmed_when_it_has_grown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimmed = []
    monkeypatch.setattr(tracing, "trim_cache", lambda folder, limit: trimmed.append((folder, limit)))
    scene = parse_scene(
        {
            "version": 1,
            "camera": {"type": "perspective", "fov_deg": 40},
            "image": {"width": 16, "height": 16},
            "objects": [{"type": "sphere", "center": [0, 0, -3], "radius": 1}],
        }
    )
    backend = tracing.TracerBackend("cpu")
    assert backend.compile(scene, refuse, tmp_path)[1]["from_cache"] is False
    assert backend.compile(scene, refuse, tmp_path)[1]["from_cache"] is True
    assert trimmed == [(tmp_path / "scenes", tracing.MAX_CACHE_BYTES)]
    assert list(trimmed[0][0].glob("scenes/*.arrays")), "the folder that is trimmed is the one that is filled"
