"""What a kind of board must define: its points, its drawing, its symmetry and how it is detected."""

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
from fpplab.targets.views import Detection, homography, homography_jacobians

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
    """A kind of board with the values of one target file; a subclass adds the kind's own fields."""

    shows_mirroring: ClassVar[bool] = False
    """Whether a mirrored image of the board cannot be mistaken for the board."""

    def check(self) -> None:
        """Check that a board of these fields can be made and detected; overriding methods call this one."""
        if self.foreground == self.background:
            raise ValueError("'foreground' and 'background' must differ")
        extent = np.abs(self.points()[:, :2]).max(axis=0) + self.reach()
        for name, needed, size in zip(("wide", "high"), 2 * extent, self.size_mm, strict=True):
            if needed > size + 1e-9:
                raise ValueError(f"'size_mm': its points need a board {needed:g} mm {name}, not {size:g} mm")

    def check_counts_without_markers(self) -> None:
        if self.counts[0] == self.counts[1]:
            raise ValueError("'counts' must differ, or a quarter turn of the board could not be recognised")
        if min(self.counts) < 3:
            raise ValueError("'counts' must be at least 3 each to be found")

    def offsets(self, column: Floats, row: Floats) -> Floats:
        """Place (..., 2) in mm from the grid's origin of columns and rows, which may lie beyond the board."""
        return np.stack([column * self.spacing_mm[0], row * self.spacing_mm[1]], axis=-1)

    def points(self) -> Floats:
        """Compute the points of interest (P, 3) in mm, row by row; the row of a point is its id."""
        columns, rows = self.counts
        j, i = np.mgrid[0:rows, 0:columns].astype(np.float64)
        flat = self.offsets(i, j).reshape(-1, 2)
        points = np.column_stack([flat, np.zeros(len(flat))])
        return np.asarray(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))

    def lattice(self) -> PointLattice:
        """Describe the points as places of a lattice, for the detection of parts of the board."""
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
        """Compute how far (2,) in mm the drawing and its margin extend beyond the outermost points."""

    @abstractmethod
    def shapes(self) -> Iterator[InkShape]:
        """Draw the board: all that has the foreground's colour, without overlaps."""

    @abstractmethod
    def summary(self) -> str:
        """Describe the board for the legend of a page, such as "7 x 5 circles of 3 mm, pitch 9 x 9 mm"."""

    @abstractmethod
    def point_model(self) -> PointModel:
        """Return the brightness model of a point of even row and column, for a dark foreground."""

    @abstractmethod
    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        """Find the board to about a pixel, in the image stretched to 8 bits and as it was taken."""

    def jacobians(self, located: Detection) -> Floats:
        """Compute the Jacobian (K, 2, 2) in px per mm of the image by the board at each point."""
        return homography_jacobians(homography(self, located), self.points()[located.ids, :2])

    def corrected(self, located: Detection) -> Detection:
        """Correct features located with `point_model` to images of the board's points."""
        return located

    def find_patch(self, grey: NDArray[np.uint8]) -> GridPatch | None:
        """Find the largest patch of the lattice; called when the whole board has not been found."""
        return None

    def polarity(self, row: int, column: int) -> int:
        """Return 1 for a point that looks like `point_model`, -1 for its negative."""
        return -1 if self.foreground > self.background else 1

    def misprint(self, grey: NDArray[np.uint8]) -> str | None:
        """Say how the board is there in another print than the kind's own; called when it was not found."""
        return None

    def confusable(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """List how a board may differ from its description, and the fields changed accordingly."""
        yield from ()
