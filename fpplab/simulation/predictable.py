"""The Protocol by which predictions reach a simulation: frames of parts of the camera's image alone.

A rig's simulation that can be sampled is `Predictable`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from fpplab.simulation.surface import PartSurface

Rows = NDArray[np.intp]
"""Rows of the camera's image, (R,), in rising order."""
Columns = NDArray[np.intp]
"""Columns of the camera's image, (C,), in rising order."""


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

    def surface(self, item: str) -> PartSurface | None:
        """Give the surface of an item as it was matched to a scan.

        Parameters
        ----------
        item : str
            Name of the item.

        Returns
        -------
        PartSurface or None
            None where it was not matched.

        Raises
        ------
        ConfigError
            There is no such item.
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
    """A simulation that can be sampled: what `fpplab predict` needs of a rig."""

    def sampler(self, draw: int = 0) -> FrameSampler:
        """Give a sampler of the simulation as it stands.

        Called on the open rig.

        Parameters
        ----------
        draw : int
            0 for the simulation itself; any other draws one that it could as well be, within the
            uncertainty of what was fitted to a bench, and the same one each time.

        Returns
        -------
        FrameSampler
            Lives as long as the rig is open.
        """
        ...
