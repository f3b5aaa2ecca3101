"""What a simulation offers beyond the devices, as far as fpplab itself uses it: Protocols.

A rig's simulation (`fpplab.devices.rig.Rig.simulation`) has an ability if it has the Protocol's methods:
`isinstance(rig.simulation, Seeded)`. A bench of real instruments has no simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image
from fpplab.devices.camera import CameraSettings
from fpplab.patterns.fringes import Pattern

Rows = NDArray[np.intp]  # rows of the camera's image, (R,), in rising order
Columns = NDArray[np.intp]  # columns of the camera's image, (C,), in rising order


class FrameSampler(Protocol):
    """Simulates some rows and columns of an item's frames, with everything that whole frames have."""

    @property
    def calibration(self) -> Calibration:
        """The true calibration of the simulation."""

    def mesh(self, item: str) -> trimesh.Trimesh:
        """Give the true shape of an item in the camera's frame.

        Parameters
        ----------
        item : str
            Name of the item.

        Returns
        -------
        trimesh.Trimesh
            In mm, where the item stands.

        Raises
        ------
        ConfigError
            There is no such item, or it is flat.
        """

    def frames(
        self,
        item: str,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        rows: Rows,
        seed: int,
        columns: Columns | None = None,
    ) -> list[Image]:
        """Take frames of some rows and columns, with noise and vibration.

        Light is computed once for the same item, patterns, rows and columns; another seed draws other noise.

        Parameters
        ----------
        item : str
            Name of the item.
        patterns : sequence of Pattern
            That the projector shows.
        settings : CameraSettings
            Of the camera.
        rows : Rows
            Rows of the image.
        seed : int
            Of noise and vibration, not negative.
        columns : Columns, optional
            Columns of the image; all by default.

        Returns
        -------
        list of Image
            One for each pattern, (R, C).

        Raises
        ------
        ConfigError
            There is no such item.
        """


@runtime_checkable
class Predictable(Protocol):
    """A simulation that can be sampled: what a search that screens by predictions needs of a rig."""

    def image_part_sampler(self, world_draw: int = 0) -> FrameSampler:
        """Give a sampler of image parts of the simulation as it stands.

        Called on the open rig.

        Parameters
        ----------
        world_draw : int
            0 for the simulation itself; any other draws one that it could as well be, within the
            uncertainty of what was fitted to a bench, and the same one each time.

        Returns
        -------
        FrameSampler
            Lives as long as the rig is open.
        """
        ...


@runtime_checkable
class Seeded(Protocol):
    """A simulation whose noise follows from random seeds that the caller gives.

    `fpplab optimise` uses it (common random numbers): with the same numbers two candidates of a search differ
    by their plans and not by the realisation of the noise.

    Examples
    --------
    >>> rig.simulation.draw(range(plan.images))
    >>> frames = list(capture(rig, plan))
    """

    def draw(self, numbers: Iterable[int]) -> None:
        """Let the noise of the next frames follow from these numbers and the world's seed.

        Called before frames are acquired. Numbers left over from an earlier call are discarded; frames beyond
        the numbers follow from their own count.

        Parameters
        ----------
        numbers : iterable of int
            Not negative, one for each of the next frames.
        """
        ...


@runtime_checkable
class NumberedFrames(Protocol):
    """A simulation whose frames are numbered, so that an interrupted session continues as if it had not been.

    The noise of a frame follows from its number. A session records the number of its first frame; whoever
    completes it, later and in another process, gives its frames the numbers that they would have had.
    """

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since opening."""
        ...

    def number_frames(self, numbers: Sequence[int], then: int) -> None:
        """Give the next frames these numbers.

        Parameters
        ----------
        numbers : sequence of int
            Not negative, one for each of the next frames.
        then : int
            Number of the frame that follows them, from which is counted on.
        """
        ...


@runtime_checkable
class Turnable(Protocol):
    """A simulation whose projector can be turned about the vertical axis through its centre.

    `fpplab optimise` uses it to search the angle of convergence.
    """

    def turn(self, convergence_deg: float) -> None:
        """Turn the projector towards the camera.

        Called between frames, on the open rig; the frames that follow are taken in the new arrangement.

        Parameters
        ----------
        convergence_deg : float
            Degrees from the world file's direction, positive towards the camera.
        """
        ...
