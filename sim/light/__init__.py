"""Light from the projector, reflected by the scene, to the sensor."""

from sim.build import Setup
from sim.light.basis import PatternLevels
from sim.light.light import Light, Show

__all__ = ["Light", "PatternLevels", "Setup", "Show"]
