"""httpx as the client imports it: without its command line, and whole otherwise."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_httpx_comes_without_rich_and_can_be_imported_as_usual_afterwards() -> None:
    code = """
import sys
from client.http import httpx
print(sorted({"rich", "click", "pygments", "httpx._main"} & set(sys.modules)), httpx.Client is not None)
import httpx._main
print("rich" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[] True", "True"]


def test_httpx_that_is_loaded_already_stays_as_it_is() -> None:
    code = (
        "import sys, httpx; from client.http import httpx as ours; print(ours is httpx, 'httpx._main' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True True"
