"""``scenes/textures.json``: valid, written by the script, its image as the script draws it."""

import hashlib

import numpy as np
from PIL import Image

from scenes import make_textures
from scenes.make_seed import text
from tracer.scene import parse_scene


def test_written_by_the_script():
    """The PNG's bytes depend on the compressor's version, its levels do not."""
    sha256 = hashlib.sha256(make_textures.IMAGE.read_bytes()).hexdigest()
    written = (make_textures.FOLDER / "textures.json").read_text()
    assert written == text(make_textures.document(sha256)) + "\n"
    assert parse_scene(written).assets["tiles"].sha256 == sha256
    with Image.open(make_textures.IMAGE) as image:
        assert np.array_equal(np.asarray(image), make_textures.tile())
