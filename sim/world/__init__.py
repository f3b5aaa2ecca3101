"""The simulated world as plain data, one module for each section of a world file.

The world frame is the camera's (OpenCV, mm). Irradiance is relative: 1 is a perfectly white surface that
faces the white projector at `projector.distance_mm`.
"""

from sim.world.camera import Binning, CameraWorld, Sensor, ShutterSection
from sim.world.items import ArtefactItem, BoardItem, CardItem, Item, MeshItem, PoseRules, SurroundingsSection
from sim.world.materials import Material
from sim.world.projector import LedWorld, ProjectorWorld, ResponseSection
from sim.world.render import LightPath, Render, Subpixels
from sim.world.world import StageWorld, World

__all__ = [
    "ArtefactItem",
    "Binning",
    "BoardItem",
    "CameraWorld",
    "CardItem",
    "Item",
    "LedWorld",
    "LightPath",
    "Material",
    "MeshItem",
    "PoseRules",
    "ProjectorWorld",
    "Render",
    "ResponseSection",
    "Sensor",
    "ShutterSection",
    "StageWorld",
    "Subpixels",
    "SurroundingsSection",
    "World",
]
