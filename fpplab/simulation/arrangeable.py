"""What a data set asks of a simulation: any scene, and everything that is true of it.

A rig's simulation that can do so is `Arrangeable`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import trimesh

from fpplab.calibration.model import Calibration
from fpplab.simulation.scene import DatasetScene


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """What stands before the camera. mesh: in mm in the camera's frame; flat ones have two sides.

    calibration: the true devices, with the stage where it is.
    """

    mesh: trimesh.Trimesh
    calibration: Calibration


class SceneStudio(Protocol):
    """A simulation that takes any scene. Raises `ConfigError` for one that it cannot have."""

    def nominal(self) -> dict[str, Any]:
        """What all scenes share: the world that they are variations of, as plain data."""
        ...

    def calibration(self, stage_mm: float) -> Calibration:
        """The true devices with the stage at `stage_mm`."""
        ...

    def arrange(self, scene: DatasetScene) -> None:
        """Stand the scene's item before the devices, in the scene's light. The stage moves as a device."""
        ...

    def world(self) -> dict[str, Any]:
        """The world as it is arranged, as plain data."""
        ...

    def truth(self) -> SceneTruth:
        """What stands there."""
        ...


@runtime_checkable
class Arrangeable(Protocol):
    """A simulation whose scene can be arranged: what `fpplab dataset` needs of a rig."""

    def studio(self) -> SceneStudio:
        """Give the studio of the world as it is now.

        Called once, on the open rig, before the first scene.

        Returns
        -------
        SceneStudio
            Lives as long as the rig is open.
        """
        ...
