"""The parameters of a twin that can be matched, and the Protocol by which matching reaches a simulation.

A rig's simulation that has a twin is `Matchable`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image, PixelIndices
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringes import Pattern
from fpplab.simulation.appearance import Appearance
from fpplab.simulation.surface import PartSurface
from fpplab.targets import Target

NO_LINE = (0.0, 0.0, 0.0)
"""Of a vibration that has no direction."""
NO_FALLOFF = (0.0, 0.0, 0.0, 0.0, 0.0)
"""Of a projector whose light is even."""
ExpectedLevels = NDArray[np.float32]
"""Raw levels without noise and without rounding, (n, h, w), clipped to 0 … full scale."""


@dataclass(frozen=True, eq=False)
class TwinParameters:
    """Everything of a twin that matching may change. A parameter that is None is absent from the world."""

    calibration: Calibration  # both devices and the pose between them
    poses: tuple[RigidTransform, ...]  # `T_camera_item` of the board
    white: float  # level above black of a surface that faces the lamp at its distance
    response: Curve  # of the projector, with a + b = 1, since `white` takes the scale
    ambient: float  # even ambient light, relative to the projector's white
    paper: float  # reflectances of the board's ground and print
    ink: float  # reflectances of the board's ground and print
    projector_blur: float  # standard deviation of the projector lens's point spread at its sharpest
    projector_focus_mm: float | None  # distance in focus of the projector, as in a world file
    projector_aperture_mm: float  # diameter of the projector's aperture, as in a world file
    camera_focus_mm: float | None  # distance in focus of the camera; None: sharp at every depth
    f_number: float  # of the camera's lens
    vignetting: float  # exponent n of the camera's loss of light cosⁿ towards the edge
    black_level: float  # share of full scale
    read_noise_e: float  # electrons of the unbinned pixel
    full_well_e: float  # electrons of the unbinned pixel
    vibration_mm: float  # standard deviation of the item's position from frame to frame
    vibration_line_mm: tuple[float, float, float] = NO_LINE
    vibration_periodic: float = 0.0  # share of its variance that has one frequency
    vibration_cycles_per_frame: float = 0.0  # that frequency, as frames at regular intervals sample it
    projector_falloff: tuple[float, float, float, float, float] = NO_FALLOFF  # coefficients of x
    projector_flicker: float = 0.0  # standard deviation of the projector's light from frame to frame
    lamp_irradiance: float = 0.0  # light of the room's lamp on a surface that faces it
    lamp_angle_deg: float = 45.0  # place of the lamp from that point
    lamp_azimuth_deg: float = -90.0  # place of the lamp from that point
    lamp_distance_mm: float = 2000.0  # place of the lamp from that point
    ambient_ripple: float = 0.0  # amplitude of the rolling bands of ambient light and lamp, as a share of it
    band_period_px: float = 0.0  # from band to band, in rows of the frame; 0 where there are none
    band_advance: float | None = None  # share of a period by which they move from frame to frame
    placed: Mapping[str, RigidTransform] = field(default_factory=dict)
    surfaces: Mapping[str, PartSurface] = field(default_factory=dict)  # of items whose surface was matched
    sigma: Mapping[str, float] = field(default_factory=dict)  # standard uncertainties that a fit stated

    @property
    def displacement_mm(self) -> float:
        """RMS displacement of the item along an axis by all of its vibration."""
        return float(np.sqrt(self.vibration_mm**2 + np.mean(np.square(self.vibration_line_mm))))

    def sigma_with(self, **known: float) -> dict[str, float]:
        """Give the standard uncertainties with some replaced."""
        return {name: value for name, value in {**self.sigma, **known}.items() if value or name not in known}

    def with_pose(self, index: int, pose: RigidTransform) -> TwinParameters:
        """Replace one of the poses."""
        return replace(self, poses=(*self.poses[:index], pose, *self.poses[index + 1 :]))


class Twin(Protocol):
    """A simulation of a board whose parameters can be set.

    `fpplab.matching` gets one from `Matchable.twin` and calls its methods from one thread, in any order.
    Poses are indices into `parameters.poses`; frames and levels are raw, of the bit depth of the settings.

    Examples
    --------
    >>> twin.become(dataclasses.replace(twin.parameters, ambient=0.02))
    >>> levels = twin.expected(0, patterns, settings)
    """

    @property
    def parameters(self) -> TwinParameters:
        """The present parameters; at first those of the twin's own file."""

    @property
    def target(self) -> Target:
        """The board, as it is printed."""

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since the twin was made; noise and vibration follow from it."""

    def count_frames_from(self, number: int) -> None:
        """Give the next frame this number: a matching that goes on has the noise that it would have had.

        Parameters
        ----------
        number : int
            Not negative.
        """

    def become(self, parameters: TwinParameters) -> None:
        """Set the parameters; what does not depend on the change is kept.

        Called before every evaluation with other parameters, so it should be fast.

        Parameters
        ----------
        parameters : TwinParameters
            What `self.parameters` gives afterwards.

        Raises
        ------
        ConfigError
            No world can have these parameters.
        """

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """Give what the camera sees of the board on average, without noise and vibration.

        Parameters
        ----------
        pose : int
            Index of the pose.
        patterns : sequence of Pattern
            That the projector shows, n.
        settings : CameraSettings
            Of the camera.

        Returns
        -------
        ExpectedLevels
            (n, h, w).
        """

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        """Give what `expected` gives at some pixels, in little more than their share of the time.

        Called by the fits, which compare a sample of the pixels.

        Parameters
        ----------
        pose : int
            Index of the pose.
        patterns : sequence of Pattern
            That the projector shows, n.
        settings : CameraSettings
            Of the camera.
        pixels : PixelIndices
            Rows and columns of P pixels.

        Returns
        -------
        ExpectedLevels
            (n, P).
        """

    def expected_with_slopes(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> tuple[ExpectedLevels, ExpectedLevels] | None:
        """Give what `expected_at` gives, with its derivatives by the places that the pixels see.

        Called by the fit of the geometry. A simulation that has no derivatives returns None; they are then
        found by finite differences, with four more calls of `expected_at`.

        Parameters
        ----------
        pose : int
            Index of the pose.
        patterns : sequence of Pattern
            That the projector shows, n.
        settings : CameraSettings
            Of the camera.
        pixels : PixelIndices
            Rows and columns of P pixels.

        Returns
        -------
        tuple of ExpectedLevels, or None
            (n, P), and the derivatives (n, P, 4) by x, y on the board in mm and u, v on the projector in px.
            A level is the reflectance at (x, y) times the light of the projector's image at (u, v).
        """

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        """Take frames of the board with the sensor's noise and the item's vibration.

        Noise and vibration are drawn anew in each call. Vibration counts to first order in the item's
        displacement.

        Parameters
        ----------
        pose : int
            Index of the pose.
        patterns : sequence of Pattern
            That the projector shows.
        settings : CameraSettings
            Of the camera.

        Returns
        -------
        list of Image
            One frame for each pattern.
        """

    def expected_of(self, item: str, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """Give what the camera sees of another item of the world, where the world has it, on average.

        Called with a grey card, for gamma matching.

        Parameters
        ----------
        item : str
            Name of the item in the world.
        patterns : sequence of Pattern
            That the projector shows, n.
        settings : CameraSettings
            Of the camera.

        Returns
        -------
        ExpectedLevels
            (n, h, w).

        Raises
        ------
        ConfigError
            The world has no such item.
        """

    def expected_part(
        self,
        item: str,
        pose: RigidTransform,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        pixels: PixelIndices,
    ) -> ExpectedLevels:
        """Give what the camera sees on average of an item of the world at another pose, at some pixels.

        Called to match the item's surface. Levels that are not clipped are linear in light and exposure.

        Parameters
        ----------
        item : str
            Name of the item in the world.
        pose : RigidTransform
            `T_camera_item`.
        patterns : sequence of Pattern
            That the projector shows, n.
        settings : CameraSettings
            Of the camera; the exposure may be shorter than that of any camera.
        pixels : PixelIndices
            Rows and columns of P pixels.

        Returns
        -------
        ExpectedLevels
            (n, P).

        Raises
        ------
        ConfigError
            The world has no such item.
        """

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        """Take frames of an item of the world at another pose, with noise and vibration.

        Called for the comparison with scans of artefacts.

        Parameters
        ----------
        item : str
            Name of the item in the world.
        pose : RigidTransform
            `T_camera_item`.
        patterns : sequence of Pattern
            That the projector shows.
        settings : CameraSettings
            Of the camera.

        Returns
        -------
        list of Image
            One frame for each pattern.

        Raises
        ------
        ConfigError
            The world has no such item.
        """

    def mesh(self, item: str) -> trimesh.Trimesh:
        """Give the true shape of an item of the world.

        Parameters
        ----------
        item : str
            Name of the item in the world.

        Returns
        -------
        trimesh.Trimesh
            In the item's own frame in mm.

        Raises
        ------
        ConfigError
            The world has no such item, or it is flat.
        """

    def pose_of(self, item: str) -> RigidTransform:
        """Tell where an item of the world stands.

        Called with a grey card before any work, and to find how far it stands from there.

        Parameters
        ----------
        item : str
            Name of the item in the world.

        Returns
        -------
        RigidTransform
            `T_camera_item` in mm.

        Raises
        ------
        ConfigError
            The world has no such item.
        """

    def appear(self, appearance: Appearance) -> None:
        """Look as a bench does, beside what parameters tell; `save` writes it too.

        Called for trials, and at last with what the saved twin has.

        Parameters
        ----------
        appearance : Appearance
            In place of the one before.
        """

    def save(self, folder: Path, notes: Sequence[str] = ()) -> Path:
        """Write `rig.yaml`, `world.yaml` and `calibration.yaml` with the present parameters.

        Called once, with the matched parameters. Afterwards every command accepts the rig file.

        Parameters
        ----------
        folder : Path
            Created where it is missing.
        notes : sequence of str
            For the rig file: what every command that opens it tells.

        Returns
        -------
        Path
            Of the rig file.
        """


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
