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
    """Everything of a twin that matching may change. A parameter that is None is absent from the world.

    Attributes
    ----------
    calibration : Calibration
        Both devices and the pose between them.
    poses : tuple of RigidTransform
        `T_camera_item` of the board.
    white : float
        Level above black of a surface that faces the lamp at its distance, relative to what the twin's own
        file gives. A change of `f_number`, `full_well_e` or `black_level` does not change it (the lamp makes
        up for it).
    response : Curve
        Of the projector, with a + b = 1, since `white` takes the scale.
    ambient : float
        Even ambient light, relative to the projector's white.
    paper, ink : float
        Reflectances of the board's ground and print.
    projector_blur : float
        Standard deviation of the projector lens's point spread at its sharpest, in mirrors.
    projector_focus_mm : float or None
        Distance in focus of the projector, as in a world file; None: sharp at every depth.
    projector_aperture_mm : float
        Diameter of the projector's aperture, as in a world file.
    camera_focus_mm : float or None
        Distance in focus of the camera; None: sharp at every depth.
    f_number : float
        Of the camera's lens.
    vignetting : float
        Exponent n of the camera's loss of light cosⁿ towards the edge.
    black_level : float
        Share of full scale.
    read_noise_e, full_well_e : float
        Electrons of the unbinned pixel.
    vibration_mm : float
        Standard deviation of the item's position from frame to frame.
    vibration_line_mm : tuple of float
        Root mean square displacement along the camera's axes by vibration along a line, beside that.
    vibration_periodic : float
        Share of its variance that has one frequency.
    vibration_cycles_per_frame : float
        That frequency, as frames at regular intervals sample it; 0 where there is none.
    projector_falloff : tuple of float
        Coefficients of x, y, x², xy and y², as in a world file.
    projector_flicker : float
        Standard deviation of the projector's light from frame to frame, relative.
    lamp_irradiance : float
        Light of the room's lamp on a surface that faces it, relative to the projector's white, at the point
        from which its place is given: on the camera's axis at the projector's distance. 0 for no lamp.
    lamp_angle_deg, lamp_azimuth_deg, lamp_distance_mm : float
        Place of the lamp from that point: angle from the way to the camera, direction in the image (0 right,
        90 below), and distance.
    ambient_ripple : float
        Amplitude of the rolling bands of ambient light and lamp, as a share of it; 0 where it is steady.
    band_period_px : float
        From band to band, in rows of the frame; 0 where there are none.
    band_advance : float or None
        Share of a period by which they move from frame to frame; None where they are at another place in
        each.
    placed : mapping of str to RigidTransform
        `T_camera_item` of other items that were measured on the bench, by name; the others stand where the
        twin's own file says.
    surfaces : mapping of str to PartSurface
        Of items whose surface was matched, by name; the others are what the twin's own file says.
    sigma : mapping of str to float
        Standard uncertainties that a fit stated, by name of the parameter, in its unit.
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
    vibration_line_mm: tuple[float, float, float] = NO_LINE
    vibration_periodic: float = 0.0
    vibration_cycles_per_frame: float = 0.0
    projector_falloff: tuple[float, float, float, float, float] = NO_FALLOFF
    projector_flicker: float = 0.0
    lamp_irradiance: float = 0.0
    lamp_angle_deg: float = 45.0
    lamp_azimuth_deg: float = -90.0
    lamp_distance_mm: float = 2000.0
    ambient_ripple: float = 0.0
    band_period_px: float = 0.0
    band_advance: float | None = None
    placed: Mapping[str, RigidTransform] = field(default_factory=dict)
    surfaces: Mapping[str, PartSurface] = field(default_factory=dict)
    sigma: Mapping[str, float] = field(default_factory=dict)

    @property
    def displacement_mm(self) -> float:
        """RMS displacement of the item along an axis by all of its vibration."""
        return float(np.sqrt(self.vibration_mm**2 + np.mean(np.square(self.vibration_line_mm))))

    def sigma_with(self, **known: float) -> dict[str, float]:
        """Give the standard uncertainties with some replaced.

        Parameters
        ----------
        **known : float
            By name of the parameter; 0 for one that is not known.

        Returns
        -------
        dict of str to float
            Without those that are 0.
        """
        return {name: value for name, value in {**self.sigma, **known}.items() if value or name not in known}

    def with_pose(self, index: int, pose: RigidTransform) -> TwinParameters:
        """Replace one of the poses.

        Parameters
        ----------
        index : int
            Of the pose.
        pose : RigidTransform
            `T_camera_item` of the board.

        Returns
        -------
        TwinParameters
            The same but for that pose.
        """
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
