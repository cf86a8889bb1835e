"""Every pathological model through the real service: a picture, or a problem that names the file and the reason.

Models that the client would refuse to send are sent all the same, by plain HTTP.
"""

import csv
import hashlib
import json
import math
import os
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import OpenImageIO
import pytest

from client.launch import service

pytestmark = pytest.mark.farm

DATA = Path(os.environ.get("SMALTI_DATA", Path(__file__).parents[3] / "shared"))
MODELS = {".obj", ".glb", ".gltf", ".stl", ".ply", ".off"}
REFUSED = {
    "BoxWithInfinites.glb",
    "IndexOutOfRange.gltf",
    "MissingBin.gltf",
    "NoScene.gltf",
    "OutOfMemory.off",
    "RecursiveNodes.gltf",
    "malformed.obj",
    "external_uri.gltf",
    "ply_lying_count.ply",
    "stl_lying_count.stl",
    "empty.obj",
    "empty.stl",
}


def camera(bounds: str) -> dict[str, Any]:
    """Look at a model from outside of its bounds, or from anywhere where these are not finite."""
    corners = np.array([float(word) for word in bounds.split()] or [math.nan] * 6)
    if not np.isfinite(corners).all():
        corners = np.array([-1.0, -1, -1, 1, 1, 1])
    center = (corners[:3] + corners[3:]) / 2
    radius = float(np.linalg.norm(corners[3:] - corners[:3])) or 1.0
    pose = {"eye": (center + np.array([0.5, 0.4, 1.4]) * radius).tolist(), "target": center.tolist()}
    return {"type": "perspective", "fov_deg": 45, "look_at": pose}


def put(http: httpx.Client, path: Path) -> str:
    data = path.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    assert http.put(f"/v1/assets/{sha256}", content=data).status_code in {200, 201}
    return sha256


def test_each_is_rendered_or_refused_by_name(tmp_path: Path) -> None:
    folder = DATA / "models" / "pathological"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set SMALTI_DATA to a folder with the test models (models/pathological)")
    with (DATA / "models" / "MANIFEST.csv").open() as manifest:
        bounds = {row["file"]: row["bounds_min_max"] for row in csv.DictReader(manifest)}
    models = sorted(path for path in folder.rglob("*") if path.suffix.lower() in MODELS)
    assert len(models) == 41
    with service(workers=2) as running, httpx.Client(base_url=running.url, timeout=90) as http:
        for model in models:
            beside = [path for path in model.parent.glob(f"{model.stem}.*") if path != model]
            asset = {
                "file": model.name,
                "sha256": put(http, model),
                "companions": {path.name: put(http, path) for path in beside},
            }
            scene = {
                "version": 1,
                "camera": camera(bounds[model.relative_to(folder.parent).as_posix()]),
                "image": {"width": 48, "height": 32},
                "sampling": {"samples": 1},
                "lights": [{"type": "ambient", "intensity": 1}, {"type": "directional", "direction": [-1, -2, -3]}],
                "objects": [{"type": "mesh_asset", "asset": "model"}],
                "assets": {"model": asset},
            }
            began = time.monotonic()
            answer = http.post("/v1/jobs", json={"scene": scene}, headers={"Prefer": "wait=60"})
            seconds = time.monotonic() - began
            job = answer.json()
            assert answer.status_code == 200, (model.name, job)
            assert seconds < 30.0, (model.name, seconds)
            if model.name in REFUSED:
                assert job["state"] == "failed", model.name
                problem = job["problem"]
                assert model.name in json.dumps(problem), (model.name, problem)
                assert problem["pointer"].startswith(("/objects/0", "/scene/objects/0", "/scene/assets", "/assets"))
                assert len(problem["detail"]) > 15, problem
                assert problem["errors"][0]["expected"], problem
            else:
                assert job["state"] == "succeeded", (model.name, job["problem"])
                picture = tmp_path / "picture.exr"
                picture.write_bytes(http.get(f"/v1/jobs/{job['id']}/result.exr").content)
                pixels = OpenImageIO.ImageBuf(str(picture)).get_pixels(OpenImageIO.FLOAT)
                assert np.isfinite(pixels).all(), model.name
                # Slivers of 1e-9 fall between the samples.
                assert pixels.max() > 0.0 or model.name == "slivers.obj", f"{model.name}: nothing to be seen"
        # The service is up, and its workers are the ones that it began with (a restart adds to the number in the name).
        assert http.get("/readyz").status_code == 200
        names = [worker["name"] for worker in http.get("/v1/workers").json()["workers"]]
        assert len(names) == 2
        assert all(name.endswith(".1") for name in names), names
