"""Light from the projector, reflected by the scene, to the sensor."""

from sim.build import SceneState
from sim.light.basis import PatternLevels
from sim.light.light import Light, ShownPattern

__all__ = ["Light", "PatternLevels", "SceneState", "ShownPattern"]
