"""A lamp of the room: light other than the projector's that falls on surfaces from one side."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from fpplab.core.config import Document
from fpplab.core.conventions import Floats

NEAREST_MM = 100.0
"""Minimum distance of a lamp from the point that it is aimed at."""


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
    distance_mm: Annotated[float, Field(ge=NEAREST_MM, le=1e5)] = 2000.0
    """Distance of the lamp, in mm."""

    @property
    def offset(self) -> Floats:
        """Place (3,) of the lamp from the point it is given from, in mm in the camera's frame."""
        angle, azimuth = np.radians([self.angle_deg, self.azimuth_deg])
        lateral = np.sin(angle)
        towards = [lateral * np.cos(azimuth), lateral * np.sin(azimuth), -np.cos(angle)]
        return self.distance_mm * np.array(towards)
