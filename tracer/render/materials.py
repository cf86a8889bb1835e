"""The tables of materials, textures and lights.

Invariants: row 0 of the materials is the default grey; a material of the scene or of a file has one row, however often
it is used; an image has one row in the textures for each colour space it is read in; nothing that no object uses
has a row. Texels are linear: sRGB is decoded here, once.
"""

import math
from collections.abc import Hashable, Iterable

import numpy as np
from numpy.typing import NDArray

from tracer.film.develop import linear_from_srgb
from tracer.loaders.mesh import FileMaterial
from tracer.scene import DEFAULT_REFLECTANCE, BlinnPhongMaterial, DirectionalLight, Light, PointLight, SpotLight
from tracer.scene.limits import MAX_ETA, MAX_EXPONENT, MIN_ETA
from tracer.types import (
    FILTER_BILINEAR,
    FILTER_NEAREST,
    FLAG_FILTER,
    FLAG_TEXTURE,
    FLAG_TWO_SIDED,
    FLAG_WRAP,
    LIGHT_AMBIENT,
    LIGHT_DIFFUSE,
    LIGHT_DIRECTION,
    LIGHT_KIND_DIRECTIONAL,
    LIGHT_KIND_POINT,
    LIGHT_KIND_SPOT,
    LIGHT_POSITION,
    LIGHT_SPECULAR,
    LIGHT_SPOT_OFFSET,
    LIGHT_SPOT_SCALE,
    MATERIAL_A,
    MATERIAL_B,
    MATERIAL_C,
    MATERIAL_ETA,
    MATERIAL_EXPONENT,
    MATERIAL_KA,
    MATERIAL_KD,
    MATERIAL_KE,
    MATERIAL_KR,
    MATERIAL_KS,
    MATERIAL_KT,
    N_LIGHT,
    N_MATERIAL,
    N_MATERIAL_FLAGS,
    N_TEXTURE,
    TEXTURE_HEIGHT,
    TEXTURE_OFFSET,
    TEXTURE_WIDTH,
    WRAP_CLAMP,
    WRAP_REPEAT,
)

_WRAPS = {"repeat": WRAP_REPEAT, "clamp": WRAP_CLAMP}
_FILTERS = {"nearest": FILTER_NEAREST, "bilinear": FILTER_BILINEAR}


