"""The three measurement artefacts as watertight meshes.

Each asks another question of a measurement: the pyramid about inclined faces (four
orientations, two slopes), the pillars about shadows and small features at different
heights, the steps about plateaus and jumps in depth. The pyramid is smooth because
plateaus are the steps' question already. All are for a camera field of about 169 x 112 mm.

Frame: mm, base on z = 0, z up towards the viewer, centred on x = y = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from fpplab.artefacts.lengths import check_below, check_positive
from fpplab.artefacts.standards import BallBar
from fpplab.core.conventions import TWO_PI, Floats
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_atomic

ROUND = 64
"""Corners of a pillar's outline: a multiple of four; the 64-gon's sagitta is 0.12 % of its radius."""


@dataclass(frozen=True)
class Pyramid:
    """A four-sided pyramid with a small flat top on a plate; lengths in mm, `height` from the base."""

    plate: tuple[float, float] = (90.0, 70.0)
    foot: tuple[float, float] = (80.0, 60.0)
    top: tuple[float, float] = (8.0, 6.0)
    thickness: float = 5.0
    height: float = 25.0

    def __post_init__(self) -> None:
        check_positive(self)
        for axis in range(2):
            check_below(self, "top", self.top[axis], self.foot[axis], "the foot")
            check_below(self, "foot", self.foot[axis], self.plate[axis], "the plate")
        check_below(self, "thickness", self.thickness, self.height, "the height")

    def mesh(self) -> trimesh.Trimesh:
        """A single watertight body, normals outward."""
        loops = [
            _rectangle(self.plate, 0.0),
            _rectangle(self.plate, self.thickness),
            _rectangle(self.foot, self.thickness),
            _rectangle(self.top, self.height),
        ]
        walls = [_strip(low, high) for low, high in pairwise(loops)]
        return _body([_fan(loops[0][::-1]), *walls, _fan(loops[-1])])


@dataclass(frozen=True)
class Pillars:
    """Round pillars on a plate, one per cell; lengths in mm, heights from the base.

    diameters: by column, from -x to +x. heights: by row, from -y to +y, with `climb` added
    from one column to the next, so that no two pillars are alike.
    """

    plate: tuple[float, float] = (90.0, 70.0)
    thickness: float = 5.0
    diameters: tuple[float, ...] = (6.0, 9.0, 12.0, 15.0)
    heights: tuple[float, ...] = (9.0, 15.0, 21.0)
    climb: float = 1.0

    def __post_init__(self) -> None:
        check_positive(self)
        cell = min(self.plate[0] / len(self.diameters), self.plate[1] / len(self.heights))
        check_below(self, "diameters", max(self.diameters), cell, "one cell of the plate")
        check_below(self, "thickness", self.thickness, min(self.heights), "the lowest pillar")

    def mesh(self) -> trimesh.Trimesh:
        """A single watertight body, normals outward."""
        x = np.linspace(-0.5, 0.5, len(self.diameters) + 1) * self.plate[0]
        y = np.linspace(-0.5, 0.5, len(self.heights) + 1) * self.plate[1]
        parts = _plate_sides(x, y, self.thickness)
        for i, diameter in enumerate(self.diameters):
            for j, row_height in enumerate(self.heights):
                corners = _corners(x[i], x[i + 1], y[j], y[j + 1])
                centre = corners[:, :2].mean(axis=0)
                parts.append(_fan(corners[::-1]))
                parts += _pillar(
                    _lift(corners, self.thickness), centre, diameter / 2, row_height + i * self.climb
                )
        return _body(parts)


@dataclass(frozen=True)
class StepsSizes:
    """A staircase that rises along x; lengths in mm, heights of the treads from the base."""

    footprint: tuple[float, float] = (90.0, 70.0)
    heights: tuple[float, ...] = (5.0, 10.0, 15.0, 20.0, 25.0)

    def __post_init__(self) -> None:
        check_positive(self)
        if any(high <= low for low, high in pairwise(self.heights)):
            raise ConfigError(f"Steps.heights: {self.heights} must rise from each tread to the next")

    def mesh(self) -> trimesh.Trimesh:
        """A single watertight body, normals outward."""
        x = np.linspace(-0.5, 0.5, len(self.heights) + 1) * self.footprint[0]
        half, floors, parts = self.footprint[1] / 2, (0.0, *self.heights[:-1]), []
        outline = [(edge, 0.0) for edge in x] + [(x[-1], self.heights[-1])]
        for left, right, floor, height in reversed([*zip(x[:-1], x[1:], floors, self.heights, strict=True)]):
            # The foot of a riser is a corner of the tread below, so it must be one of this side too.
            rise = [(left, height), (left, floor)] if floor > 0 else [(left, height)]
            side = [(right, 0.0), (right, height), *rise, (left, 0.0)]
            parts += [_fan(_upright(side, -half)), _fan(_upright(side, half))[:, ::-1]]
            outline += rise
        return _body([*parts, _strip(_upright(outline, half), _upright(outline, -half))])


_BUILDERS: dict[str, Callable[..., Pyramid | Pillars | StepsSizes | BallBar]] = {
    "pyramid": Pyramid,
    "pillars": Pillars,
    "steps": StepsSizes,
}
NAMES = tuple(_BUILDERS)
"""What a measurement is compared with."""

_STANDARDS: dict[str, Callable[..., Pyramid | Pillars | StepsSizes | BallBar]] = {"ball_bar": BallBar}
STANDARDS = tuple(_STANDARDS)
"""What an acceptance test measures."""


Lengths = float | tuple[float, ...]
"""A field of an artefact, in mm."""


def make(name: str, sizes: Mapping[str, Lengths] | None = None) -> trimesh.Trimesh:
    """The artefact or standard of that name, in its usual size but for the lengths in `sizes`.

    Raises `ConfigError` that lists the names, or says which length it cannot have.
    """
    usual = usual_sizes(name)
    for field, value in (sizes or {}).items():
        if field not in usual:
            raise ConfigError(f"'{name}' has no length '{field}'; it has {', '.join(usual)}")
        if np.shape(value) != np.shape(usual[field]):
            raise ConfigError(
                f"'{name}' needs for '{field}' as many lengths as in {usual[field]}, not {value}"
            )
    return _builder(name)(**(sizes or {})).mesh()


def usual_sizes(name: str) -> dict[str, Lengths]:
    """The lengths of the artefact or standard of that name, in mm, by field. Raises `ConfigError`."""
    return asdict(_builder(name)())


def _builder(name: str) -> Callable[..., Pyramid | Pillars | StepsSizes | BallBar]:
    known = _BUILDERS | _STANDARDS
    if name not in known:
        raise ConfigError(f"there is no artefact '{name}'; there are {', '.join(known)}")
    return known[name]


def save_stl(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write as binary STL, whole or not at all. Raises `DataError`."""
    data = trimesh.exchange.stl.export_stl(mesh)
    write_atomic(path, lambda stream: stream.write(data))


