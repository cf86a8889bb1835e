"""Materials: the coefficients of the report's equation 9, and textures.

Invariant: the attenuation 1 / (a + b D + c D^2) has a positive denominator for every distance D > 0.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from tracer.scene.base import Flag, Name, Number, Rgb, SceneModel
from tracer.scene.faults import Fault, faults_error, pointer_of
from tracer.scene.limits import MAX_ATTENUATION, MAX_ETA, MAX_EXPONENT, MIN_ATTENUATION, MIN_ETA

Coefficient = Annotated[Number, Field(ge=0.0, le=MAX_ATTENUATION)]

DEFAULT_REFLECTANCE = (0.8, 0.8, 0.8)
"""kd of a material that names none, and ka and kd of the default grey of objects without a material."""


class Attenuation(SceneModel):
    """Loss over the distance D: the factor 1 / (a + b D + c D^2)."""

    a: Coefficient = Field(default=1.0, description="Constant term.", examples=[1])
    b: Coefficient = Field(default=0.0, description="Factor of the distance.", examples=[0])
    c: Coefficient = Field(default=0.0, description="Factor of the squared distance.", examples=[0])

    @model_validator(mode="after")
    def _check_numbers(self) -> "Attenuation":
        if self.a == self.b == self.c == 0.0:
            raise faults_error([Fault("", "has a = b = c = 0, a division by zero", "at least one of a, b, c above 0")])
        least = f"0, or a number from {MIN_ATTENUATION:g}"
        numbers = {"a": self.a, "b": self.b, "c": self.c}
        if faults := [
            Fault(pointer_of(name), f"is {number:g}", least)
            for name, number in numbers.items()
            if 0.0 < number < MIN_ATTENUATION
        ]:
            raise faults_error(faults)
        return self


class DiffuseTexture(SceneModel):
    """An image that multiplies ka and kd."""

    asset: Name = Field(description="Name of an image in the assets table.", examples=["wood"])
    wrap: Literal["repeat", "clamp"] = Field(
        default="repeat", description="What lies outside 0 to 1: the image again, or its edge.", examples=["repeat"]
    )
    color_space: Literal["srgb", "linear"] = Field(
        default="srgb", description="How the image's numbers are encoded.", examples=["srgb"]
    )
    filter: Literal["bilinear", "nearest"] = Field(
        default="bilinear", description="How texels between their centres are found.", examples=["bilinear"]
    )


def _kd_of(data: dict[str, Any]) -> Any:
    """Default of ka: the same as kd, so that a coloured thing has that colour in ambient light, too."""
    return data.get("kd", DEFAULT_REFLECTANCE)


class BlinnPhongMaterial(SceneModel):
    """Surface of the report's equation 9, I = Ia + Id + Is + Ie + Ir + It; colours are linear RGB."""

    type: Literal["blinn_phong"] = Field(
        default="blinn_phong", description="Kind of this material.", examples=["blinn_phong"]
    )
    kd: Rgb = Field(
        default=DEFAULT_REFLECTANCE, description="Diffuse reflectance [farmer2019 eq. 11].", examples=[[0.8, 0.1, 0.1]]
    )
    ka: Rgb = Field(
        default_factory=_kd_of,
        description="Ambient reflectance [farmer2019 eq. 10]; the same as kd when left out.",
        examples=[0.8],
    )
    ks: Rgb = Field(
        default=(0.0, 0.0, 0.0), description="Specular reflectance of lights [farmer2019 eq. 12].", examples=[0.5]
    )
    exponent: Annotated[Number, Field(ge=0.0, le=MAX_EXPONENT)] = Field(
        default=100.0, description="Specular exponent [farmer2019 eq. 12]; higher is glossier.", examples=[100]
    )
    ke: Rgb = Field(default=(0.0, 0.0, 0.0), description="Emitted light [farmer2019 eq. 13].", examples=[0])
    kr: Rgb = Field(
        default=(0.0, 0.0, 0.0), description="Mirror reflectance of the scene [farmer2019 eq. 14].", examples=[0.3]
    )
    kt: Rgb = Field(
        default=(0.0, 0.0, 0.0),
        description="Transmittance [farmer2019 eq. 15]; shadow rays that pass are multiplied by it.",
        examples=[[0.9, 0.9, 0.95]],
    )
    eta: Annotated[Number, Field(ge=MIN_ETA, le=MAX_ETA)] = Field(
        default=1.0,
        description="Index of refraction, inside over outside [farmer2019 eq. 18]; 1 does not bend rays.",
        examples=[1.5],
    )
    attenuation: Attenuation = Field(
        default_factory=Attenuation,
        description="Loss over distance; a directional light counts as D = 0.",
        examples=[{"a": 1, "b": 0, "c": 0}],
    )
    diffuse_texture: DiffuseTexture | None = Field(
        default=None,
        description="Image that multiplies ka and kd.",
        examples=[{"asset": "wood", "wrap": "repeat"}],
    )
    two_sided: Flag = Field(
        default=True,
        description="Whether the normal is turned to the viewer; else the back is lit as the normal says.",
        examples=[True],
    )


Material = BlinnPhongMaterial
