"""What a kind of board must define: its points, its drawing, its symmetry and how it is detected.

A kind is a subclass of `BoardLayout` in a module of `fpplab.targets.kinds`. The frame of a board has its
origin at the board's centre, x to the right, y down and z away from the viewer, in mm; points lie in z = 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.targets.drawing import InkShape
from fpplab.targets.fields import GridFields, PrintFields
from fpplab.targets.profiles import PointModel
from fpplab.targets.views import Detection, homography, local_frames

Cells = NDArray[np.intp]
"""Lattice coordinates (n, 2) in whole steps."""


@dataclass(frozen=True, eq=False)
class GridPatch:
    """Points of one lattice found in an image, at an unknown place of the board."""

    cells: Cells  # (n, 2) coordinates in a basis of the patch's own, right-handed as seen from the front
    pixels: Floats  # (n, 2) image coordinates (u, v) in px
    verified: bool = False  # whether each point's look was checked; else half must look like the board's


@dataclass(frozen=True, eq=False)
class PointLattice:
    """Lattice that the points of a board lie on."""

    places: Cells  # (P, 2) lattice coordinates of the board's points, in the order of their ids
    step_mm: Floats  # (2,) length of a step along x and y in mm
    basis: Cells  # (2, 2) whose columns are the lattice's shortest steps


class BoardLayout(PrintFields, GridFields, ABC):
    """A kind of board with the values of one target file; a subclass adds the kind's own fields.

    A field without a default is required in target files of the kind. A `Target` makes its layout without
    validation, after its own fields have been validated.
    """

    shows_mirroring: ClassVar[bool] = False
    """Whether a mirrored image of the board cannot be mistaken for the board."""

    def check(self) -> None:
        """Check that a board of these fields can be made and detected.

        Called when a target is validated. Overriding methods check what is special to their kind and
        call this one, which checks what all kinds have in common.

        Raises
        ------
        ValueError
            Naming the field, its value and what is allowed.
        """
        if self.foreground == self.background:
            raise ValueError("'foreground' and 'background' must differ")
        extent = np.abs(self.points()[:, :2]).max(axis=0) + self.reach()
        for name, needed, size in zip(("wide", "high"), 2 * extent, self.size_mm, strict=True):
            if needed > size + 1e-9:
                raise ValueError(f"'size_mm': its points need a board {needed:g} mm {name}, not {size:g} mm")

    def check_counts_without_markers(self) -> None:
        """Refuse counts from which points cannot be told; for the `check` of kinds without markers."""
        if self.counts[0] == self.counts[1]:
            raise ValueError("'counts' must differ, or a quarter turn of the board could not be recognised")
        if min(self.counts) < 3:
            raise ValueError("'counts' must be at least 3 each to be found")

    def offsets(self, column: Floats, row: Floats) -> Floats:
        """Place (..., 2) in mm from the grid's origin of columns and rows, which may lie beyond the board."""
        return np.stack([column * self.spacing_mm[0], row * self.spacing_mm[1]], axis=-1)

    def points(self) -> Floats:
        """Compute the points of interest, row by row.

        Returns
        -------
        Floats
            (P, 3) in mm in the board's frame, z = 0; the row of a point is its id.
        """
        columns, rows = self.counts
        j, i = np.mgrid[0:rows, 0:columns].astype(np.float64)
        flat = self.offsets(i, j).reshape(-1, 2)
        points = np.column_stack([flat, np.zeros(len(flat))])
        return np.asarray(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))

    def lattice(self) -> PointLattice:
        """Describe the points as places of a lattice, for the detection of parts of the board.

        Returns
        -------
        PointLattice
            One step per column and row.
        """
        columns, rows = self.counts
        j, i = np.mgrid[0:rows, 0:columns]
        places = np.stack([i, j], axis=-1).reshape(-1, 2)
        return PointLattice(places, np.array(self.spacing_mm), np.eye(2, dtype=np.intp))

    @property
    @abstractmethod
    def symmetric(self) -> bool:
        """Whether the board looks the same after half a turn."""

    @abstractmethod
    def reach(self) -> Floats:
        """Compute how far the drawing, with the margin it needs, extends beyond the outermost points.

        Returns
        -------
        Floats
            (2,) along x and y in mm.
        """

    @abstractmethod
    def shapes(self) -> Iterator[InkShape]:
        """Draw the board: all that has the foreground's colour.

        Yields
        ------
        InkShape
            Rectangles and discs in mm in the board's frame that do not overlap.
        """

    @abstractmethod
    def summary(self) -> str:
        """Describe the board briefly for the legend of a printed page.

        Returns
        -------
        str
            Such as "7 x 5 circles of 3 mm, pitch 9 x 9 mm".
        """

    @abstractmethod
    def point_model(self) -> PointModel:
        """Return the brightness model by which each point is located to a fraction of a pixel.

        Returns
        -------
        PointModel
            Of a point of an even row and column on a board whose foreground is dark; see `polarity`.
        """

    @abstractmethod
    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        """Find the board coarsely, to about a pixel; `fpplab.targets.detection.detect` refines the points.

        Parameters
        ----------
        grey : NDArray[np.uint8]
            Image (height, width), stretched to the full 8-bit range.
        level : Floats
            The same image as it was taken.

        Returns
        -------
        Detection or None
            Points with their ids on the board; None when it is not there.
        """

    def frames(self, located: Detection) -> Floats:
        """Compute the Jacobian of the image by the board at each point.

        Parameters
        ----------
        located : Detection
            Points found.

        Returns
        -------
        Floats
            (K, 2, 2) in px per mm.
        """
        return local_frames(homography(self, located), self.points()[located.ids, :2])

    def corrected(self, located: Detection) -> Detection:
        """Correct located features for the difference from the images of the board's points.

        Parameters
        ----------
        located : Detection
            Points located with `point_model`.

        Returns
        -------
        Detection
            Images of the board's points; here the same.
        """
        return located

    def find_patch(self, grey: NDArray[np.uint8]) -> GridPatch | None:
        """Find part of the board as a patch of its lattice, wherever that lies on the board.

        Called only when the whole board has not been found.

        Parameters
        ----------
        grey : NDArray[np.uint8]
            Image (height, width), stretched to the full 8-bit range.

        Returns
        -------
        GridPatch or None
            The largest patch; None when there is none or the kind is not detected in this way.
        """
        return None

    def polarity(self, row: int, column: int) -> int:
        """Return whether a point looks like `point_model` or like its negative.

        Parameters
        ----------
        row : int
            Of the point.
        column : int
            Of the point.

        Returns
        -------
        int
            1 for the model, -1 for its negative.
        """
        return -1 if self.foreground > self.background else 1

    def misprint(self, grey: NDArray[np.uint8]) -> str | None:
        """Look for the board in another print than the kind's own; called when it was not found.

        Parameters
        ----------
        grey : ndarray of uint8
            The image (height, width).

        Returns
        -------
        str or None
            How it is there, and what to do; None where it is not.
        """
        return None

    def confusable(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """List the kind's own fields that are easily described wrongly in a target file.

        Called when a board was not found as it is described, to name the probable mistake.

        Yields
        ------
        description : str
            How the real board differs and what the field should be.
        changes : dict[str, Any]
            The field with its other value.
        """
        yield from ()
