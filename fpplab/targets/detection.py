"""Finding a board's points in a picture, to a small part of a pixel.

A grid is found coarsely by OpenCV, brought into the board's own order, and every point is then
refined by fitting a model of what is really there: two blurred edges that cross, or the blurred
rim of a disc, on a ground whose brightness varies linearly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erf

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError

if TYPE_CHECKING:
    from fpplab.targets.target import Target

BrightnessProfile = Callable[[Floats, Floats, Floats], Floats]
"""A brightness profile of parameters θ at (x, y): its centre is θ[:2], its level and gain are free."""

LEAST_POINTS = 6
"""Fewer points of a board fix its pose too badly to be of use."""

CHECKERBOARD_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
"""Pictures are not equalised: that would make a picture of the noise of a black ground."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Points found: ids (K,) are rows of `Target.points`; pixels (K, 2) are (u, v) in px."""

    ids: NDArray[np.intp]
    pixels: Floats


def detect(target: Target, image: NDArray[Any]) -> Detection | None:
    """Find `target` in a grey picture [v, u] of integers or floats; None when it is not there.

    Of a board that looks the same after half a turn, the order is the one whose x axis points
    right or down in the picture. Raises `CalibrationError` when the picture is not two-dimensional.
    """
    if image.ndim != 2 or min(image.shape) < 16:
        raise CalibrationError(f"a board is looked for in a grey picture, not in an array {image.shape}")
    level = np.nan_to_num(np.asarray(image, np.float64))
    coarse = _FINDERS[target.kind](target, stretched(level))
    if coarse is None:
        return None
    if target.kind != "charuco":
        coarse = _in_order(target, coarse.pixels.reshape(target.counts[1], target.counts[0], 2), level)
    return refined(target, coarse, level) if coarse is not None else None


def homography(target: Target, detection: Detection) -> Floats:
    """Board (x, y) in mm to picture (u, v) in px, (3, 3), by least squares over the points found."""
    board = target.points()[detection.ids, :2]
    matrix, _ = cv2.findHomography(board, detection.pixels, 0)
    if matrix is None:
        raise CalibrationError("the points found lie on one line; show more of the board")
    return np.asarray(matrix, np.float64)


def apply_homography(matrix: Floats, points: Floats) -> Floats:
    """Points (..., 2) through a homography (3, 3)."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def local_frames(matrix: Floats, points: Floats) -> Floats:
    """Jacobians (K, 2, 2) of a homography at points (K, 2): px per mm."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    pixels = mapped[:, :2] / mapped[:, 2:]
    slopes = matrix[None, :2, :2] - pixels[:, :, None] * matrix[None, 2:, :2]
    return np.asarray(slopes / mapped[:, 2:, None])


def stretched(level: Floats) -> NDArray[np.uint8]:
    """The picture on the full 8-bit scale: finders are tuned for well exposed pictures."""
    low, high = np.percentile(level, [0.5, 99.5])
    share = (level - low) / max(high - low, 1e-12)
    return np.asarray(np.clip(255.0 * share, 0, 255), np.uint8)


def _find_checkerboard(target: Target, grey: NDArray[np.uint8]) -> Detection | None:
    found, pixels = cv2.findChessboardCornersSB(grey, target.counts, flags=CHECKERBOARD_FLAGS)
    return _whole(pixels) if found else None


def _find_circles(target: Target, grey: NDArray[np.uint8]) -> Detection | None:
    detector = _blob_detector(target, grey)
    columns, rows = target.counts
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if target.staggered else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        # OpenCV staggers every other row, a board of ours every other column.
        found, pixels = cv2.findCirclesGrid(grey, (rows, columns), flags=flags, blobDetector=detector)
        if found:
            grid = np.asarray(pixels, np.float64).reshape(columns, rows, 2)
            return _whole(grid.transpose(1, 0, 2))
    return None


def blobs(target: Target, grey: NDArray[np.uint8]) -> Floats:
    """Middles (n, 2) in px of all that could be circles of the board."""
    found = _blob_detector(target, grey).detect(grey)
    return np.array([blob.pt for blob in found], np.float64).reshape(-1, 2)


def _blob_detector(target: Target, grey: NDArray[np.uint8]) -> cv2.SimpleBlobDetector:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.blobColor = 0 if target.foreground < target.background else 255
    parameters.minArea, parameters.maxArea = 20.0, 0.02 * grey.size
    parameters.minDistBetweenBlobs = 3.0
    return cv2.SimpleBlobDetector.create(parameters)


