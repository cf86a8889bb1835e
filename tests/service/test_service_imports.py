"""The API process stays light: what it imports, in a process of its own."""

import json
import subprocess
import sys
from pathlib import Path

HEAVY = ("numpy", "numba", "llvmlite", "trimesh", "OpenImageIO", "PIL", "matplotlib")

SCRIPT = """
import asyncio, json, sys
import httpx
from service.app import create_app
from service.settings import ServiceSettings

app = create_app(ServiceSettings(store=sys.argv[1], redis_url=None, log_level="CRITICAL"))
scene = {"version": 1, "camera": {"type": "perspective", "fov_deg": 40}, "image": {"width": 4, "height": 3}}

async def main():
    transport = httpx.ASGITransport(app)
    async with app.router.lifespan_context(app), httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        statuses = []
        for method, path, body in [
            ("POST", "/v1/jobs?validate_only=true", {"scene": scene}),
            ("POST", "/v1/jobs", {"scene": scene}),
            ("POST", "/v1/jobs", {"scene": {}}),
            ("GET", "/v1/jobs", None),
            ("GET", "/v1/schema", None),
            ("GET", "/openapi.json", None),
            ("GET", "/docs", None),
            ("GET", "/metrics", None),
        ]:
            statuses.append((await client.request(method, path, json=body)).status_code)
        return statuses

print(json.dumps({"statuses": asyncio.run(main()), "modules": sorted(sys.modules)}))
"""


def test_the_api_never_loads_what_belongs_to_workers(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        cwd=root,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout.splitlines()[-1])
    assert outcome["statuses"] == [200, 202, 422, 200, 200, 200, 200, 200]
    loaded = {name.partition(".")[0] for name in outcome["modules"]}
    assert loaded.isdisjoint(HEAVY), sorted(loaded.intersection(HEAVY))
