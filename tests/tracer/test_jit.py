"""The door to numba: cache directory, plain Python."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run(code, **env):
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | env,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_cache_directory_is_set_before_numba_and_follows_the_settings(tmp_path):
    code = "from tracer.jit import KERNEL_CACHE; import numba; print(numba.config.CACHE_DIR); print(KERNEL_CACHE)"
    first, second = run(code, SMALTI_CACHE=str(tmp_path / "a")).split("\n")
    assert first == second
    assert Path(first).is_relative_to(tmp_path / "a")
    xdg = run(code, SMALTI_CACHE="", XDG_CACHE_HOME=str(tmp_path / "b")).split("\n")[0]
    assert Path(xdg).is_relative_to(tmp_path / "b" / "smalti")
    late = run("import numba; " + code, SMALTI_CACHE=str(tmp_path / "a")).split("\n")
    assert late == [first, second]


def test_scalar_modules_run_as_plain_python():
    """NUMBA_DISABLE_JIT=1: geometry, sampling and reflection give the same numbers; what works in lanes cannot."""
    code = """
import json
from tracer.sampling.sampler import sample_2d
from tracer.shading import phong
from tracer.shading.texture import sample_texture
from tracer.geometry.shapes import cross_shape
from tracer.types import Vec3
import numpy as np
texels = np.arange(36, dtype=np.float32)
print(json.dumps([
    [list(map(float, sample_2d(s, 1, 2, 3, k, 16, 0))) for s in range(3) for k in range(3)],
    list(map(float, phong.refract_direction(Vec3(0.6, 0.0, -0.8), Vec3(0.0, 0.0, 1.0), 1.5)[1])),
    float(phong.attenuation(1.0, 2.0, 3.0, 0.7)),
    list(map(float, sample_texture(np.array([0, 4, 3]), texels, 0, 0, 1, 0.3, 0.77))),
    [float(t) for kind in (0, 1, 4) for t in cross_shape(kind, Vec3(0.1, 0.2, 5.0), Vec3(0.01, 0.02, -1.0))],
]))
"""
    assert run(code, NUMBA_DISABLE_JIT="1") == run(code, NUMBA_DISABLE_JIT="0")
