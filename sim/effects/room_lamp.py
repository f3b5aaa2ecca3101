"""Lamps of the room: light that is not the projector's and falls on surfaces from one side."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from typing_extensions import override

from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from sim.effects.base import Effect, EffectWorld
from sim.effects.step import ParametersT, StepContext
from sim.parameter_entry import FitRange, SubstituteNumber, table_entry
from sim.scene import PointLamp

ROOM = "room"  # name of the lamp that can be matched
ROOM_LAMP = ("lamp_irradiance", "lamp_angle_deg", "lamp_azimuth_deg", "lamp_nearness")
"""Names of its numbers that are fitted."""


class RoomLamp(Document):
    """A small lamp that shines evenly in all directions, in place of a lamp or window of the room.

    Its place is given from the point on the camera's optical axis at the projector's `distance_mm`.
    """

    irradiance: Annotated[float, Field(ge=0, le=10)]
    """Light at that point on a surface that faces the lamp, relative to the projector's white."""
    angle_deg: Annotated[float, Field(ge=-150, le=150)] = 45.0
    """Angle between the way to the lamp and the way to the camera, in degrees: 0 behind the camera, 90
    at the side of the part."""
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = -90.0
    """Direction of the lamp in the camera's image, in degrees: 0 to the right, 90 below, -90 above."""
    distance_mm: Annotated[float, Field(ge=100.0, le=1e5)] = 2000.0
    """Distance of the lamp, in mm."""

    @property
    def displacement_mm(self) -> Floats:
        """Place (3,) of the lamp from the point it is given from, in mm in the camera's frame."""
        angle, azimuth = np.radians([self.angle_deg, self.azimuth_deg])
        lateral = np.sin(angle)
        towards = [lateral * np.cos(azimuth), lateral * np.sin(azimuth), -np.cos(angle)]
        return self.distance_mm * np.array(towards)


class LampsField(Document):
    """Of a world file."""

    lamps: Annotated[dict[str, RoomLamp], Field(default_factory=dict)]
    """Lamps of the room by name, whose light has a direction."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LampParameters:
    """What a matching may change."""

    lamp_irradiance: float = field(
        default=0.0,
        metadata=table_entry(
            "Light of the room's lamp on a surface that faces it, relative to the projector's white.",
            f"lamps.{ROOM}.irradiance",
            FitRange(0.005, 0.0, 10.0),
            effect="lamp_irradiance",
            per_white=True,
        ),
    )
    lamp_angle_deg: float = field(
        default=45.0,
        metadata=table_entry(
            "Angle between the ways to the lamp and to the camera in degrees.",
            f"lamps.{ROOM}.angle_deg",
            FitRange(2.0, -150.0, 150.0),
            effect="lamp_irradiance",
        ),
    )
    lamp_azimuth_deg: float = field(
        default=-90.0,
        metadata=table_entry(
            "Direction of the lamp in the image in degrees.",
            f"lamps.{ROOM}.azimuth_deg",
            FitRange(2.0, -360.0, 360.0),
            effect="lamp_irradiance",
        ),
    )
    lamp_distance_mm: float = field(
        default=2000.0,
        metadata=table_entry(
            "Distance of the lamp in mm; fitted by its inverse, `lamp_nearness`.",
            f"lamps.{ROOM}.distance_mm",
            effect="lamp_irradiance",
        ),
    )


class RoomLamps(Effect[LampsField]):
    """Light of the room from one side."""

    name = "room lamp"
    explains = "light of the room from one side"
    order = 20
    parameters = LampParameters
    strength = ("lamp_irradiance",)
    fitted = ROOM_LAMP
    # The inverse of the lamp's distance, in 1/m: light changes evenly with it, and far away it is 0.
    adjustable = {  # noqa: RUF012 - declared as a class variable by the base
        "lamp_nearness": SubstituteNumber(
            "lamp_distance_mm",
            FitRange(0.05, 0.01, 10.0, may_be_at_lower_bound=True),
            lambda distance_mm: 1e3 / distance_mm,
            lambda nearness: 1e3 / nearness,
        )
    }
    world_fields = LampsField
    is_room_light = True

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data["lamps"].pop(ROOM, None)

    @override
    def point_lamps(self, world: EffectWorld) -> tuple[PointLamp, ...]:
        middle = np.array([0.0, 0.0, world.projector.distance_mm])
        return tuple(
            PointLamp(tuple((middle + lamp.displacement_mm).tolist()), lamp.irradiance * lamp.distance_mm**2)
            for lamp in self.own(world).lamps.values()
        )

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        """Fit the light without and with a lamp, which is kept where it explains more than it costs."""
        dark = at.with_parameters(at.fit(*at.light_parameters()))
        linear = [name for name in (at.white, "ambient", "black_level") if name in dark.light_parameters()]
        start = dark.search_lamp(linear)
        if self.is_in(start):
            lit = dark.with_parameters(start)
            fitted = lit.with_parameters(lit.fit(*lit.light_parameters(*ROOM_LAMP)))
            if self._criterion(fitted) < self._criterion(dark):
                return fitted.parameters
        return dark.parameters

    @override
    def misfit(self, at: StepContext[ParametersT]) -> float | None:
        return self._criterion(at)

    def _criterion(self, at: StepContext[ParametersT]) -> float:
        return at.criterion(len(ROOM_LAMP) if self.is_in(at.parameters) else 0)
