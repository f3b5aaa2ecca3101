"""The pillars: shadows and small features at different heights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.lengths import FeatureLength, FlatFace
from fpplab.artefacts.meshing import closed_body, fan_triangles, raised, rectangle_corners, strip_triangles
from fpplab.core.conventions import TWO_PI, Floats

if TYPE_CHECKING:
    import trimesh

PILLAR_CORNERS = 64  # of a pillar's outline, a multiple of four; the 64-gon's sagitta is 0.12 % of its radius


@dataclass(frozen=True)
class Pillars(Artefact):
    """Round pillars on a plate, one in the middle of each cell of a grid, no two of the same size."""

    order: ClassVar[int] = 20

    plate: tuple[float, float] = (90.0, 70.0)  # size of the plate along x and y in mm
    thickness: float = 5.0  # of the plate, in mm
    diameters: tuple[float, ...] = (6.0, 9.0, 12.0, 15.0)  # diameter of the pillars in each column
    heights: tuple[float, ...] = (9.0, 15.0, 21.0)  # height above the base of the first pillar in each row
    climb: float = 1.0  # height added from one column to the next, in mm

    def check_lengths(self) -> None:
        cell = min(self.plate[0] / len(self.diameters), self.plate[1] / len(self.heights))
        self.check_below("diameters", max(self.diameters), cell, "one cell of the plate")
        self.check_below("thickness", self.thickness, min(self.heights), "the lowest pillar")

    def lengths(self) -> tuple[FeatureLength, ...]:
        """List the heights of the pillars above the plate, each by its column from -x and its row from -y."""
        x, y = self._borders
        half = (y[1] - y[0] - max(self.diameters)) / 2  # of the strips that no pillar stands on
        strips = [(max(at - half, y[0]), min(at + half, y[-1])) for at in y]
        plate = FlatFace(
            tuple(raised(rectangle_corners(x[0], x[-1], *strip), self.thickness) for strip in strips)
        )
        heights = []
        for i, diameter in enumerate(self.diameters):
            for j, row_height in enumerate(self.heights):
                centre = np.array([(x[i] + x[i + 1]) / 2, (y[j] + y[j + 1]) / 2])
                height = row_height + i * self.climb
                top = FlatFace((raised(_circle(centre, diameter / 2), height),))
                name = f"pillar height, column {i + 1}, row {j + 1}"
                heights.append(FeatureLength(name, plate, top, height - self.thickness))
        return tuple(heights)

    @property
    def _borders(self) -> tuple[Floats, Floats]:
        columns, rows = len(self.diameters), len(self.heights)
        return (
            np.linspace(-0.5, 0.5, columns + 1) * self.plate[0],
            np.linspace(-0.5, 0.5, rows + 1) * self.plate[1],
        )

    def mesh(self) -> trimesh.Trimesh:
        x, y = self._borders
        parts = _plate_sides(x, y, self.thickness)
        for i, diameter in enumerate(self.diameters):
            for j, row_height in enumerate(self.heights):
                corners = rectangle_corners(x[i], x[i + 1], y[j], y[j + 1])
                centre = corners[:, :2].mean(axis=0)
                parts.append(fan_triangles(corners[::-1]))
                parts += _pillar(
                    raised(corners, self.thickness), centre, diameter / 2, row_height + i * self.climb
                )
        return closed_body(parts)


def _plate_sides(x: Floats, y: Floats, thickness: float) -> list[Floats]:
    """Triangulate the plate's four sides, divided at the cell borders as its upper face is."""
    ring = [(xi, y[0]) for xi in x[:-1]] + [(x[-1], yj) for yj in y[:-1]]
    ring += [(xi, y[-1]) for xi in x[:0:-1]] + [(x[0], yj) for yj in y[:0:-1]]
    loop = np.array([(px, py, 0.0) for px, py in ring])
    return [strip_triangles(loop, raised(loop, thickness))]


def _circle(centre: Floats, radius: float) -> Floats:
    """Compute the outline (n, 3) of a pillar at z = 0; its quarter k lies towards corner k of the cell."""
    angle = TWO_PI * np.arange(PILLAR_CORNERS) / PILLAR_CORNERS - np.pi
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, np.zeros(PILLAR_CORNERS)], axis=1)


def _pillar(cell: Floats, centre: Floats, radius: float, height: float) -> list[Floats]:
    foot = raised(_circle(centre, radius), cell[0, 2])
    quarter, parts = PILLAR_CORNERS // 4, []
    for k in range(4):
        arc = foot[np.arange(k * quarter, (k + 1) * quarter + 1) % PILLAR_CORNERS]
        parts.append(fan_triangles(np.concatenate([cell[k : k + 1], arc[::-1]])))
        parts.append(np.stack([cell[k], cell[(k + 1) % 4], arc[-1]])[None])
    top = raised(foot, height - cell[0, 2])
    return [*parts, strip_triangles(foot, top), fan_triangles(top)]
