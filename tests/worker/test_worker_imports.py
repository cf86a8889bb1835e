"""What the API imports of the farm is light, and what it may not import stays out."""

import subprocess
import sys

LIGHT = "contract states errors settings records store products uploads identity queue wire jobs grid files leases supervisor embedded"
HEAVY = "numpy numba trimesh OpenImageIO PIL tracer.types tracer.render"


def test_light_modules_load_nothing_heavy():
    code = f"""
import importlib, sys
for name in {LIGHT!r}.split(): importlib.import_module("worker." + name)
import tracer.scene
print([name for name in {HEAVY!r}.split() if name in sys.modules])
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