def _find_charuco(target: Target, grey: NDArray[np.uint8]) -> Detection | None:
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(target.charuco()).detectBoard(grey)
    if ids is None or len(ids) < LEAST_POINTS:
        return None
    found = ids.ravel().astype(np.intp)
    xy = target.points()[found, :2]
    if np.linalg.matrix_rank(xy - xy[0], tol=1e-6) < 2:
        return None
    return Detection(found, np.asarray(pixels, np.float64).reshape(-1, 2))


_FINDERS: dict[str, Callable[[Target, NDArray[np.uint8]], Detection | None]] = {
    "checkerboard": _find_checkerboard,
    "circles": _find_circles,
    "charuco": _find_charuco,
}


def _whole(pixels: NDArray[Any]) -> Detection:
    flat = np.asarray(pixels, np.float64).reshape(-1, 2)
    return Detection(np.arange(len(flat)), flat)


def _in_order(target: Target, grid: Floats, level: Floats) -> Detection | None:
    """The grid (rows, columns, 2) in the order of the board's ids: seen from the front, right way up."""
    turns = [grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]]
    fits = [(_misfit(target, turn), turn) for turn in turns if _seen_from_front(turn)]
    best = min(misfit for misfit, _ in fits)
    spacing = float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
    if best > 0.25 * spacing:
        return None
    candidates = [turn for misfit, turn in fits if misfit < best + 0.1 * spacing]
    if target.kind == "checkerboard" and not target.symmetric:
        candidates = [turn for turn in candidates if _colours_agree(target, turn, level)]
    return _whole(max(candidates, key=_uprightness)) if candidates else None


def _seen_from_front(grid: Floats) -> bool:
    x, y = np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def _misfit(target: Target, grid: Floats) -> float:
    """RMS distance in px of a grid from the best perspective view of the board."""
    found = _whole(grid)
    seen = apply_homography(homography(target, found), target.points()[:, :2])
    return float(np.sqrt(np.mean(np.sum((seen - found.pixels) ** 2, axis=1))))


def _uprightness(grid: Floats) -> float:
    # The diagonal between the two choices lies where boards are seldom held.
    right, down = np.diff(grid, axis=1).mean(axis=(0, 1))
    return float(right + down)


def _colours_agree(target: Target, grid: Floats, level: Floats) -> bool:
    """Whether dark and light squares lie where the board has them."""
    middles = 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])
    u, v = np.rint(middles).astype(int).transpose(2, 0, 1)
    seen = level[v.clip(0, level.shape[0] - 1), u.clip(0, level.shape[1] - 1)]
    rows, columns = np.indices(seen.shape)
    contrast = seen[(rows + columns) % 2 == 1].mean() - seen[(rows + columns) % 2 == 0].mean()
    return bool(contrast * (target.background - target.foreground) > 0)


def refined(target: Target, coarse: Detection, level: Floats) -> Detection | None:
    """Every point by its own model fit; points whose fit fails are left out."""
    board = target.points()[coarse.ids, :2]
    matrix = homography(target, coarse)
    frames = local_frames(matrix, board)
    shape, start, half_mm = model(target)
    kept = []
    for index, (pixel, frame) in enumerate(zip(coarse.pixels, frames, strict=True)):
        centre = _fit_centre(level, pixel, frame, half_mm, shape, start)
        if centre is not None:
            kept.append((index, centre))
    if len(kept) < LEAST_POINTS:
        return None
    found = Detection(coarse.ids[[i for i, _ in kept]], np.array([c for _, c in kept]))
    if target.diameter_mm is None:
        return found
    return _centred(target, found)


def _centred(target: Target, ellipses: Detection) -> Detection:
    """The pictures of the circles' centres, from the centres of their ellipses."""
    found = ellipses
    for _ in range(2):  # the view is first taken from the ellipses, then from what it makes of them
        found = Detection(ellipses.ids, ellipses.pixels - eccentricity(target, found))
    return found


def model(target: Target) -> tuple[BrightnessProfile, Callable[[Floats], Floats], float]:
    """The profile of a point, its first parameters in a local frame, and half the window's side in mm."""
    if target.diameter_mm is not None:
        radius = target.diameter_mm / 2
        return _disc, lambda frame: _disc_start(frame, radius), radius + 0.8 * _clear_rim(target)
    pitch = target.spacing_mm[0]
    # Beyond this a marker, or the next corner's edges, would be in the window.
    clear = 0.5 * (pitch - target.marker_mm) if target.marker_mm is not None else 0.5 * pitch
    return _crossing, _crossing_start, 0.8 * clear


