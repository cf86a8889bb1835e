"""The door to numba: cache directory, plain Python, warm-up."""

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


def test_key_follows_the_sources(tmp_path, monkeypatch):
    import shutil

    from tracer import jit

    copy = tmp_path / "tracer"
    shutil.copytree(ROOT / "tracer", copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(jit, "__file__", str(copy / "jit.py"))
    before = jit.kernel_key()
    assert before == jit.kernel_key()
    (copy / "film" / "writer.py").write_text("# no kernel")
    assert jit.kernel_key() == before
    for name in ("geometry/shapes.py", "render/blocks.py", "types.py"):
        with (copy / name).open("a") as source:
            source.write("\n# changed\n")
        after = jit.kernel_key()
        assert after != before
        before = after


def test_warm_leaves_nothing_to_compile():
    """A second process finds every kernel of a render on disk."""
    code = """
from tracer.jit import warm
import numba.core.event as event
compiled = event.RecordingListener()
seconds = warm()
event.register("numba:compile", compiled)
from tests.tracer.render.hand_made import mixed
from tracer.render import render_compiled
assert render_compiled(mixed()).pixels.max() > 0
print(seconds > 0, len(compiled.buffer))
"""
    assert run(code) == "True 0"


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