class TextureTable:
    """Collects images as linear texels."""

    def __init__(self) -> None:
        self._rows: dict[Hashable, int] = {}
        self._records: list[tuple[int, int, int]] = []
        self._texels: list[NDArray[np.float32]] = []
        self._n_texels = 0

    def add(self, key: Hashable, image: NDArray[np.uint8], color_space: str) -> int:
        """Return the row of an image, uint8 (height, width, 3); `key` names it."""
        full_key = (key, color_space)
        if full_key not in self._rows:
            encoded = np.arange(256) / 255.0
            table = (linear_from_srgb(encoded) if color_space == "srgb" else encoded).astype(np.float32)
            height, width = image.shape[:2]
            self._rows[full_key] = len(self._records)
            self._records.append((self._n_texels, width, height))
            self._texels.append(table[image].reshape(-1, 3))
            self._n_texels += width * height
        return self._rows[full_key]

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return `textures` and `texels`; kernels load four numbers for three, so there is a texel too many."""
        textures = np.zeros((len(self._records), N_TEXTURE), np.int64)
        for row, (offset, width, height) in enumerate(self._records):
            textures[row, TEXTURE_OFFSET] = offset
            textures[row, TEXTURE_WIDTH] = width
            textures[row, TEXTURE_HEIGHT] = height
        return textures, np.concatenate([*self._texels, np.zeros((1, 3), np.float32)])


class MaterialTable:
    """Collects materials by name of origin; row 0 is the default grey."""

    def __init__(self) -> None:
        self._rows: dict[Hashable, int] = {}
        self._numbers: list[NDArray[np.float64]] = []
        self._flags: list[NDArray[np.int32]] = []
        self.add_scene_material((), BlinnPhongMaterial(kd=DEFAULT_REFLECTANCE), -1)

    def find(self, key: Hashable) -> int | None:
        """Return the row of a material that was added before."""
        return self._rows.get(key)

    def add_scene_material(self, key: Hashable, material: BlinnPhongMaterial, texture: int) -> int:
        """Add a material of the scene document; `texture` is a row of the textures, or -1."""
        numbers = np.zeros(N_MATERIAL)
        for column, values in (
            (MATERIAL_KA, material.ka),
            (MATERIAL_KD, material.kd),
            (MATERIAL_KS, material.ks),
            (MATERIAL_KE, material.ke),
            (MATERIAL_KR, material.kr),
            (MATERIAL_KT, material.kt),
        ):
            numbers[column : column + 3] = values
        numbers[MATERIAL_EXPONENT] = material.exponent
        numbers[MATERIAL_ETA] = material.eta
        numbers[MATERIAL_A] = material.attenuation.a
        numbers[MATERIAL_B] = material.attenuation.b
        numbers[MATERIAL_C] = material.attenuation.c
        flags = np.zeros(N_MATERIAL_FLAGS, np.int32)
        flags[FLAG_TEXTURE] = texture
        described = material.diffuse_texture
        flags[FLAG_WRAP] = _WRAPS[described.wrap if described else "repeat"]
        flags[FLAG_FILTER] = _FILTERS[described.filter if described else "bilinear"]
        flags[FLAG_TWO_SIDED] = material.two_sided
        return self._append(key, numbers, flags)

    def add_file_material(self, key: Hashable, material: FileMaterial, texture: int) -> int:
        """Add a material of a model file.

        Opacity d splits the light: kt = 1 - d passes, and kd and ka keep d of theirs. ka is kd: what files say of
        the ambient colour is mostly an exporter's constant (0 or 1).
        """
        opacity = min(max(material.opacity, 0.0), 1.0)
        numbers = np.zeros(N_MATERIAL)
        numbers[MATERIAL_KD : MATERIAL_KD + 3] = np.array(material.kd) * opacity
        numbers[MATERIAL_KA : MATERIAL_KA + 3] = np.array(material.kd) * opacity
        numbers[MATERIAL_KS : MATERIAL_KS + 3] = material.ks
        numbers[MATERIAL_KE : MATERIAL_KE + 3] = material.ke
        numbers[MATERIAL_KR : MATERIAL_KR + 3] = material.kr
        numbers[MATERIAL_KT : MATERIAL_KT + 3] = 1.0 - opacity
        numbers[MATERIAL_EXPONENT] = min(max(material.exponent, 0.0), MAX_EXPONENT)
        numbers[MATERIAL_ETA] = min(max(material.eta, MIN_ETA), MAX_ETA)
        numbers[MATERIAL_A] = 1.0
        flags = np.zeros(N_MATERIAL_FLAGS, np.int32)
        flags[FLAG_TEXTURE] = texture
        flags[FLAG_WRAP] = _WRAPS[material.wrap]
        flags[FLAG_FILTER] = _FILTERS[material.filter]
        flags[FLAG_TWO_SIDED] = 1
        return self._append(key, numbers, flags)

    def _append(self, key: Hashable, numbers: NDArray[np.float64], flags: NDArray[np.int32]) -> int:
        self._rows[key] = len(self._numbers)
        self._numbers.append(numbers)
        self._flags.append(flags)
        return self._rows[key]

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return `materials` and `material_flags`."""
        return np.stack(self._numbers), np.stack(self._flags)


def build_lights(
    lights: Iterable[Light],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Return `ambient` (3,), the sum of the ambient lights, and `lights`, `light_kind` of all others."""
    ambient = np.zeros(3)
    rows: list[NDArray[np.float64]] = []
    kinds: list[int] = []
    for light in lights:
        if not isinstance(light, DirectionalLight | PointLight | SpotLight):
            ambient += light.intensity
            continue
        row = np.zeros(N_LIGHT)
        row[LIGHT_AMBIENT : LIGHT_AMBIENT + 3] = light.ambient
        row[LIGHT_DIFFUSE : LIGHT_DIFFUSE + 3] = light.diffuse
        row[LIGHT_SPECULAR : LIGHT_SPECULAR + 3] = light.specular
        if isinstance(light, PointLight | SpotLight):
            row[LIGHT_POSITION : LIGHT_POSITION + 3] = light.position
        if isinstance(light, DirectionalLight | SpotLight):
            length = math.hypot(*light.direction)
            row[LIGHT_DIRECTION : LIGHT_DIRECTION + 3] = [coordinate / length for coordinate in light.direction]
        if isinstance(light, SpotLight):
            inner = math.cos(math.radians(light.inner_angle_deg))
            outer = math.cos(math.radians(light.outer_angle_deg))
            scale = 1.0 / max(1e-3, inner - outer)
            row[LIGHT_SPOT_SCALE] = scale
            row[LIGHT_SPOT_OFFSET] = -outer * scale
        kinds.append(
            LIGHT_KIND_DIRECTIONAL
            if isinstance(light, DirectionalLight)
            else LIGHT_KIND_SPOT
            if isinstance(light, SpotLight)
            else LIGHT_KIND_POINT
        )
        rows.append(row)
    table = np.stack(rows) if rows else np.zeros((0, N_LIGHT))
    return ambient, table, np.array(kinds, np.int32)
