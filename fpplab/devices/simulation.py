"""What a simulation offers beyond the devices, as Protocols: `isinstance(rig.simulation, Seeded)`."""

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
        """Give the true shape in mm of an item, where it stands in the camera's frame."""

    def frames(
        self,
        item: str,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        rows: Rows,
        seed: int,
        columns: Columns | None = None,
    ) -> list[Image]:
        """Take frames (R, C) of some rows and columns, or all columns, with noise and vibration by a seed.

        Light is computed once for the same item, patterns, rows and columns.
        """


@runtime_checkable
class Predictable(Protocol):
    """A simulation that can be sampled: what a search that screens by predictions needs of a rig."""

    def image_part_sampler(self, world_draw: int = 0) -> FrameSampler:
        """Give a sampler of image parts, which lives as long as the rig is open.

        A `world_draw` other than 0 draws a simulation that this one could as well be, within the uncertainty
        of what was fitted to a bench, and the same one each time.
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
        """Let the noise of the next frames follow from these numbers, not negative, and the world's seed.

        Numbers left over from an earlier call are discarded; frames beyond them follow from their own count.
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
        """Give the next frames these numbers, not negative, and count on from `then`."""
        ...


@runtime_checkable
class Restartable(Protocol):
    """A simulation that can be put back as it was after opening, at no cost."""

    def restart(self) -> None:
        """Put up what was mounted after opening, and number frames from 0 again."""
        ...


@runtime_checkable
class Timed(Protocol):
    """A simulation of devices that take time of their own, which is not the computer's."""

    def now_s(self) -> float:
        """Give the time in s since opening."""
        ...


@runtime_checkable
class Turnable(Protocol):
    """A simulation whose projector can be turned about the vertical axis through its centre.

    `fpplab optimise` uses it to search the angle of convergence.
    """

    def turn(self, convergence_deg: float) -> None:
        """Turn the projector by degrees from the world file's direction, positive towards the camera.

        Called between frames; those that follow are taken in the new arrangement.
        """
        ...
