"""What the data-set generator asks of a simulation: to arrange any scene, and to give its ground truth.

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
    """Ground truth of an arranged scene."""

    mesh: trimesh.Trimesh  # true surface in mm in the camera's frame; flat items are meshes of two sides
    calibration: Calibration  # the true devices, with the stage where it is


class SceneStudio(Protocol):
    """A simulation in which scenes can be arranged.

    `fpplab dataset` gets one from `Arrangeable.studio`, and then for each scene calls `arrange`, moves the
    stage, captures through the rig's devices, and asks for `truth` and `world`.

    Examples
    --------
    >>> studio = rig.simulation.studio()
    >>> studio.arrange(scene)
    >>> mesh = studio.truth().mesh
    """

    def nominal(self) -> dict[str, Any]:
        """Give what all scenes share: the world that they are variations of.

        Called before the first scene, to record it in the data set's card.

        Returns
        -------
        dict of str to Any
            Plain data, as in a world file.
        """
        ...

    def calibration(self, stage_mm: float) -> Calibration:
        """Give the true devices at a position of the stage.

        Called while scenes are drawn, to place items in the measuring volume; the stage need not be there.

        Parameters
        ----------
        stage_mm : float
            Position of the stage in mm.

        Returns
        -------
        Calibration
            Without uncertainty.
        """
        ...

    def arrange(self, scene: DatasetScene) -> None:
        """Put the scene's item before the devices, in the scene's light.

        Called before each scene is captured; frames that follow show the new scene. The stage is not moved
        here: the caller moves it as a device.

        Parameters
        ----------
        scene : DatasetScene
            Item, pose, paint, light and noise.

        Raises
        ------
        ConfigError
            The simulation cannot have such a scene.
        """
        ...

    def world(self) -> dict[str, Any]:
        """Give the world as it is arranged.

        Called after `arrange`, to record how the scene was made.

        Returns
        -------
        dict of str to Any
            Plain data, as in a world file.
        """
        ...

    def truth(self) -> SceneTruth:
        """Give the ground truth of the scene.

        Called after `arrange`, with the stage where it was when the scene was captured.

        Returns
        -------
        SceneTruth
            In the camera's frame.
        """
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
