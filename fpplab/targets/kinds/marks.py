"""Reference marks: a marker with a circle at each corner; each mark is found by itself."""

from collections.abc import Iterator
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.targets.drawing import InkDisc, InkShape
from fpplab.targets.layout import BoardLayout
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.markers import DictionaryName, draw_marker, load_dictionary, markers_in
from fpplab.targets.profiles import PointModel, disc
from fpplab.targets.views import Detection, apply_homography, eccentricity, homography, homography_jacobians

CIRCLES = 4


class ReferenceMarks(BoardLayout):
    """A grid of circles with a marker amid every four of them, which together are a mark.

    Marks may be cut apart and fixed at different depths: nothing relies on where one is beside another.
    """

    diameter_mm: Positive
    """Diameter of the circles in mm."""

    marker_mm: Positive
    """Side of a marker in mm."""

    dictionary: DictionaryName
    """OpenCV's dictionary of markers; another one than the board's, where that has markers."""

    shows_mirroring: ClassVar[bool] = True

    def check(self) -> None:
        if self.counts[0] % 2 or self.counts[1] % 2:
            raise ValueError(f"'counts' is {list(self.counts)}: must be even, two by two circles are a mark")
        if (marks := len(self.circles())) > (available := markers_in(self.dictionary)):
            raise ValueError(f"'dictionary' has {available} markers and the board {marks} marks")
        if self._room() < (widest := (0.5 + LIMITS.circle_rim) * self.diameter_mm):
            raise ValueError(
                f"'marker_mm' is {self.marker_mm:g}: leaves {self._room():g} mm for circles, "
                f"which need {widest:g} mm from their centres"
            )
        super().check()

    @property
    def symmetric(self) -> bool:
        return False

    def reach(self) -> Floats:
        # returns (2,) mm
        return np.full(2, (0.5 + LIMITS.circle_rim) * self.diameter_mm)

    def shapes(self) -> Iterator[InkShape]:
        points, dictionary = self.points()[:, :2], load_dictionary(self.dictionary)
        for x, y in points:
            yield InkDisc(x, y, self.diameter_mm / 2)
        for marker, circles in enumerate(self.circles()):
            left, top = points[circles].mean(axis=0) - 0.5 * self.marker_mm
            yield from draw_marker(dictionary, marker, left, top, self.marker_mm)

    def summary(self) -> str:
        return (
            f"{len(self.circles())} reference marks of four circles of {self.diameter_mm:g} mm, markers of "
            f"{self.marker_mm:g} mm, dictionary {self.dictionary}; may be cut apart, never reprinted in place"
        )

    def point_model(self) -> PointModel:
        radius = self.diameter_mm / 2
        return disc(radius, radius + 0.8 * (self._room() - radius))

    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        # grey (height, width)
        detector = cv2.aruco.ArucoDetector(load_dictionary(self.dictionary))
        corners, markers, _ = detector.detectMarkers(grey if self.background > self.foreground else ~grey)
        if markers is None:
            return None
        points, marks = self.points()[:, :2], self.circles()
        half = 0.5 * self.marker_mm * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        ids, pixels = [], []
        for image, marker in zip(corners, markers.ravel(), strict=True):
            if marker < len(marks):
                circles = points[marks[marker]]
                square = np.asarray(circles.mean(axis=0) + half, np.float32)
                matrix = np.asarray(cv2.getPerspectiveTransform(square, image.reshape(4, 2)), np.float64)
                ids.append(marks[marker])
                pixels.append(apply_homography(matrix, circles))
        return Detection(np.concatenate(ids), np.concatenate(pixels)) if ids else None

    def jacobians(self, located: Detection) -> Floats:
        jacobians = np.full((len(located.ids), 2, 2), np.nan)
        for rows, matrix in self._seen_marks(located):
            jacobians[rows] = homography_jacobians(matrix, self.points()[located.ids[rows], :2])
        return jacobians

    def corrected(self, located: Detection) -> Detection:
        ids, centres = [], []
        for rows, matrix in self._seen_marks(located):
            circles = self.points()[located.ids[rows], :2]
            ids.append(located.ids[rows])
            centres.append(located.pixels[rows] - eccentricity(matrix, circles, self.diameter_mm / 2))
        if not ids:
            return Detection(np.empty(0, np.intp), np.empty((0, 2)))
        return Detection(np.concatenate(ids), np.concatenate(centres))

    def _seen_marks(self, located: Detection) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        """List the rows (4,) of each mark whose circles are all there, with its homography (3, 3)."""
        for circles in self.circles():
            rows = np.flatnonzero(np.isin(located.ids, circles))
            if len(rows) == CIRCLES:
                yield rows, homography(self, Detection(located.ids[rows], located.pixels[rows]))

    def circles(self) -> NDArray[np.intp]:
        columns, rows = self.counts
        first = 2 * (columns * np.arange(rows // 2)[:, None] + np.arange(columns // 2)).reshape(-1, 1)
        return np.asarray(first + [0, 1, columns, columns + 1], np.intp)

    def _room(self) -> float:
        """Width in mm beside the centre of a circle that shows nothing but the circle."""
        pitch = min(self.spacing_mm)
        return min(0.5 * (pitch - self.marker_mm), 0.5 * pitch)
