"""The steps: plateaus and jumps in depth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.lengths import FeatureLength, FlatFace
from fpplab.artefacts.meshing import (
    closed_body,
    fan_triangles,
    profile_at,
    raised,
    rectangle_corners,
    strip_triangles,
)
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class Staircase(Artefact):
    """A staircase of equally wide treads that rises along x."""

    order: ClassVar[int] = 30

    footprint: tuple[float, float] = (90.0, 70.0)  # size along x and y in mm
    heights: tuple[float, ...] = (5.0, 10.0, 15.0, 20.0, 25.0)  # heights of the treads above the base

    def check_lengths(self) -> None:
        if any(high <= low for low, high in pairwise(self.heights)):
            raise ConfigError(
                f"{type(self).__name__}.heights: {self.heights} must rise from each tread to the next"
            )

    def lengths(self) -> tuple[FeatureLength, ...]:
        """List the heights of the steps: each tread above the last, and the highest above the lowest."""
        x, half = self._edges, self.footprint[1] / 2
        treads = [
            FlatFace((raised(rectangle_corners(left, right, -half, half), height),))
            for (left, right), height in zip(pairwise(x), self.heights, strict=True)
        ]
        pairs = [(k, k + 1) for k in range(len(treads) - 1)]
        pairs += [(0, len(treads) - 1)] if len(treads) > 2 else []
        return tuple(
            FeatureLength(
                f"step height {i + 1} to {j + 1}", treads[i], treads[j], self.heights[j] - self.heights[i]
            )
            for i, j in pairs
        )

    @property
    def _edges(self) -> Floats:
        return np.linspace(-0.5, 0.5, len(self.heights) + 1) * self.footprint[0]

    def mesh(self) -> trimesh.Trimesh:
        x, half = self._edges, self.footprint[1] / 2
        floors, parts = (0.0, *self.heights[:-1]), []
        outline = [(edge, 0.0) for edge in x] + [(x[-1], self.heights[-1])]
        for left, right, floor, height in reversed([*zip(x[:-1], x[1:], floors, self.heights, strict=True)]):
            # The foot of a riser is a corner of the tread below, so it must be a corner of this side too.
            rise = [(left, height), (left, floor)] if floor > 0 else [(left, height)]
            side = [(right, 0.0), (right, height), *rise, (left, 0.0)]
            parts += [fan_triangles(profile_at(side, -half)), fan_triangles(profile_at(side, half))[:, ::-1]]
            outline += rise
        return closed_body([*parts, strip_triangles(profile_at(outline, half), profile_at(outline, -half))])
