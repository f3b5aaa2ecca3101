"""Light from the projector by way of the scene to the sensor."""

from sim.build import Setup
from sim.light.basis import Picture
from sim.light.light import Light, Show

__all__ = ["Light", "Picture", "Setup", "Show"]
