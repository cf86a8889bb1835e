"""``scenes/seed/``: valid, written by the script from the facts, and the same scenes that the oracle reads from the facts."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from scenes import make_seed
from tests import naive, naive_pictures
from tests.naive_scenes import read_document, seed_scene
from tracer.scene import parse_scene

FACTS = (
    Path(os.environ.get("SMALTI_DATA", Path(__file__).parent.parent.parent / "shared")) / "seed/reference_scenes.json"
)
PATHS = sorted(make_seed.FOLDER.glob("*.json"))


def test_there_are_nine():
    assert len(PATHS) == 9


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_valid(path):
    doc = parse_scene(path.read_bytes())
    assert (doc.image.width, doc.image.height) == (420, 240)
    assert doc.sampling.samples == (2 if "2xAA" in path.name else 16)


@pytest.fixture(scope="module")
def facts():
    if not FACTS.is_file():
        pytest.skip("no seed data: set SMALTI_DATA (files of github.com/WhoFama24/cse6413-raytracer, commit 167f0b0)")
    return json.loads(FACTS.read_text())


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_written_by_the_script(path, facts):
    entry = next(e for e in facts["scenes"] if Path(e["image"]).stem == path.stem)
    assert path.read_text() == make_seed.text(make_seed.document(facts, entry)) + "\n"


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_same_scene_as_the_facts(path, facts):
    """One sample a pixel in every 16th row: equal to the last bit, but for the scene whose t_min the document cannot say."""
    entry = next(e for e in facts["scenes"] if Path(e["image"]).stem == path.stem)
    x, y = naive_pictures.random_positions(420, 240, 1, seed=5)[:, ::16]
    from_document = read_document(json.loads(path.read_text()))
    from_facts = seed_scene(facts, entry, original=False)
    from_document.t_min = from_facts.t_min
    assert np.array_equal(naive.trace(from_document, x, y), naive.trace(from_facts, x, y))
