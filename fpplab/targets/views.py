"""Images of a plane board: points found in them, homographies and image windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError

LEAST_POINTS = 6
"""Fewer points of a board do not determine its pose well enough."""


class HasPoints(Protocol):
    """A board with points of interest: a `Target` or the layout of one."""

    def points(self) -> Floats:
        """Return the points of interest.

        Returns
        -------
        Floats
            (P, 3) in mm in the board's frame; the row of a point is its id.
        """


@dataclass(frozen=True, eq=False)
class Detection:
    """Points of a board found in an image.

    Attributes
    ----------
    ids : NDArray[np.intp]
        (K,) rows of `Target.points`.
    pixels : Floats
        (K, 2) image coordinates (u, v) in px.
    """

    ids: NDArray[np.intp]
    pixels: Floats


def whole_board(pixels: NDArray[Any]) -> Detection:
    """Give the points of a whole board their ids.

    Parameters
    ----------
    pixels : NDArray[Any]
        Image coordinates (u, v) in px of all points in the order of their ids; any shape that
        reshapes to (P, 2).

    Returns
    -------
    Detection
        With ids 0 to P - 1.
    """
    flat = np.asarray(pixels, np.float64).reshape(-1, 2)
    return Detection(np.arange(len(flat)), flat)


def homography(board: HasPoints, detection: Detection) -> Floats:
    """Fit the homography from board to image by least squares over the points found.

    Parameters
    ----------
    board : HasPoints
        The board, a `Target` or its layout.
    detection : Detection
        At least four of its points.

    Returns
    -------
    Floats
        (3, 3), from (x, y) in mm to (u, v) in px.

    Raises
    ------
    CalibrationError
        The points lie on one line.
    """
    plane = board.points()[detection.ids, :2]
    matrix, _ = cv2.findHomography(plane, detection.pixels, 0)
    if matrix is None:
        raise CalibrationError("the points found lie on one line; show more of the board")
    return np.asarray(matrix, np.float64)


def apply_homography(matrix: Floats, points: Floats) -> Floats:
    """Map points by a homography.

    Parameters
    ----------
    matrix : Floats
        (3, 3).
    points : Floats
        (..., 2).

    Returns
    -------
    Floats
        (..., 2).
    """
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def local_frames(matrix: Floats, points: Floats) -> Floats:
    """Compute the Jacobian of a homography at each point.

    Parameters
    ----------
    matrix : Floats
        (3, 3), from mm on the board to px.
    points : Floats
        (K, 2) in mm.

    Returns
    -------
    Floats
        (K, 2, 2) in px per mm.
    """
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    pixels = mapped[:, :2] / mapped[:, 2:]
    slopes = matrix[None, :2, :2] - pixels[:, :, None] * matrix[None, 2:, :2]
    return np.asarray(slopes / mapped[:, 2:, None])


def stretched(level: Floats) -> NDArray[np.uint8]:
    """Stretch an image to the full 8-bit range, which feature detectors are tuned for.

    Parameters
    ----------
    level : Floats
        Grey image (height, width).

    Returns
    -------
    NDArray[np.uint8]
        Of the same shape; the 0.5 % and 99.5 % quantiles become 0 and 255.
    """
    low, high = np.percentile(level, [0.5, 99.5])
    share = (level - low) / max(high - low, 1e-12)
    return np.asarray(np.clip(255.0 * share, 0, 255), np.uint8)


def window(level: Floats, pixel: Floats, frame: Floats, half_mm: float) -> tuple[Floats, Floats, Floats]:
    """Take the pixels of a square of the board around a point.

    Parameters
    ----------
    level : Floats
        Image (height, width) or maps (height, width, channels).
    pixel : Floats
        The point (u, v) in px.
    frame : Floats
        Jacobian (2, 2) of the board's homography there, in px per mm.
    half_mm : float
        Half the side of the square in mm.

    Returns
    -------
    x : Floats
        (n,) offsets along u from the point in px.
    y : Floats
        (n,) offsets along v from the point in px.
    values : Floats
        (n,) or (n, channels) of the image.
    """
    height, width = level.shape[:2]
    reach = half_mm * np.abs(frame).sum(axis=1)
    (left, top), (right, bottom) = np.ceil(pixel - reach).astype(int), np.floor(pixel + reach).astype(int)
    rows = slice(max(top, 0), min(bottom + 1, height))
    columns = slice(max(left, 0), min(right + 1, width))
    v, u = np.mgrid[rows, columns].astype(np.float64)
    offset = np.stack([u - pixel[0], v - pixel[1]], axis=-1)
    inside = np.abs(offset @ np.linalg.inv(frame).T).max(axis=-1) <= half_mm
    x, y = offset[inside].T
    return x, y, level[rows, columns][inside]
