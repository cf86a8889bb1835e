"""Helpers of the compiler's tests: small documents, and a stand-in for the hierarchy."""

import hashlib
import json
from pathlib import Path

import numpy as np

from tracer.render.compile import compile_scene
from tracer.scene import parse_scene

TRIANGLE = {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}


def fake_build(_vertices, faces):
    """No tree at all: these tests do not trace."""
    return np.arange(256 + len(faces))


def document(*objects, **more):
    """A valid scene document around some objects."""
    return parse_scene(
        {
            "version": 1,
            "camera": {"type": "perspective", "fov_deg": 40},
            "image": {"width": 8, "height": 6},
            "objects": list(objects),
            **more,
        }
    )


def compiled(*objects, folder: Path | None = None, **more):
    """Compile a document; assets are files of `folder`."""
    return compile_scene(document(*objects, **more), lambda ref: folder / ref.file, build=fake_build)


def sha256(data: bytes) -> str:
    """Hash as the assets table has it."""
    return hashlib.sha256(data).hexdigest()


def vertexdata(folder: Path, name: str = "m.json", groups=None) -> dict:
    """Write a model of two triangles in two groups; returns its row of the assets table."""
    rows = [[0, 0, 0, 0, 0, 1, 0, 0], [1, 0, 0, 0, 0, 2, 1, 0], [1, 1, 0, 0, 0, 1, 1, 1], [0, 1, 0, 0, 0, 1, 0, 1]]
    text = json.dumps(
        {
            "vertexdata": [number for row in rows for number in row],
            "indexdata": [0, 1, 2, 0, 2, 3],
            "groups": groups or {"Body": [0, 1], "Roof": [1, 2]},
        }
    )
    (folder / name).write_text(text)
    return {"file": name, "sha256": sha256(text.encode())}
