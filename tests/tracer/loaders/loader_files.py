"""Small model files, written by hand, for the tests of the loaders."""

import base64
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from tracer.loaders.files import ModelFile
from tracer.loaders.limits import DEFAULT_LIMITS, LoadLimits

DATA = Path(os.environ.get("SMALTI_DATA", Path(__file__).parents[4] / "shared"))


def data_folder(name: str) -> Path:
    """Folder of the public test models, or a skip that says what to get."""
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set SMALTI_DATA to a folder with the test models ({name})")
    return folder


def model_file(
    folder: Path, name: str, content: str | bytes = "", companions=None, limits: LoadLimits = DEFAULT_LIMITS
) -> ModelFile:
    """Write a file and open it as a loader would."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return ModelFile(path, name, companions, limits)


def png_bytes(width: int = 2, height: int = 1, color: tuple[int, int, int] = (255, 0, 0)) -> bytes:
    """A PNG of one colour."""
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", (width, height), color).save(buffer, "PNG")
    return buffer.getvalue()


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
NORMALS = np.array([[0, 0, 1], [0, 0, 2], [0, 0, 1]], np.float32)
UVS = np.array([[0, 0], [1, 0], [0, 1]], np.float32)


class Gltf:
    """Builds a glTF tree around one buffer."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"name": "thing", "primitives": [{"attributes": {}}]}],
            "accessors": [],
            "bufferViews": [],
        }

    @property
    def primitive(self) -> dict:
        return self.tree["meshes"][0]["primitives"][0]

    def add(self, array: np.ndarray, **more) -> int:
        """Append an accessor; returns its index."""
        kinds = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125}
        shapes = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
        rows = array.reshape(len(array), -1)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": array.nbytes}
        self.tree["bufferViews"].append(view)
        self.tree["accessors"].append(
            {
                "bufferView": len(self.tree["bufferViews"]) - 1,
                "componentType": kinds[array.dtype.name],
                "count": len(array),
                "type": shapes[rows.shape[1]],
                **more,
            }
        )
        self.binary += array.tobytes() + bytes(-array.nbytes % 4)
        return len(self.tree["accessors"]) - 1

    def with_triangle(self) -> "Gltf":
        self.primitive["attributes"] |= {"POSITION": self.add(TRIANGLE), "NORMAL": self.add(NORMALS)}
        return self

    def gltf(self) -> str:
        """Text with the buffer as a data URI."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        return json.dumps({**self.tree, "buffers": [{"uri": uri, "byteLength": len(self.binary)}]})

    def glb(self) -> bytes:
        """The binary form."""
        text = json.dumps({**self.tree, "buffers": [{"byteLength": len(self.binary)}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.binary), 0x004E4942) + self.binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
