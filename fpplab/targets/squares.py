"""Boards of squares: what a checkerboard and a ChArUco board have in common."""

from collections.abc import Iterator

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.targets.drawing import InkBox, InkShape
from fpplab.targets.layout import BoardLayout


class SquareLayout(BoardLayout):
    """A board of alternating squares, whose points are the inner corners."""

    def check_pitch(self) -> None:
        if self.spacing_mm[0] != self.spacing_mm[1]:
            raise ValueError("'spacing_mm' must be the same along x and y for squares")

    def reach(self) -> Floats:
        # returns (2,) mm
        return np.array(self.spacing_mm)

    @property
    def corner(self) -> tuple[float, float]:
        """(x, y) in mm of the upper left corner of all squares, in the board's frame."""
        side = self.spacing_mm[0]
        return -0.5 * side * (self.counts[0] + 1), -0.5 * side * (self.counts[1] + 1)

    def shapes(self) -> Iterator[InkShape]:
        """Draw the squares, the upper left one in the foreground's colour."""
        side = self.spacing_mm[0]
        left, top = self.corner
        for row in range(self.counts[1] + 1):
            for column in range(self.counts[0] + 1):
                if (row + column) % 2 == 0:
                    x, y = left + column * side, top + row * side
                    yield InkBox(x, y, x + side, y + side)
