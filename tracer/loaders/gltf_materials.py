"""Materials and images of glTF files, in the terms of the report's equation 9.

The highlight has the reflectance at normal incidence and the Blinn-Phong exponent 2 / roughness^4 - 2, whose width is
that of the file's GGX lobe (Walter et al., Microfacet Models for Refraction, 2007, section 5.2). A metal has no diffuse
part of its own, but it reflects its surroundings, which eq. 14 can only do as a mirror: so the share metallic x (1 -
roughness) of the base colour mirrors, and the rest is diffuse. Textures other than the base colour have no counterpart.

Invariant: an image is decoded once, and only when a material of the drawn parts uses it.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tracer.loaders.files import CompanionError, ModelFile
from tracer.loaders.images import ImageError, decode_image
from tracer.loaders.limits import MAX_COLOR
from tracer.loaders.mesh import FileMaterial

_CLAMP_TO_EDGE: Final = 33071
_NEAREST: Final = 9728
_MAX_EXPONENT: Final = 10_000.0


class GltfMaterials:
    """Converts materials when they are first asked for."""

    def __init__(self, file: ModelFile, tree: dict[str, Any], buffers: list[bytes]) -> None:
        self._file = file
        self._tree = tree
        self._buffers = buffers
        self._index: dict[int, int] = {}
        self._image_index: dict[int, int] = {}
        self.materials: list[FileMaterial] = []
        self.images: list[NDArray[np.uint8]] = []

    def find(self, number: Any) -> int:
        """Return the index in `materials` of a primitive's material; -1 when it has none."""
        if number is None:
            return -1
        if not isinstance(number, int) or number < 0:
            raise IndexError(f"material {str(number)[:40]} is not an index")
        if number not in self._index:
            material = self._convert(self._tree["materials"][number])
            self._index[number] = len(self.materials)
            self.materials.append(material)
        return self._index[number]

    def _convert(self, source: dict[str, Any]) -> FileMaterial:
        rough = source.get("pbrMetallicRoughness", {})
        extensions = source.get("extensions", {})
        red, green, blue, alpha = _numbers(rough.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)), 4)
        metallic = _unit(rough.get("metallicFactor", 1.0))
        roughness = max(_unit(rough.get("roughnessFactor", 1.0)), 0.1)
        if "metallicRoughnessTexture" in rough and "metallicFactor" not in rough:
            # The texture decides by pixel; most surfaces that have one are mostly not metal.
            metallic, roughness = 0.0, 0.5
        eta = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5)) or 1.5
        dielectric = ((eta - 1.0) / (eta + 1.0)) ** 2
        dielectric *= _unit(extensions.get("KHR_materials_specular", {}).get("specularFactor", 1.0))
        transmission = _unit(extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0))
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        base = (red, green, blue)
        mirror = metallic * (1.0 - roughness)
        opacity = (alpha if source.get("alphaMode") == "BLEND" else 1.0) * (1.0 - transmission)
        if source.get("alphaMode") == "MASK":
            self._file.warn("cut-out materials are drawn whole")
        emissive = _numbers(source.get("emissiveFactor", (0.0, 0.0, 0.0)), 3)
        if "emissiveTexture" in source:
            self._file.warn("emissive textures are not supported: those parts do not glow")
            emissive = [0.0, 0.0, 0.0]
        material = FileMaterial(
            name=str(source.get("name", "")),
            kd=_rgb([channel * (1.0 - mirror) for channel in base]),
            kr=_rgb([channel * mirror for channel in base]),
            ks=_rgb([dielectric * (1.0 - metallic) + channel * metallic for channel in base]),
            exponent=min(max(2.0 / roughness**4 - 2.0, 1.0), _MAX_EXPONENT),
            ke=_rgb([channel * strength for channel in emissive]),
            eta=eta if transmission > 0.0 else 1.0,
            opacity=opacity,
        )
        texture = rough.get("baseColorTexture")
        return material if texture is None else self._with_texture(material, texture)

    def _with_texture(self, material: FileMaterial, texture: dict[str, Any]) -> FileMaterial:
        """Return the material with its base colour texture, or unchanged, with a warning."""
        if texture.get("texCoord", 0) != 0 or "KHR_texture_transform" in texture.get("extensions", {}):
            self._file.warn(f"material {material.name!r} moves its texture or uses second texture coordinates: ignored")
        entry = self._tree["textures"][texture["index"]]
        webp = entry.get("extensions", {}).get("EXT_texture_webp", {})
        number = webp.get("source", entry.get("source"))
        if number is None:
            self._file.warn(f"material {material.name!r} has a texture without an image: it has a flat colour")
            return material
        if number not in self._image_index:
            try:
                image = decode_image(self._image_bytes(self._tree["images"][number]), self._file.limits)
            except (CompanionError, ImageError) as error:
                self._file.warn(f"texture {error}: material {material.name!r} has a flat colour")
                return material
            self._image_index[number] = len(self.images)
            self.images.append(image)
        sampler = self._tree["samplers"][entry["sampler"]] if "sampler" in entry else {}
        return material._replace(
            image=self._image_index[number],
            wrap="clamp" if sampler.get("wrapS") == _CLAMP_TO_EDGE else "repeat",
            filter="nearest" if sampler.get("magFilter") == _NEAREST else "bilinear",
        )

    def _image_bytes(self, image: dict[str, Any]) -> bytes:
        from tracer.loaders.gltf import read_uri

        if "uri" in image:
            return read_uri(self._file, str(image["uri"]))
        view = self._tree["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        data: bytes = self._buffers[view["buffer"]][start : start + view["byteLength"]]
        return data


def _numbers(values: Any, count: int) -> list[float]:
    """Return `count` finite numbers."""
    numbers = [float(value) for value in values]
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise TypeError(f"{str(values)[:60]} is not {count} numbers")
    return numbers


def _unit(value: Any) -> float:
    """Return a number between 0 and 1."""
    return min(max(float(value), 0.0), 1.0)


def _rgb(values: list[float]) -> tuple[float, float, float]:
    """Return a colour within the scene's bounds."""
    red, green, blue = (min(max(value, 0.0), MAX_COLOR) for value in values)
    return red, green, blue