def _corners(x0: float, x1: float, y0: float, y1: float) -> Floats:
    return np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])


def _rectangle(size: tuple[float, float], z: float) -> Floats:
    return _lift(_corners(-size[0] / 2, size[0] / 2, -size[1] / 2, size[1] / 2), z)


def _lift(loop: Floats, z: float) -> Floats:
    return np.asarray(loop + np.array([0.0, 0.0, z]))


def _upright(outline: list[tuple[float, float]], y: float) -> Floats:
    """A profile of (x, z) placed at y."""
    return np.array([(x, y, z) for x, z in outline])


def _fan(loop: Floats) -> Floats:
    """Triangles (n - 2, 3, 3) of a loop that is star-shaped about its first corner."""
    return np.stack([np.broadcast_to(loop[0], loop[1:-1].shape), loop[1:-1], loop[2:]], axis=1)


def _strip(low: Floats, high: Floats) -> Floats:
    """Triangles (2n, 3, 3) between two loops of n corners, outward for loops counter-clockwise seen
    from `high`.
    """
    low_next, high_next = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    return np.concatenate(
        [np.stack([low, low_next, high_next], axis=1), np.stack([low, high_next, high], axis=1)]
    )


def _plate_sides(x: Floats, y: Floats, thickness: float) -> list[Floats]:
    """The plate's four sides, divided where its cells are, as its upper face is."""
    ring = [(xi, y[0]) for xi in x[:-1]] + [(x[-1], yj) for yj in y[:-1]]
    ring += [(xi, y[-1]) for xi in x[:0:-1]] + [(x[0], yj) for yj in y[:0:-1]]
    loop = np.array([(px, py, 0.0) for px, py in ring])
    return [_strip(loop, _lift(loop, thickness))]


def _pillar(cell: Floats, centre: Floats, radius: float, height: float) -> list[Floats]:
    """A cell's upper face around a pillar's foot, the pillar's wall and its top."""
    angle = TWO_PI * np.arange(ROUND) / ROUND - np.pi  # so that quarter k lies towards corner k
    foot = np.empty((ROUND, 3))
    foot[:, 0], foot[:, 1] = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    foot[:, 2] = cell[0, 2]
    quarter, parts = ROUND // 4, []
    for k in range(4):
        arc = foot[np.arange(k * quarter, (k + 1) * quarter + 1) % ROUND]
        parts.append(_fan(np.concatenate([cell[k : k + 1], arc[::-1]])))
        parts.append(np.stack([cell[k], cell[(k + 1) % 4], arc[-1]])[None])
    top = _lift(foot, height - cell[0, 2])
    return [*parts, _strip(foot, top), _fan(top)]


def _body(parts: list[Floats]) -> trimesh.Trimesh:
    triangles = np.concatenate(parts)
    return trimesh.Trimesh(
        vertices=triangles.reshape(-1, 3),
        faces=np.arange(3 * len(triangles)).reshape(-1, 3),
        process=True,
    )
