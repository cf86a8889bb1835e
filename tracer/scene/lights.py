"""Lights: ambient, directional, point, spot.

Invariant: directions are not zero, though not normalised; the inner angle of a spot is not above the outer one.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tracer.scene.base import Direction, Number, Rgb, SceneModel, Vector
from tracer.scene.faults import Fault, faults_error


class AmbientLight(SceneModel):
    """Light from everywhere, the report's Ia_global; several add up."""

    type: Literal["ambient"] = Field(description="Kind of this light.", examples=["ambient"])
    intensity: Rgb = Field(description="Linear RGB [farmer2019 eq. 10].", examples=[0.05])


class _Light(SceneModel):
    """Base of the lights that have a direction at every point."""

    ambient: Rgb = Field(
        default=(0.0, 0.0, 0.0), description="What this light adds to the ambient light, linear RGB.", examples=[0]
    )
    diffuse: Rgb = Field(
        default=(1.0, 1.0, 1.0), description="Intensity for diffuse reflection, linear RGB.", examples=[1]
    )
    specular: Rgb = Field(
        default=(1.0, 1.0, 1.0), description="Intensity for specular reflection, linear RGB.", examples=[1]
    )


class DirectionalLight(_Light):
    """Parallel light from infinitely far away, as the sun's."""

    type: Literal["directional"] = Field(description="Kind of this light.", examples=["directional"])
    direction: Direction = Field(description="The way in which the light travels.", examples=[[-1, -1, -1]])


class PointLight(_Light):
    """Light from one point; its loss over distance is the material's attenuation."""

    type: Literal["point"] = Field(description="Kind of this light.", examples=["point"])
    position: Vector = Field(description="Position [x, y, z] in the world.", examples=[[0, 2, 0]])


class SpotLight(_Light):
    """Light from one point within a cone; falloff between the angles as in glTF's KHR_lights_punctual."""

    type: Literal["spot"] = Field(description="Kind of this light.", examples=["spot"])
    position: Vector = Field(description="Position [x, y, z] in the world.", examples=[[0, 2, 0]])
    direction: Direction = Field(description="The way in which the cone's axis points.", examples=[[0, -1, 0]])
    inner_angle_deg: Annotated[Number, Field(ge=0.0, le=90.0)] = Field(
        default=20.0, description="Half-angle of the cone of full light, in degrees.", examples=[20]
    )
    outer_angle_deg: Annotated[Number, Field(gt=0.0, le=90.0)] = Field(
        default=30.0, description="Half-angle beyond which there is no light, in degrees.", examples=[30]
    )

    @model_validator(mode="after")
    def _check_angles(self) -> "SpotLight":
        if self.inner_angle_deg > self.outer_angle_deg:
            pointer = "/inner_angle_deg" if "inner_angle_deg" in self.model_fields_set else "/outer_angle_deg"
            raise faults_error(
                [
                    Fault(
                        pointer,
                        f"makes the inner angle ({self.inner_angle_deg!r}) greater than the outer one "
                        f"({self.outer_angle_deg!r})",
                        "inner_angle_deg <= outer_angle_deg",
                    )
                ]
            )
        return self


Light = Annotated[AmbientLight | DirectionalLight | PointLight | SpotLight, Field(discriminator="type")]
