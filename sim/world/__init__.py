"""The simulated world as plain data, one module for each section of a world file.

The world frame is the camera's (OpenCV, mm). Irradiance is relative: 1 is a perfectly white surface that
faces the white projector at `projector.distance_mm`.
"""

from sim.world.camera import Binning, Sensor
from sim.world.items import ArtefactItem, BoardItem, CardItem, MeshItem, PoseRules, SurroundingsSection
from sim.world.projector import ProjectorWorld
from sim.world.render import Render, Subpixels
from sim.world.world import World

__all__ = [
    "ArtefactItem",
    "Binning",
    "BoardItem",
    "CardItem",
    "MeshItem",
    "PoseRules",
    "ProjectorWorld",
    "Render",
    "Sensor",
    "Subpixels",
    "SurroundingsSection",
    "World",
]
