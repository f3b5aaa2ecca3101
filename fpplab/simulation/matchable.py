"""What can be matched of a twin, and what a twin can do: the only way from here to a simulation.

A rig's simulation that has a twin is `Matchable`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image, PixelIndices
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.response import Curve
from fpplab.targets import Target

ExpectedLevels = NDArray[np.float32]
"""Raw levels without noise and without rounding, (n, h, w), 0 … full scale, clipped there."""


@dataclass(frozen=True, eq=False)
class TwinParameters:
    """Everything of a twin that matching may change. A parameter that is None is absent from the world.

    Geometry: calibration: both devices and the pose between them. poses: `T_camera_item` of the board.

    Light: white: level above black of a surface that faces the lamp at its distance, relative to what the
    twin's own file gives: a change of `f_number`, `full_well_e` or `black_level` does not change it (the
    lamp makes up for it). response: of the projector, with a + b = 1, for white takes the scale. ambient:
    even light, relative to the projector's white. paper, ink: reflectances of the board's ground and print.

    Sharpness: projector_blur: in mirrors. projector_focus_mm, projector_aperture_mm: as in a world, None:
    sharp at every depth. camera_focus_mm: None: sharp at every depth. f_number: of the camera's lens.
    vignetting: exponent of the camera's.

    Noise: black_level: share of full scale. read_noise_e, full_well_e: electrons of the unbinned pixel.
    vibration_mm: standard deviation of the item's place from frame to frame.
    """

    calibration: Calibration
    poses: tuple[RigidTransform, ...]
    white: float
    response: Curve
    ambient: float
    paper: float
    ink: float
    projector_blur: float
    projector_focus_mm: float | None
    projector_aperture_mm: float
    camera_focus_mm: float | None
    f_number: float
    vignetting: float
    black_level: float
    read_noise_e: float
    full_well_e: float
    vibration_mm: float

    def with_pose(self, index: int, pose: RigidTransform) -> TwinParameters:
        """The same but for one of the poses."""
        return replace(self, poses=(*self.poses[:index], pose, *self.poses[index + 1 :]))


class Twin(Protocol):
    """A simulation whose parameters can be set. Poses are indices into `parameters.poses`.

    Raises `ConfigError` for parameters that no world can have.
    """

    @property
    def parameters(self) -> TwinParameters:
        """As it stands; at first what its own file says."""

    @property
    def target(self) -> Target:
        """The board, as it is printed."""

    def become(self, parameters: TwinParameters) -> None:
        """Go on with these; what does not depend on the change is kept."""

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """What the camera sees of the board on average, without noise and vibration."""

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        """What `expected` is at these pixels, (n, P), for little more than their share of the time."""

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        """Frames of the board with the sensor's noise and the item's vibration; another draw each call.

        Vibration counts to first order in the item's displacement.
        """

    def expected_of(self, item: str, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """What the camera sees of another item of the world (a card), where the world has it.

        Raises `ConfigError` when the world has no such item.
        """

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        """Frames, with noise, of an item of the world that is moved to `pose` (T_camera_item)."""

    def mesh(self, item: str) -> trimesh.Trimesh:
        """The true shape of an item of the world, in its own frame in mm."""

    def save(self, folder: Path) -> Path:
        """Leave `rig.yaml`, `world.yaml` and `calibration.yaml` in `folder`; the path of the rig file."""


@runtime_checkable
class Matchable(Protocol):
    """A simulation that can be matched to a bench: what `fpplab match` needs of a rig."""

    def twin(self, board: str) -> Twin:
        """Give a twin that looks at one of the fixture's boards.

        Called on the open rig.

        Parameters
        ----------
        board : str
            The board, as the rig's fixture calls it.

        Returns
        -------
        Twin
            Lives as long as the rig is open.

        Raises
        ------
        ConfigError
            The fixture holds no board of that name.
        """
        ...
