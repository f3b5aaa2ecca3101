"""ChArUco boards: a checkerboard with a marker in each bright square, which identify the corners."""

from collections.abc import Iterator
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.targets.drawing import InkShape
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.markers import DictionaryName, draw_marker, load_dictionary, markers_in
from fpplab.targets.profiles import PointModel, crossing_edges
from fpplab.targets.squares import SquareLayout
from fpplab.targets.views import Detection


class CharucoLayout(SquareLayout):
    """A ChArUco board; its markers identify every corner, so that any part of it is detected."""

    marker_mm: Positive
    """Side of a marker in mm, less than that of a square."""

    dictionary: DictionaryName
    """OpenCV's dictionary of markers: bits of a marker, and number of markers."""

    shows_mirroring: ClassVar[bool] = True

    def check(self) -> None:
        self.check_pitch()
        if self.marker_mm >= self.spacing_mm[0]:
            raise ValueError(f"'marker_mm' must be less than the square of {self.spacing_mm[0]:g} mm")
        markers = (self.counts[0] + 1) * (self.counts[1] + 1) // 2
        if markers > (available := markers_in(self.dictionary)):
            raise ValueError(f"'dictionary' has {available} markers and the board {markers} markers to fill")
        super().check()

    @property
    def symmetric(self) -> bool:
        return False

    def model(self) -> cv2.aruco.CharucoBoard:
        squares = (self.counts[0] + 1, self.counts[1] + 1)
        dictionary = load_dictionary(self.dictionary)
        return cv2.aruco.CharucoBoard(squares, self.spacing_mm[0], self.marker_mm, dictionary)

    def shapes(self) -> Iterator[InkShape]:
        yield from super().shapes()
        board = self.model()
        for corners, marker in zip(np.array(board.getObjPoints()), np.array(board.getIds()), strict=True):
            left, top = corners[0, :2] + self.corner
            yield from draw_marker(board.getDictionary(), int(marker), left, top, self.marker_mm)

    def summary(self) -> str:
        columns, rows = self.counts
        return (
            f"ChArUco board of {columns} x {rows} inner corners, squares of {self.spacing_mm[0]:g} mm, "
            f"markers of {self.marker_mm:g} mm, dictionary {self.dictionary}"
        )

    def point_model(self) -> PointModel:
        return crossing_edges(0.8 * (0.5 * (self.spacing_mm[0] - self.marker_mm)))

    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        # grey (height, width)
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(self.model()).detectBoard(grey)
        if ids is None or len(ids) < LIMITS.min_points:
            return None
        indices = ids.ravel().astype(np.intp)
        xy = self.points()[indices, :2]
        if np.linalg.matrix_rank(xy - xy[0], tol=1e-6) < 2:
            return None
        return Detection(indices, np.asarray(pixels, np.float64).reshape(-1, 2))

    def misprint(self, grey: NDArray[np.uint8]) -> str | None:
        # grey (height, width)
        model = self.model()
        if self._is_seen(model, np.invert(grey)):
            return "as its negative, bright for dark; print it dark on bright (`fpplab target`)"
        model.setLegacyPattern(True)  # which is the same for an odd number of rows of squares
        if self.counts[1] % 2 == 1 and self._is_seen(model, grey):
            return (
                "as OpenCV before 4.6 drew it, which begins with a bright square where the number of rows is "
                "even; print it anew (`fpplab target`)"
            )
        return None

    @staticmethod
    def _is_seen(model: cv2.aruco.CharucoBoard, grey: NDArray[np.uint8]) -> bool:
        ids = cv2.aruco.CharucoDetector(model).detectBoard(grey)[1]
        return ids is not None and len(ids) >= LIMITS.min_points
