"""The farm's processes by their command line."""

import json
import subprocess
import sys

from worker_farm import SmallFarm


def run(farm: SmallFarm, *arguments: str, redis_url: str | None = None) -> "subprocess.CompletedProcess[str]":
    environment = farm.settings.child_environment(redis_url=redis_url)
    command = [sys.executable, "-m", "worker.main", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


def test_a_role_without_a_server_says_what_to_set(farm: SmallFarm):
    ended = run(farm, "steward")
    assert ended.returncode == 2
    assert "SMALTI_REDIS_URL is not set" in ended.stderr


def test_audit_tells_by_its_status_whether_store_and_index_agree(farm: SmallFarm):
    sound = run(farm, "audit", redis_url=farm.queue.url)
    assert (sound.returncode, sound.stdout) == (0, ""), sound.stderr
    job_id = farm.submit()
    (farm.store.job_dir(job_id) / "job.json").write_text("[")
    damaged = run(farm, "audit", redis_url=farm.queue.url)
    assert damaged.returncode == 1
    assert job_id in damaged.stdout


def test_a_tile_is_done_again_in_the_foreground_without_a_server(farm: SmallFarm):
    job_id = farm.submit(width=32, height=16)
    ended = run(farm, "tile", job_id, "1")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["rect"] == [16, 0, 16, 16]
