"""The steps: plateaus and jumps in depth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.meshing import closed_body, fan_triangles, profile_at, strip_triangles
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class Staircase(Artefact):
    """A staircase of equally wide treads that rises along x.

    Attributes
    ----------
    footprint : tuple of float
        Size along x and y in mm.
    heights : tuple of float
        Heights of the treads above the base, from -x to +x, in mm, each greater than the one before.
    """

    order: ClassVar[int] = 30

    footprint: tuple[float, float] = (90.0, 70.0)
    heights: tuple[float, ...] = (5.0, 10.0, 15.0, 20.0, 25.0)

    def check_lengths(self) -> None:
        """Check that the heights increase.

        Raises
        ------
        ConfigError
            A tread is not higher than the one before.
        """
        if any(high <= low for low, high in pairwise(self.heights)):
            raise ConfigError(
                f"{type(self).__name__}.heights: {self.heights} must rise from each tread to the next"
            )

    def mesh(self) -> trimesh.Trimesh:
        """Build the surface of the body.

        Returns
        -------
        trimesh.Trimesh
            A single watertight body with outward normals, corners in mm.
        """
        x = np.linspace(-0.5, 0.5, len(self.heights) + 1) * self.footprint[0]
        half, floors, parts = self.footprint[1] / 2, (0.0, *self.heights[:-1]), []
        outline = [(edge, 0.0) for edge in x] + [(x[-1], self.heights[-1])]
        for left, right, floor, height in reversed([*zip(x[:-1], x[1:], floors, self.heights, strict=True)]):
            # The foot of a riser is a corner of the tread below, so it must be a corner of this side too.
            rise = [(left, height), (left, floor)] if floor > 0 else [(left, height)]
            side = [(right, 0.0), (right, height), *rise, (left, 0.0)]
            parts += [fan_triangles(profile_at(side, -half)), fan_triangles(profile_at(side, half))[:, ::-1]]
            outline += rise
        return closed_body([*parts, strip_triangles(profile_at(outline, half), profile_at(outline, -half))])
