"""Characterisation boards: where their points are, what they look like, and how they are found.

The frame of a board has its origin at the board's centre, x to the right, y down and z away
from the viewer, in mm; points lie in z = 0 and are known by their row in `Target.points`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.targets.detection import Detection, detect
from fpplab.targets.partial import detect_part

Dictionary = Literal[
    "4x4_50", "4x4_100", "4x4_250", "4x4_1000", "5x5_50", "5x5_100", "5x5_250", "5x5_1000",
    "6x6_50", "6x6_100", "6x6_250", "6x6_1000",
]  # fmt: skip

RIM = 0.1
"""Ground that a circle needs around it to be found, as a share of its diameter."""

Positive = Annotated[float, Field(gt=0)]
GridCount = Annotated[int, Field(ge=2, le=200)]
Reflectance = Annotated[float, Field(ge=0, le=1)]
Box = tuple[float, float, float, float]
"""A rectangle (left, top, right, bottom) in mm in the board's frame."""


class Target(Document):
    """A flat board with points of interest.

    kind: `circles` (their centres), `checkerboard` (inner corners) or `charuco` (inner corners,
    each known by its markers, so that part of the board suffices).
    size_mm: (width, height) of the whole board. counts: points (columns, rows).
    spacing_mm: pitch of the points along x and y; for boards with corners the size of a square.
    staggered: circles only; odd columns lie half a pitch lower.
    diameter_mm: circles only. marker_mm, dictionary: ChArUco only.
    tolerance_mm: how far the points may lie from where they are drawn, one standard deviation;
    characterisation then finds the board's shape as well. Without it the board is taken as exact.
    foreground, background: reflectance of circles or dark squares, and of the rest.
    """

    kind: Literal["circles", "checkerboard", "charuco"]
    size_mm: tuple[Positive, Positive]
    counts: tuple[GridCount, GridCount]
    spacing_mm: tuple[Positive, Positive]
    staggered: bool = False
    diameter_mm: Positive | None = None
    marker_mm: Positive | None = None
    dictionary: Dictionary | None = None
    tolerance_mm: Positive | None = None
    foreground: Reflectance = 0.0
    background: Reflectance = 1.0

    @classmethod
    def load(cls, path: Path | str) -> Target:
        """Read a target file, by path or by the name of one that comes with fpplab.

        Raises `ConfigError`.
        """
        return config.load_document(config.find_config(path), cls)

    @model_validator(mode="after")
    def _fields_fit_kind(self) -> Target:
        owners = {
            "staggered": "circles",
            "diameter_mm": "circles",
            "marker_mm": "charuco",
            "dictionary": "charuco",
        }
        for name, owner in owners.items():
            if getattr(self, name) and self.kind != owner:
                raise ValueError(f"'{name}' belongs to kind {owner}, not to {self.kind}")
            if getattr(self, name) is None and self.kind == owner:
                raise ValueError(f"'{name}' is missing; kind {owner} needs it")
        return self

    @model_validator(mode="after")
    def _board_is_sound(self) -> Target:
        if self.kind != "charuco" and self.counts[0] == self.counts[1]:
            raise ValueError("'counts' must differ, or a quarter turn of the board could not be told")
        if self.kind != "charuco" and min(self.counts) < 3:
            raise ValueError("'counts' must be at least 3 each to be found")
        if self.kind != "circles" and self.spacing_mm[0] != self.spacing_mm[1]:
            raise ValueError("'spacing_mm' must be the same along x and y for squares")
        if self.marker_mm is not None and self.marker_mm >= self.spacing_mm[0]:
            raise ValueError(f"'marker_mm' must be less than the square of {self.spacing_mm[0]:g} mm")
        if self.dictionary is not None:
            markers, known = (
                (self.counts[0] + 1) * (self.counts[1] + 1) // 2,
                int(self.dictionary.split("_")[1]),
            )
            if markers > known:
                raise ValueError(f"'dictionary' has {known} markers and the board {markers} markers to fill")
        if self.foreground == self.background:
            raise ValueError("'foreground' and 'background' must differ")
        return self

    @model_validator(mode="after")
    def _points_lie_inside(self) -> Target:
        extent = np.abs(self.points()[:, :2]).max(axis=0) + self.reach()
        for name, needed, size in zip(("wide", "high"), 2 * extent, self.size_mm, strict=True):
            if needed > size + 1e-9:
                raise ValueError(f"'size_mm': its points need a board {needed:g} mm {name}, not {size:g} mm")
        most = _least_distance(self.points()) / (1 + 2 * RIM)
        if self.diameter_mm is not None and self.diameter_mm > most:
            raise ValueError(
                f"'diameter_mm' is {self.diameter_mm:g}: the circles would touch; at most {most:.3g}"
            )
        return self

    def reach(self) -> Floats:
        """How far the drawing reaches beyond its outermost points, along x and y in mm."""
        if self.diameter_mm is not None:
            return np.full(2, (0.5 + RIM) * self.diameter_mm)
        return np.array(self.spacing_mm)

    def points(self) -> Floats:
        """Points of interest (P, 3) in mm in the board's frame, row by row; z = 0.

        The row of a point in this array is its id.
        """
        columns, rows = self.counts
        j, i = np.mgrid[0:rows, 0:columns].astype(np.float64)
        x, y = i * self.spacing_mm[0], j * self.spacing_mm[1]
        if self.staggered:
            y += 0.5 * self.spacing_mm[1] * (i % 2)
        points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return np.asarray(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))

    @property
    def symmetric(self) -> bool:
        """Whether the board looks the same after half a turn."""
        columns, rows = self.counts
        if self.kind == "circles":
            return not self.staggered or columns % 2 == 0
        return self.kind == "checkerboard" and (columns + rows) % 2 == 0

    def image(self, px_per_mm: float) -> NDArray[np.uint8]:
        """The whole board as reflectance 0 … 255, uint8 [v, u], antialiased by area.

        The picture's edges are the board's edges: where the size is no whole number of pixels,
        the scale along that axis gives way.
        """
        width, height = (max(round(s * px_per_mm), 1) for s in self.size_mm)
        scale = np.array([width / self.size_mm[0], height / self.size_mm[1]])
        share = np.zeros((height, width))
        if self.diameter_mm is not None:
            _paint_circles(share, self.points(), self.diameter_mm / 2, scale)
        for box in self.boxes():
            _paint_box(share, box, scale)
        level = self.background + (self.foreground - self.background) * share
        return np.asarray(np.rint(255.0 * level), np.uint8)

    def detect(self, image: NDArray[Any]) -> Detection | None:
        """Find the board in a grey picture [v, u] of any real type; None when it is not there.

        A ChArUco board is found in part as well, any other only as a whole: see `detect_part`.
        Raises `CalibrationError` when the picture is not two-dimensional.
        """
        return detect(self, image)

    def detect_part(self, image: NDArray[Any]) -> Detection | None:
        """Find as much of the board as a grey picture [v, u] has; None when there is nothing of it.

        Raises `UnclearPart` (a `CalibrationError`) with the reason when there are points of a board and
        it is not certain which, `CalibrationError` when the picture is not two-dimensional.
        """
        return self.detect(image) or detect_part(self, image)

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's model of a ChArUco board; its origin is the first square's corner, in mm."""
        squares = (self.counts[0] + 1, self.counts[1] + 1)
        name = f"DICT_{str(self.dictionary).upper()}"
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        return cv2.aruco.CharucoBoard(squares, self.spacing_mm[0], self.marker_mm or 0.0, dictionary)

    def boxes(self) -> Iterator[Box]:
        """Rectangles in the foreground's colour, none of which overlap; none on a board of circles."""
        if self.kind == "circles":
            return
        side = self.spacing_mm[0]
        left, top = -0.5 * side * (self.counts[0] + 1), -0.5 * side * (self.counts[1] + 1)
        for row in range(self.counts[1] + 1):
            for column in range(self.counts[0] + 1):
                if (row + column) % 2 == 0:
                    x, y = left + column * side, top + row * side
                    yield x, y, x + side, y + side
        if self.kind == "charuco":
            yield from self._marker_boxes(left, top)

    def _marker_boxes(self, left: float, top: float) -> Iterator[Box]:
        board = self.charuco()
        dictionary = board.getDictionary()
        modules = dictionary.markerSize + 2
        for corners, marker in zip(np.array(board.getObjPoints()), np.array(board.getIds()), strict=True):
            (x, y), module = corners[0, :2] + (left, top), (self.marker_mm or 0.0) / modules
            bits = dictionary.generateImageMarker(int(marker), modules, borderBits=1)
            for row, column in np.argwhere(bits == 0):
                a, b = x + column * module, y + row * module
                yield a, b, a + module, b + module


