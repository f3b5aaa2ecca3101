"""Checkerboards: alternating squares, whose inner corners are the points."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.targets.layout import GridPatch
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.ordering import in_order
from fpplab.targets.patches import facing_front
from fpplab.targets.profiles import PointModel, crossing_edges
from fpplab.targets.squares import SquareLayout
from fpplab.targets.views import Detection

FINDER_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
"""Without equalisation, which would amplify the noise of a black background."""


class Checkerboard(SquareLayout):
    """A checkerboard; it is detected as a whole, or in part where its edge shows which part."""

    def check(self) -> None:
        self.check_counts_without_markers()
        self.check_pitch()
        super().check()

    @property
    def symmetric(self) -> bool:
        return sum(self.counts) % 2 == 0

    def summary(self) -> str:
        columns, rows = self.counts
        return f"checkerboard of {columns} x {rows} inner corners, squares of {self.spacing_mm[0]:g} mm"

    def point_model(self) -> PointModel:
        return crossing_edges(0.8 * 0.5 * self.spacing_mm[0])

    def polarity(self, row: int, column: int) -> int:
        sign = super().polarity(row, column)
        return sign if (row + column) % 2 == 0 else -sign

    def find(self, grey: NDArray[np.uint8], level: Floats) -> Detection | None:
        # grey (height, width)
        pixels = self._corners(grey)
        if pixels is None:
            return None
        grid = pixels.reshape(self.counts[1], self.counts[0], 2)
        return in_order(self, grid, None if self.symmetric else lambda turn: self._colours_agree(turn, level))

    def _corners(self, grey: NDArray[np.uint8]) -> Floats | None:
        """Find the corners, in a picture of half the size where that suffices, four times as fast."""
        for scale in (2, 1) if min(grey.shape) >= LIMITS.min_halved_px else (1,):
            size = grey.shape[1] // scale, grey.shape[0] // scale
            image = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            is_found, pixels = cv2.findChessboardCornersSB(image, self.counts, flags=FINDER_FLAGS)
            if is_found:
                corners = scale * (np.asarray(pixels, np.float64).reshape(-1, 2) + 0.5) - 0.5
                return corners if scale == 1 else self._locate_corners(grey, corners)
        return None

    def _locate_corners(self, grey: NDArray[np.uint8], corners: Floats) -> Floats:
        """Locate corners in the whole picture, in windows that the next corner's edges do not enter."""
        grid = corners.reshape(self.counts[1], self.counts[0], 2)
        smallest_step = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
        half = int(min(LIMITS.max_refinement_px, 0.4 * smallest_step))
        if half < 2:
            return corners
        end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
        refined = np.ascontiguousarray(corners[:, None], np.float32)
        return np.asarray(cv2.cornerSubPix(grey, refined, (half, half), (-1, -1), end), np.float64)[:, 0]

    def find_patch(self, grey: NDArray[np.uint8]) -> GridPatch | None:
        # grey (height, width)
        flags = FINDER_FLAGS | cv2.CALIB_CB_LARGER
        is_found, pixels, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
        if not is_found:
            return None
        rows, columns = meta.shape[:2]
        grid = np.asarray(pixels, np.float64).reshape(rows, columns, 2)
        j, i = np.mgrid[0:rows, 0:columns]
        return facing_front(np.stack([i, j], axis=-1).reshape(-1, 2), grid.reshape(-1, 2))

    def _colours_agree(self, grid: Floats, level: Floats) -> bool:
        middles = 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])
        u, v = np.rint(middles).astype(int).transpose(2, 0, 1)
        levels = level[v.clip(0, level.shape[0] - 1), u.clip(0, level.shape[1] - 1)]
        rows, columns = np.indices(levels.shape)
        contrast = levels[(rows + columns) % 2 == 1].mean() - levels[(rows + columns) % 2 == 0].mean()
        return bool(contrast * (self.background - self.foreground) > 0)