def _clear_rim(target: Target) -> float:
    """Width of the ground in mm that belongs to each circle alone, on the board."""
    points, diameter = target.points()[:, :2], target.diameter_mm or 0.0
    distances = np.linalg.norm(points - points[len(points) // 2], axis=1)
    gap = np.min(distances[distances > 0]) - diameter
    margin = np.min(0.5 * np.array(target.size_mm) - np.abs(points).max(axis=0)) - 0.5 * diameter
    return float(min(0.5 * gap, margin))


def _fit_centre(
    level: Floats,
    pixel: Floats,
    frame: Floats,
    half_mm: float,
    shape: BrightnessProfile,
    start: Callable[[Floats], Floats],
) -> Floats | None:
    """The centre in px of the profile that fits best around `pixel`; None when there is none."""
    x, y, seen = window(level, pixel, frame, half_mm)
    if len(seen) < 25:
        return None

    def misfit(theta: Floats) -> Floats:
        # The ground's plane and the profile's gain enter linearly: they are solved for within.
        basis = np.stack([np.ones_like(x), x, y, shape(theta, x, y)], axis=1)
        normal = basis.T @ basis + 1e-9 * len(x) * np.eye(4)
        return np.asarray(seen - basis @ np.linalg.solve(normal, basis.T @ seen))

    fit = least_squares(misfit, start(frame), method="lm", max_nfev=400)
    shift = np.linalg.solve(frame, fit.x[:2])
    if not fit.success or not np.all(np.isfinite(fit.x)) or np.abs(shift).max() > 0.5 * half_mm:
        return None
    return np.asarray(pixel + fit.x[:2])


def window(level: Floats, pixel: Floats, frame: Floats, half_mm: float) -> tuple[Floats, Floats, Floats]:
    """Pixels of the board's square of half side `half_mm` around `pixel`: (x, y) from it, and values."""
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


def _crossing_start(frame: Floats) -> Floats:
    """θ = (x, y, directions of the two edges in rad, blur in px)."""
    along_x, along_y = np.arctan2(frame[1], frame[0])
    return np.array([0.0, 0.0, along_x, along_y, 1.0])


def _crossing(theta: Floats, x: Floats, y: Floats) -> Floats:
    u, v = x - theta[0], y - theta[1]
    first = (np.cos(theta[2]) * v - np.sin(theta[2]) * u) / theta[4]
    second = (np.cos(theta[3]) * v - np.sin(theta[3]) * u) / theta[4]
    return np.asarray(erf(first) * erf(second))


def _disc_start(frame: Floats, radius_mm: float) -> Floats:
    """θ = (x, y, the ellipse's form (a, b, c), blur in px): the rim is a x² + 2 b x y + c y² = 1."""
    inverse = np.linalg.inv(frame) / radius_mm
    form = inverse.T @ inverse
    return np.array([0.0, 0.0, form[0, 0], form[0, 1], form[1, 1], 1.0])


def _disc(theta: Floats, x: Floats, y: Floats) -> Floats:
    u, v = x - theta[0], y - theta[1]
    along_u, along_v = theta[2] * u + theta[3] * v, theta[3] * u + theta[4] * v
    radius = np.sqrt(np.maximum(u * along_u + v * along_v, 1e-12))
    # Distance from the rim to first order; only pixels near the rim tell anything.
    distance = (radius - 1) * radius / np.maximum(np.hypot(along_u, along_v), 1e-12)
    return np.asarray(erf(distance / theta[5]))


def eccentricity(target: Target, found: Detection) -> Floats:
    """By how much the centres of the ellipses miss the pictures of the circles' centres, (K, 2) in px.

    The centre of a conic is the pole of the line at infinity, so it is read off the dual conic of
    each circle, C* -> H C* H^T (Heikkilä, "Geometric camera calibration using circular control points",
    2000). The lens bends the ellipse as well, which is left alone: a displacement d shifts the centre
    of a disc of radius r px by r^2/8 times the Laplacian of d, for d = k1 f x (x^2 + y^2) that is
    k1 x r^2/f: 0.001 px for k1 = 0.1, r = 15 px at x = 0.15, f = 3600 px.

    Only the camera sees ellipses. The projector's coordinates of a point are those of the decoded
    maps at the corrected centre.
    """
    matrix = homography(target, found)
    circles = target.points()[found.ids, :2]
    radius = (target.diameter_mm or 0.0) / 2
    duals = np.stack([_dual_circle(circle, radius) for circle in circles])
    seen = matrix @ duals @ matrix.T
    return np.asarray(seen[:, :2, 2] / seen[:, 2:, 2] - apply_homography(matrix, circles))


def _dual_circle(centre: Floats, radius: float) -> Floats:
    pole = np.append(centre, 1.0)
    return np.asarray(np.outer(pole, pole) - radius**2 * np.diag([1.0, 1.0, 0.0]))
