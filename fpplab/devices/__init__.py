"""The one interface of every instrument: camera, projector, stage, fixture.

Public methods are final: they check state, capabilities and limits, and pass one
guard, so that these cannot differ between backends. A backend fills in the hooks,
the methods that begin with an underscore, and nothing else. A device refuses what it
cannot do and never clamps; what it did is read back from it.

States: CLOSED -> `open` -> IDLE -> (`arm`, `play`) ARMED -> IDLE; any fault of the
hardware leads to FAULT, from which only `close` is legal. `close` is legal from
anywhere and leaves the bench safe.
"""

from fpplab.devices.camera import Camera, CameraCaps, CameraSettings, Frame, Trigger
from fpplab.devices.device import Device, DeviceInfo, State
from fpplab.devices.fixture import Fixture, FixtureCaps, InstructableFixture, PosableFixture
from fpplab.devices.free_running import FreeFrame, FreeRun, FreeRunningCamera
from fpplab.devices.projector import FlashingProjector, PatternLoads, Projector, ProjectorCaps
from fpplab.devices.stage import Stage, StageCaps, StageMove

__all__ = [
    "Camera",
    "CameraCaps",
    "CameraSettings",
    "Device",
    "DeviceInfo",
    "Fixture",
    "FixtureCaps",
    "FlashingProjector",
    "Frame",
    "FreeFrame",
    "FreeRun",
    "FreeRunningCamera",
    "InstructableFixture",
    "PatternLoads",
    "PosableFixture",
    "Projector",
    "ProjectorCaps",
    "Stage",
    "StageCaps",
    "StageMove",
    "State",
    "Trigger",
]
