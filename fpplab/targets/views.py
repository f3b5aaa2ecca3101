"""Images of a plane board: points found in them, homographies and image windows."""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError


class HasPoints(Protocol):
    """A board with points of interest: a `Target` or the layout of one."""

    def points(self) -> Floats:
        """Points of interest (P, 3) in mm in the board's frame; the row of a point is its id."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Points of a board found in an image."""

    ids: NDArray[np.intp]  # (K,) rows of `Target.points`
    pixels: Floats  # (K, 2) image coordinates (u, v) in px


def whole_board(pixels: NDArray[Any]) -> Detection:
    # pixels (u, v) px
    flat = np.asarray(pixels, np.float64).reshape(-1, 2)
    return Detection(np.arange(len(flat)), flat)


def homography(board: HasPoints, detection: Detection) -> Floats:
    # returns (3, 3) mm
    plane = board.points()[detection.ids, :2]
    matrix, _ = cv2.findHomography(plane, detection.pixels, 0)
    if matrix is None:
        raise CalibrationError("the points found lie on one line; show more of the board")
    return np.asarray(matrix, np.float64)


def apply_homography(matrix: Floats, points: Floats) -> Floats:
    # matrix (3, 3); points (..., 2); returns (..., 2)
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def homography_jacobians(matrix: Floats, points: Floats) -> Floats:
    # matrix (3, 3); points (K, 2) mm; returns (K, 2, 2) px
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    pixels = mapped[:, :2] / mapped[:, 2:]
    slopes = matrix[None, :2, :2] - pixels[:, :, None] * matrix[None, 2:, :2]
    return np.asarray(slopes / mapped[:, 2:, None])


def stretch_to_8_bits(level: Floats) -> NDArray[np.uint8]:
    # level (height, width)
    low, high = np.percentile(level, [0.5, 99.5])
    share = (level - low) / max(high - low, 1e-12)
    return np.asarray(np.clip(255.0 * share, 0, 255), np.uint8)


def window_around_point(
    level: Floats, pixel: Floats, jacobian: Floats, half_mm: float
) -> tuple[Floats, Floats, Floats]:
    # level (height, width); pixel (u, v) px; jacobian (2, 2) px; returns x (n,) px, y (n,) px, values (n,)
    rows, columns = window_pixels(level, pixel, np.linalg.inv(jacobian), half_mm)
    return columns - pixel[0], rows - pixel[1], level[rows, columns]


@kernel(error_model="numpy")
def window_pixels(
    image: NDArray[Any], pixel: Floats, inverse: Floats, half_mm: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    # image (height, width); pixel (2,) px; inverse (2, 2) mm; returns rows (n,), columns (n,)
    per_mm = half_mm / abs(inverse[0, 0] * inverse[1, 1] - inverse[0, 1] * inverse[1, 0])
    across = per_mm * (abs(inverse[1, 1]) + abs(inverse[0, 1]))
    down = per_mm * (abs(inverse[1, 0]) + abs(inverse[0, 0]))
    left, right = max(math.ceil(pixel[0] - across), 0), min(math.floor(pixel[0] + across) + 1, image.shape[1])
    top, bottom = max(math.ceil(pixel[1] - down), 0), min(math.floor(pixel[1] + down) + 1, image.shape[0])
    max_pixels = max(right - left, 0) * max(bottom - top, 0)
    rows, columns, n = np.empty(max_pixels, np.intp), np.empty(max_pixels, np.intp), 0
    for v in range(top, bottom):
        for u in range(left, right):
            x = inverse[0, 0] * (u - pixel[0]) + inverse[0, 1] * (v - pixel[1])
            y = inverse[1, 0] * (u - pixel[0]) + inverse[1, 1] * (v - pixel[1])
            if abs(x) <= half_mm and abs(y) <= half_mm:
                rows[n], columns[n], n = v, u, n + 1
    return rows[:n], columns[:n]


def eccentricity(matrix: Floats, circles: Floats, radius: float) -> Floats:
    """Compute the offset of the centres of ellipses from the images of the circles' centres."""
    # matrix (3, 3); circles (K, 2) mm; radius mm; returns (K, 2) px
    duals = np.stack([_dual_circle(circle, radius) for circle in circles])
    ellipses = matrix @ duals @ matrix.T
    return np.asarray(ellipses[:, :2, 2] / ellipses[:, 2:, 2] - apply_homography(matrix, circles))


def _dual_circle(centre: Floats, radius: float) -> Floats:
    pole = np.append(centre, 1.0)
    return np.asarray(np.outer(pole, pole) - radius**2 * np.diag([1.0, 1.0, 0.0]))
