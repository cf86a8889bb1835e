"""The nine seed scenes by Smalti: the oracle's picture, small, at the same sample positions. ``make seed`` does them whole."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import seed
from benchmarks.data import REPOSITORY
from tests.kernel_pictures import render_kernel, render_oracle

PATHS = sorted((REPOSITORY / "scenes" / "seed").glob("*.json"))


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_equals_the_oracle(path):
    """84 x 48 pixels, 4 samples: equal but where a ray passes within a rounding error of an edge."""
    doc = json.loads(path.read_text())
    doc["image"] = {"width": 84, "height": 48}
    doc["sampling"] = {"samples": 4, "seed": 11, "sampler": "sobol"}
    ours, oracle = render_kernel(doc), render_oracle(doc)
    wrong = np.abs(ours - oracle) > 1e-9 * np.maximum(1.0, np.abs(oracle))
    assert wrong.any(axis=2).sum() <= 2
    assert oracle.std() > 0.01


def test_quantised_like_the_original():
    """The grey 0.05 * 0.941176471 is 12 levels, but for 5e-9 of a level that float32 does not hold."""
    grey = np.full((1, 1, 3), 0.05 * 0.941176471)
    assert (seed.quantise(grey) == 12).all()
    assert seed.quantise(np.array([[-1.0, 0.999, 7.0]])).tolist() == [[0, 254, 255]]


def test_bounds_are_judged():
    faults = []
    assert seed.judge(1.0, 1.1, faults, "x") == "1.00 (<= 1.10)"
    assert not faults
    assert seed.judge(1.2, 1.1, faults, "x").startswith("**1.20")
    assert len(faults) == 1


def test_missing_data_is_named(tmp_path):
    environment = os.environ | {"SMALTI_DATA": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.seed"],
        cwd=REPOSITORY,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert "WhoFama24/cse6413-raytracer, commit 167f0b0" in run.stderr
    assert "SMALTI_DATA" in run.stderr
