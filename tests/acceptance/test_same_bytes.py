"""The same picture, byte for byte, whatever the tile size, the number of workers and the way it was rendered.

Everything is real: kernels, Valkey, worker processes, HTTP. The picture's sides are no multiples of any tile, and a crop is
tried as well.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
from real_scene import BOX

from client import Client
from client.launch import service

pytestmark = pytest.mark.farm

SCENE: dict[str, Any] = {**BOX, "image": {"width": 298, "height": 170}, "sampling": {"samples": 9, "seed": 5}}
CROPPED: dict[str, Any] = {
    **SCENE,
    "image": {**SCENE["image"], "crop": {"x": 37, "y": 21, "width": 150, "height": 90}},
}
ADAPTIVE: dict[str, Any] = {**SCENE, "sampling": {**SCENE["sampling"], "adaptive": {"threshold": 0.05}}}
LONG: dict[str, Any] = {**SCENE, "sampling": {"samples": 400, "seed": 5}}


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def rendered_here(scene: dict[str, Any], folder: Path, *options: str) -> tuple[str, str]:
    """PNG and EXR of `smalti render`."""
    folder.mkdir()
    document = folder / "scene.json"
    document.write_text(json.dumps(scene))
    png, exr = folder / "out.png", folder / "out.exr"
    command = [sys.executable, "-m", "client", "render", str(document), "-o", str(png), "-o", str(exr), "-q", *options]
    subprocess.run(command, check=True, cwd=Path(__file__).parents[2], timeout=200)
    return sha256(png), sha256(exr)


def rendered_there(client: Client, scene: dict[str, Any], folder: Path, tile_size: int = 64) -> tuple[str, str, str]:
    """PNG, EXR and film hash of the service."""
    job = client.submit(scene, output={"tile_size": tile_size})
    client.wait(job.id, timeout_s=150)
    return fetched(client, job.id, folder)


def fetched(client: Client, job_id: str, folder: Path) -> tuple[str, str, str]:
    png, exr = folder / f"{job_id}.png", folder / f"{job_id}.exr"
    client.get(job_id, png)
    client.get(job_id, exr)
    return sha256(png), sha256(exr), client.report(job_id)["film_sha256"]


def a_busy_worker(url: str) -> int:
    """Process id of a worker that has a tile in hand."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        for worker in httpx.get(f"{url}/v1/workers", timeout=10).json()["workers"]:
            if worker["job_id"] and worker["tile"] is not None:
                return int(worker["pid"])
        time.sleep(0.02)
    raise AssertionError("no worker took a tile")


def test_tiles_workers_ways_and_a_killed_worker(tmp_path: Path) -> None:
    here = rendered_here(SCENE, tmp_path / "whole", "--threads", "1")
    assert rendered_here(SCENE, tmp_path / "threads", "--threads", "2", "--tile-size", "96") == here
    cropped = rendered_here(CROPPED, tmp_path / "crop")
    long = rendered_here(LONG, tmp_path / "long")
    adaptive = rendered_here(ADAPTIVE, tmp_path / "adaptive")
    assert len({here, cropped, long, adaptive}) == 4
    films = set()
    for workers in (1, 2, 4):
        with service(workers=workers) as running, Client(running.url) as client:
            for tile_size in (16, 64, 96, 256) if workers == 2 else (64,):
                *files, film = rendered_there(client, SCENE, tmp_path, tile_size)
                assert tuple(files) == here, f"{workers} workers, tiles of {tile_size}"
                films.add(film)
            if workers == 2:
                assert rendered_there(client, CROPPED, tmp_path)[:2] == cropped
                for tile_size in (16, 96):
                    assert rendered_there(client, ADAPTIVE, tmp_path, tile_size)[:2] == adaptive
            if workers == 4:
                job = client.submit(LONG, output={"tile_size": 32})
                os.kill(a_busy_worker(running.url), signal.SIGKILL)
                client.wait(job.id, timeout_s=150)
                assert fetched(client, job.id, tmp_path)[:2] == long
    assert len(films) == 1