def _least_distance(points: Floats) -> float:
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return float(np.min(gaps[gaps > 0]))


def _covered(start: float, end: float, length: int) -> tuple[slice, Floats]:
    """Which of `length` unit cells the interval touches, and how much of each it covers."""
    first, last = max(int(np.floor(start)), 0), min(int(np.ceil(end)), length)
    cells = np.arange(first, last)
    return slice(first, last), np.clip(np.minimum(cells + 1, end) - np.maximum(cells, start), 0, 1)


def _paint_box(share: Floats, box: Box, scale: Floats) -> None:
    """Add the exact share of each pixel that a rectangle covers; scale (2,) in px per mm."""
    height, width = share.shape
    left, top, right, bottom = box
    columns, across = _covered(scale[0] * left + width / 2, scale[0] * right + width / 2, width)
    rows, down = _covered(scale[1] * top + height / 2, scale[1] * bottom + height / 2, height)
    share[rows, columns] += np.outer(down, across)


def _paint_circles(share: Floats, points: Floats, radius: float, scale: Floats) -> None:
    """Add each disc, its rim one pixel soft: the share of a pixel that a straight edge covers."""
    height, width = share.shape
    reach = radius * scale + 1
    for x, y in points[:, :2] * scale + (width / 2, height / 2):
        columns, _ = _covered(x - reach[0], x + reach[0], width)
        rows, _ = _covered(y - reach[1], y + reach[1], height)
        v, u = np.mgrid[rows, columns] + 0.5
        distance = np.hypot((u - x) / scale[0], (v - y) / scale[1]) - radius
        share[rows, columns] += np.clip(0.5 - distance * scale.mean(), 0, 1)
