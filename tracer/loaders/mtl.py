"""Materials of Wavefront MTL files, in the terms of the report's equation 9.

Read here and not by trimesh, which opens textures on the way and keeps Ke, Ni and d only as text.
Source: the MTL format of Wavefront's Advanced Visualizer; what it leaves open is as Blender's exporter writes it.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.files import CompanionError, ModelFile
from tracer.loaders.images import ImageError, decode_image
from tracer.loaders.limits import MAX_COLOR
from tracer.loaders.mesh import FileMaterial

# Options of a texture line and the most values that each takes; -o, -s and -t take one to three numbers.
_OPTIONS: Final = {
    "-blendu": 1,
    "-blendv": 1,
    "-boost": 1,
    "-cc": 1,
    "-clamp": 1,
    "-imfchan": 1,
    "-texres": 1,
    "-bm": 1,
    "-type": 1,
    "-mm": 2,
    "-o": 3,
    "-s": 3,
    "-t": 3,
}


class MaterialLibrary:
    """The materials of all MTL files that a model names, and their images."""

    def __init__(self, file: ModelFile) -> None:
        self._file = file
        self._index: dict[str, int] = {}
        self._image_index: dict[str, int] = {}
        self.materials: list[FileMaterial] = []
        self.images: list[NDArray[np.uint8]] = []

    def find(self, name: str) -> int:
        """Return the index of a material, or -1."""
        return self._index.get(name, -1)

    def read(self, name: str) -> None:
        """Read one library; when it cannot be read, a warning says so and the default material is used."""
        try:
            text = self._file.read_companion(name).decode("utf-8", "replace")
        except CompanionError as error:
            self._file.warn(f"material library {error}: a default material is used")
            return
        current: FileMaterial | None = None
        for line in text.replace("\\\n", " ").splitlines():
            key, _, rest = line.strip().partition(" ")
            key, rest = (
                key.lower(),
                rest.partition("#")[0].strip() if not key.lower().startswith("map_") else rest.strip(),
            )
            if key == "newmtl":
                self._keep(current)
                current = FileMaterial(name=rest)
            elif current is not None and rest:
                current = self._with_statement(current, key, rest)
        self._keep(current)

    def _keep(self, material: FileMaterial | None) -> None:
        """Add a finished material; the first of a name stays."""
        if material is not None and material.name not in self._index:
            self._index[material.name] = len(self.materials)
            self.materials.append(material)

    def _with_statement(self, material: FileMaterial, key: str, rest: str) -> FileMaterial:
        """Return the material with one more statement; unknown ones are passed over."""
        if key == "map_kd":
            return self._with_texture(material, rest)
        if key not in {"kd", "ks", "ke", "ns", "ni", "d", "tr"}:
            return material
        try:
            numbers = [float(word) for word in rest.split()[:3]]
        except ValueError:
            numbers = []
        if not numbers or not all(math.isfinite(number) for number in numbers):
            self._file.warn(
                f"material {material.name!r}: {key} {rest[:40]!r} is not made of numbers and is passed over"
            )
            return material
        if key in {"kd", "ks", "ke"}:
            rgb = numbers if len(numbers) == 3 else [numbers[0]] * 3
            red, green, blue = (min(max(number, 0.0), MAX_COLOR) for number in rgb)
            color: Any = {key: (red, green, blue)}
            return material._replace(**color)
        value = numbers[0]
        if key == "ns":
            return material._replace(exponent=value)
        if key == "ni":
            return material._replace(eta=value) if value > 0.0 else material
        return material._replace(opacity=value if key == "d" else 1.0 - value)

    def _with_texture(self, material: FileMaterial, rest: str) -> FileMaterial:
        """Return the material with its diffuse image, or unchanged, with a warning."""
        words = rest.split()
        wrap = "repeat"
        position = 0
        while position < len(words) and words[position].lower() in _OPTIONS:
            option = words[position].lower()
            position += 1
            for count in range(_OPTIONS[option]):
                if option in {"-o", "-s", "-t"} and count and not _is_number(words[position : position + 1]):
                    break
                if option == "-clamp" and words[position : position + 1] == ["on"]:
                    wrap = "clamp"
                position += 1
        # A file's name may have spaces in it.
        name = rest if position == 0 else " ".join(words[position:])
        if name not in self._image_index:
            try:
                image = decode_image(self._file.read_companion(name), self._file.limits)
            except CompanionError as error:
                self._file.warn(f"texture {error}: material {material.name!r} has a flat colour")
                return material
            except ImageError as error:
                self._file.warn(f"texture {name!r} {error}: material {material.name!r} has a flat colour")
                return material
            self._image_index[name] = len(self.images)
            self.images.append(image)
        return material._replace(image=self._image_index[name], wrap=wrap)


def _is_number(words: list[str]) -> bool:
    """Whether there is a word and it is a number."""
    try:
        return bool(words) and math.isfinite(float(words[0]))
    except ValueError:
        return False
