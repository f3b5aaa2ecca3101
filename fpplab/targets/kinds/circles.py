"""Grids of circles, whose centres are the points."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.targets.drawing import InkDisc, InkShape
from fpplab.targets.layout import BoardLayout, GridPatch, PointLattice
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.ordering import in_order
from fpplab.targets.patches import patch_of_blobs
from fpplab.targets.profiles import PointModel, disc
from fpplab.targets.views import Detection, eccentricity, homography


class CircleGrid(BoardLayout):
    """A grid of circles; it is detected as a whole, or in part where its edge shows which part."""

    staggered: bool = False
    """Whether odd columns lie half a pitch lower."""

    diameter_mm: Positive
    """Diameter of the circles in mm."""

    def check(self) -> None:
        self.check_counts_without_markers()
        super().check()
        gaps = np.linalg.norm(self.points()[:, None] - self.points()[None], axis=-1)
        max_diameter = float(np.min(gaps[gaps > 0])) / (1 + 2 * LIMITS.circle_rim)
        if self.diameter_mm > max_diameter:
            raise ValueError(
                f"'diameter_mm' is {self.diameter_mm:g}: the circles would touch; at most {max_diameter:.3g}"
            )

    def offsets(self, column: Floats, row: Floats) -> Floats:
        # returns (..., 2) mm
        placed = super().offsets(column, row)
        if self.staggered:
            placed[..., 1] += 0.5 * self.spacing_mm[1] * (column % 2)
        return placed

    def lattice(self) -> PointLattice:
        if not self.staggered:
            return super().lattice()
        columns, rows = self.counts
        j, i = np.mgrid[0:rows, 0:columns]
        places = np.stack([i, 2 * j + i % 2], axis=-1).reshape(-1, 2)
        return PointLattice(places, np.array(self.spacing_mm) * (1.0, 0.5), np.array([[1, 1], [-1, 1]]))

    @property
    def symmetric(self) -> bool:
        return not self.staggered or self.counts[0] % 2 == 0

    def reach(self) -> Floats:
        # returns (2,) mm
        return np.full(2, (0.5 + LIMITS.circle_rim) * self.diameter_mm)

    def shapes(self) -> Iterator[InkShape]:
        for x, y in self.points()[:, :2]:
            yield InkDisc(x, y, self.diameter_mm / 2)

    def summary(self) -> str:
        (columns, rows), (x, y) = self.counts, self.spacing_mm
        return (
            f"{columns} x {rows} circles of {self.diameter_mm:g} mm, "
            f"{'staggered, ' if self.staggered else ''}pitch {x:g} x {y:g} mm"
        )

    def point_model(self) -> PointModel:
        radius = self.diameter_mm / 2
        return disc(radius, radius + 0.8 * self._clear_rim())

    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        # grey (height, width)
        detector = self._blob_detector(grey)
        columns, rows = self.counts
        kind = cv2.CALIB_CB_ASYMMETRIC_GRID if self.staggered else cv2.CALIB_CB_SYMMETRIC_GRID
        for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
            # OpenCV staggers every other row, these boards every other column.
            is_found, pixels = cv2.findCirclesGrid(grey, (rows, columns), flags=flags, blobDetector=detector)
            if is_found:
                grid = np.asarray(pixels, np.float64).reshape(columns, rows, 2)
                return in_order(self, grid.transpose(1, 0, 2))
        return None

    def find_patch(self, grey: NDArray[np.uint8]) -> GridPatch | None:
        # grey (height, width)
        blobs = self._blob_detector(grey).detect(grey)
        return patch_of_blobs(np.array([blob.pt for blob in blobs], np.float64).reshape(-1, 2))

    def corrected(self, located: Detection) -> Detection:
        centres = located
        for _ in range(2):  # the homography is first that of the ellipses' centres, then the corrected one
            circles, matrix = self.points()[centres.ids, :2], homography(self, centres)
            offsets = eccentricity(matrix, circles, self.diameter_mm / 2)
            centres = Detection(located.ids, located.pixels - offsets)
        return centres

    def confusable(self) -> Iterator[tuple[str, dict[str, Any]]]:
        other = not self.staggered
        description = (
            "lower by half a pitch in its odd columns" if other else "without a shift of odd columns"
        )
        yield f"{description}: 'staggered' should be {str(other).lower()}", {"staggered": other}
        (columns, rows), (x, y) = self.counts, self.spacing_mm
        if self.staggered and x == y:  # OpenCV states a single pitch, and shifts rows instead of columns
            yield (
                f"in OpenCV's order: 'counts' should be [{rows}, {columns}] "
                f"and 'spacing_mm' [{x:g}, {2 * x:g}]",
                {"counts": (rows, columns), "spacing_mm": (x, 2 * x)},
            )

    def _blob_detector(self, grey: NDArray[np.uint8]) -> cv2.SimpleBlobDetector:
        parameters = cv2.SimpleBlobDetector.Params()
        parameters.blobColor = 0 if self.foreground < self.background else 255
        parameters.minArea, parameters.maxArea = 20.0, 0.02 * grey.size
        parameters.minDistBetweenBlobs = 3.0
        return cv2.SimpleBlobDetector.create(parameters)

    def _clear_rim(self) -> float:
        """Width in mm of the background that belongs to each circle alone, on the board."""
        points = self.points()[:, :2]
        distances = np.linalg.norm(points - points[len(points) // 2], axis=1)
        gap = np.min(distances[distances > 0]) - self.diameter_mm
        margin = np.min(0.5 * np.array(self.size_mm) - np.abs(points).max(axis=0)) - 0.5 * self.diameter_mm
        return float(min(0.5 * gap, margin))
