"""The pyramid: inclined faces in four orientations and two slopes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.lengths import Corner, FeatureLength, FlatFace
from fpplab.artefacts.meshing import centred_rectangle, closed_body, fan_triangles, strip_triangles
from fpplab.core.conventions import Floats

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class Pyramid(Artefact):
    """A four-sided pyramid with a small flat top, on a plate."""

    order: ClassVar[int] = 10

    plate: tuple[float, float] = (90.0, 70.0)  # size of the plate along x and y in mm
    foot: tuple[float, float] = (80.0, 60.0)  # size of the pyramid's foot along x and y in mm
    top: tuple[float, float] = (8.0, 6.0)  # size of the flat top along x and y in mm
    thickness: float = 5.0  # of the plate, in mm
    height: float = 25.0  # of the top above the base, in mm

    def check_lengths(self) -> None:
        for axis in range(2):
            self.check_below("top", self.top[axis], self.foot[axis], "the foot")
            self.check_below("foot", self.foot[axis], self.plate[axis], "the plate")
        self.check_below("thickness", self.thickness, self.height, "the height")

    def lengths(self) -> tuple[FeatureLength, ...]:
        """List the sides and diagonals of the pyramid's foot, and the height of the top above the plate."""
        # The corners of the foot are those in which two inclined faces and the plate meet.
        _, outer, foot, top = self._loops()
        around = [(k, (k + 1) % 4) for k in range(4)]
        plate = FlatFace(tuple(np.stack([outer[i], outer[j], foot[j], foot[i]]) for i, j in around))
        sides = [FlatFace((np.stack([foot[i], foot[j], top[j], top[i]]),)) for i, j in around]
        corners = [Corner((plate, sides[k - 1], sides[k])) for k in range(4)]
        x, y = self.foot
        named = (
            ("x, -y side", 0, 1, x),
            ("x, +y side", 3, 2, x),
            ("y, -x side", 0, 3, y),
            ("y, +x side", 1, 2, y),
        )
        ways = [(f"foot along {name}", i, j, true) for name, i, j, true in named]
        ways += [(f"foot diagonal {k + 1}", k, k + 2, float(np.hypot(x, y))) for k in range(2)]
        height = FeatureLength("top above plate", plate, FlatFace((top,)), self.height - self.thickness)
        return (*(FeatureLength(n, corners[i], corners[j], true) for n, i, j, true in ways), height)

    def mesh(self) -> trimesh.Trimesh:
        loops = self._loops()
        walls = [strip_triangles(low, high) for low, high in pairwise(loops)]
        return closed_body([fan_triangles(loops[0][::-1]), *walls, fan_triangles(loops[-1])])

    def _loops(self) -> list[Floats]:
        """Corners (4, 3) in mm of the plate below and above, the foot and the top."""
        return [
            centred_rectangle(self.plate, 0.0),
            centred_rectangle(self.plate, self.thickness),
            centred_rectangle(self.foot, self.thickness),
            centred_rectangle(self.top, self.height),
        ]
