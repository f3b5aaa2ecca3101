"""Observation of one pose of a board: where its points lie for the camera and for the projector.

The projector coordinates of a point come from a smooth fit to the decoded maps around it, not from the
pixel it falls on: noise averages out and wrong fringe orders are detected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.characterisation.limits import LOCAL_FIT_LIMITS, USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.limits import LOCAL_FIT_LIMITS as LIMITS
from fpplab.core.cholesky import solve_positive
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import AXES, Floats, Map
from fpplab.core.errors import CalibrationError
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.targets import Target, UnclearPart
from fpplab.targets.limits import TARGET_LIMITS
from fpplab.targets.partial import detect_part
from fpplab.targets.views import Detection, homography, stretch_to_8_bits, window_pixels

if TYPE_CHECKING:
    from fpplab.phase import Decoded


@dataclass(frozen=True, eq=False)
class Observation:
    """One pose of a board."""

    name: str  # of the pose
    ids: NDArray[np.intp]  # (K,) rows of `Target.points`
    camera_px: Floats  # (K, 2) image coordinates (u, v) in px
    projector_px: Floats  # (K, 2) projector coordinates (u, v) in px
    repaired: float = 0.0  # share of the pixels used whose fringe order was corrected
    board_shift_px: float | None = None  # of the board in the camera's image from the first set to the last

    @property
    def projector_px_per_px(self) -> float:
        """How many projector px one camera px covers on the board."""
        return float(np.linalg.norm(np.std(self.projector_px, axis=0) / np.std(self.camera_px, axis=0)))


def finest_periods(plan: Plan, projector_size: tuple[int, int]) -> tuple[float, float]:
    """Compute the period of the finest fringes of a plan, for `observe`."""
    # projector_size (width, height) px
    if plan.unwrapped_axes != ("x", "y"):
        raise CalibrationError("characterisation needs fringes along x and y; use a plan that has both")
    # Other codes than fringes have no orders that could be wrong by one: their period is the whole length.
    fringes = [each for each in plan.sets if isinstance(each, FringeSet)]
    x, y = (max((each.stripes for each in fringes if each.axis == axis), default=1.0) for axis in AXES)
    return projector_size[0] / x, projector_size[1] / y


def observe(
    name: str,
    image: NDArray[Any],
    decoded: Decoded,
    target: Target,
    periods_px: tuple[float, float] | None = None,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> Observation:
    """Find a board in one capture, and its points in the camera and in the projector."""
    # image (height, width)
    if image.shape != decoded.u.shape:
        raise CalibrationError(
            f"{name}: the image is {image.shape[::-1]} but the decoded maps {decoded.u.shape[::-1]}"
        )
    detection = target.detect(image) or _detect_board_part(name, image, target)
    maps = np.stack([decoded.u, decoded.v], axis=-1).astype(np.float64)
    maps[_find_edge_pixels(decoded.modulation, limits.max_modulation_gradient)] = np.nan
    repaired = 0.0
    if periods_px is not None:
        maps, repaired = _with_corrected_orders(name, maps, target, detection, np.array(periods_px), limits)
    half_mm = LOCAL_FIT_LIMITS.window_pitches * min(target.spacing_mm)
    coordinates = coordinates_at_points(maps, decoded.modulation, target, detection, half_mm)
    kept = np.isfinite(coordinates).all(axis=1)
    if kept.sum() < TARGET_LIMITS.min_points:
        raise CalibrationError(f"{name}: only {kept.sum()} points of the board are illuminated well enough")
    return Observation(name, detection.ids[kept], detection.pixels[kept], coordinates[kept], repaired)


def _detect_board_part(name: str, image: NDArray[Any], target: Target) -> Detection:
    """Find part of a board that was not found whole, or raise `CalibrationError` with the reason."""
    missing = f"{name}: the board was not found in the image"
    if cause := explain_board_mismatch(image, target):
        raise CalibrationError(f"{missing}, {cause}")
    try:
        detection = detect_part(target.layout, image)
    except UnclearPart as error:
        raise CalibrationError(f"{missing}: {error}") from error
    if detection is None:
        raise CalibrationError(missing)
    return detection


def _find_edge_pixels(modulation: Map, max_gradient: float) -> NDArray[np.bool_]:
    """Tell which pixels lie on an edge: blur shifts the phase by its square times the relative gradient."""
    smooth = cv2.GaussianBlur(np.nan_to_num(modulation), (0, 0), 1.0)
    slope = np.hypot(cv2.Sobel(smooth, -1, 1, 0, scale=0.125), cv2.Sobel(smooth, -1, 0, 1, scale=0.125))
    return np.asarray(slope > max_gradient * smooth)


def _with_corrected_orders(
    name: str,
    maps: Floats,
    target: Target,
    detection: Detection,
    periods: Floats,
    limits: CharacterisationLimits,
) -> tuple[Floats, float]:
    """Correct the fringe orders on the board by the whole periods that bring every pixel onto its plane."""
    # The corrected maps are returned, and the share of the board's pixels that had to be corrected. A plane
    # maps camera to projector pixels by a homography, up to distortion, which is far less than half a period.
    # Ambiguous pixels become NaN; so does everything off the board. Raises `CalibrationError` when too few of
    # the pixels agree on a plane.
    corrected = np.full_like(maps, np.nan)
    lit = np.isfinite(maps[..., 0]) & np.isfinite(maps[..., 1])
    v, u = np.nonzero(lit & _board_area(maps.shape[:2], target, detection))
    if len(u) < LOCAL_FIT_LIMITS.min_pixels * TARGET_LIMITS.min_points:
        raise CalibrationError(f"{name}: too little of the board is illuminated by the projector")
    pixels, coordinates = np.stack([u, v], axis=-1).astype(np.float64), maps[v, u] / periods
    step = max(len(u) // 4000, 1)
    plane, inliers = cv2.findHomography(pixels[::step], coordinates[::step], cv2.RANSAC, 0.25)
    if plane is None or inliers.mean() < limits.min_plane_share:
        raise CalibrationError(f"{name}: the projector's coordinates on the board do not fit a plane")
    expected = cv2.perspectiveTransform(pixels[None], plane)[0]
    orders = np.rint(coordinates - expected)
    residuals = np.abs(coordinates - expected - orders)
    clear = (residuals[:, 0] < 0.4) & (residuals[:, 1] < 0.4)
    corrected[v[clear], u[clear]] = ((coordinates - orders) * periods)[clear]
    return corrected, float(np.any(orders[clear], axis=1).mean())


def _board_area(shape: tuple[int, ...], target: Target, detection: Detection) -> NDArray[np.bool_]:
    """Tell which pixels are within the windows of the points found."""
    area = np.zeros(shape, np.uint8)
    half = LOCAL_FIT_LIMITS.window_pitches * np.array(target.spacing_mm)
    low, high = (f(target.points()[detection.ids, :2], axis=0) for f in (np.min, np.max))
    (left, top), (right, bottom) = low - half, high + half
    corners = np.array([[[left, top], [right, top], [right, bottom], [left, bottom]]])
    outline = cv2.perspectiveTransform(corners, homography(target, detection))
    cv2.fillConvexPoly(area, np.asarray(np.rint(outline[0]), np.int32), (1,))
    return np.asarray(area, np.bool_)


WINDOW_PX = (21, 21)
"""Around each point, within which its motion is sought. Chosen: it holds a corner and its neighbourhood."""


def board_shift_px(first: NDArray[np.uint8], last: NDArray[np.uint8], points_px: Floats) -> float | None:
    """Measure how far a board's points moved between two evenly lit images; None where it cannot be seen."""
    # The median over all points: fringes that remain in an image move single points by hundredths of a px.
    start = points_px.astype(np.float32).reshape(-1, 1, 2)
    end, state, _ = cv2.calcOpticalFlowPyrLK(first, last, start, start.copy(), winSize=WINDOW_PX)
    shifts = (end - start)[state.ravel() > 0].reshape(-1, 2)
    return float(np.hypot(*np.median(shifts, axis=0))) if len(shifts) else None


def explain_board_mismatch(image: NDArray[Any], target: Target) -> str | None:
    """Find the mistake in a board's description by detecting it under another."""
    # image (height, width)
    for description, other in similar_descriptions(target):
        if other.detect(image) is not None:
            return f"but it is there {description}"
    inverted = target.model_copy(update={"foreground": target.background, "background": target.foreground})
    if inverted.detect(image) is not None:
        return (
            "but it is there with foreground and background exchanged: 'foreground' should be "
            f"{inverted.foreground:g} and 'background' {inverted.background:g}"
        )
    if misprint := target.layout.misprint(stretch_to_8_bits(np.asarray(image, np.float64))):
        return f"but it is there {misprint}"
    if target.layout.shows_mirroring and target.detect(np.ascontiguousarray(image[:, ::-1])) is not None:
        return "but its mirror image is; the print, or the camera's picture, is mirrored"
    return None


def similar_descriptions(target: Target) -> Iterator[tuple[str, Target]]:
    """List descriptions that are easily confused with this one."""
    (columns, rows), (x, y) = target.counts, target.spacing_mm

    def other(**changes: Any) -> Target:
        # A board large enough for any of them; its size is not used here.
        return target.model_copy(update={"size_mm": (1e4, 1e4), **changes})

    for description, changes in target.layout.confusable():
        yield description, other(**changes)
    if columns != rows:
        yield (
            f"with rows and columns exchanged: 'counts' should be [{rows}, {columns}]",
            other(counts=(rows, columns)),
        )
    if x != y:
        yield (
            f"with the pitches exchanged: 'spacing_mm' should be [{y:g}, {x:g}]",
            other(spacing_mm=(y, x)),
        )
        yield (
            f"with rows and columns exchanged: 'counts' should be [{rows}, {columns}] "
            f"and 'spacing_mm' [{y:g}, {x:g}]",
            other(counts=(rows, columns), spacing_mm=(y, x)),
        )


def coordinates_at_points(
    maps: Floats, modulation: Map, target: Target, detection: Detection, half_mm: float
) -> Floats:
    """Fit the projector coordinates of the points found, within a square about each."""
    # maps (height, width, 2) px; modulation (height, width); half_mm half the square's side; returns (K, 2)
    jacobians = target.layout.jacobians(detection)
    coordinates = np.full((len(jacobians), 2), np.nan)
    inverses = np.ascontiguousarray(np.linalg.inv(jacobians))
    reaches = half_mm * np.abs(jacobians).sum(axis=2).max(axis=1)
    _fit_all(
        maps, modulation, np.ascontiguousarray(detection.pixels), inverses, half_mm, reaches, coordinates
    )
    return coordinates


@kernel(parallel=True, error_model="numpy")
def _fit_all(
    maps: Floats,
    modulation: Map,
    pixels: Floats,
    inverses: Floats,
    half: float,
    reaches: Floats,
    coordinates: Floats,
) -> None:
    for i in prange(len(pixels)):  # the parallel loop calls what is compiled apart, in a fraction of the time
        _fit_point(maps, modulation, pixels[i], inverses[i], half, reaches[i], coordinates[i])


@kernel_part(error_model="numpy")
def _fit_point(
    maps: Floats,
    modulation: Map,
    pixel: Floats,
    inverse: Floats,
    half: float,
    reach: float,
    coordinates: Floats,
) -> None:
    rows, columns = window_pixels(modulation, pixel, inverse, half)
    basis, observed = np.empty((len(rows), 6)), np.empty((len(rows), 2))
    weight, n = np.empty(len(rows)), 0
    for j in range(len(rows)):
        values, sure = maps[rows[j], columns[j]], float(modulation[rows[j], columns[j]])
        if not (np.isfinite(values[0]) and np.isfinite(values[1]) and sure > 0.0):
            continue
        x, y = (columns[j] - pixel[0]) / reach, (rows[j] - pixel[1]) / reach
        row = basis[n]
        row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, x * x, x * y, y * y
        observed[n, 0], observed[n, 1], weight[n], n = values[0], values[1], sure, n + 1
    _value_at_centre(basis[:n], observed[:n], weight[:n], coordinates)


@kernel_part(error_model="numpy")
def _value_at_centre(basis: Floats, observed: Floats, weight: Floats, centre_value: Floats) -> None:
    """Fit a quadric without outliers; its value at the origin is written, or NaN."""
    used, coefficients = np.ones(len(basis), np.bool_), np.empty((2, 6))
    for _ in range(LIMITS.max_rounds):
        middle = np.hypot(basis[used, 1].mean(), basis[used, 2].mean()) if used.any() else np.inf
        if (
            used.sum() < LIMITS.min_pixels
            or middle > LIMITS.max_off_centre
            or not _fit_weighted_quadric(basis, observed, weight, used, coefficients)
        ):
            centre_value[:] = np.nan
            return
        agree = np.ones(len(basis), np.bool_)
        for k in range(2):
            misfit = np.abs(observed[:, k] - basis @ coefficients[k]) * weight
            agree &= misfit <= LIMITS.max_median_ratio * np.median(misfit[used]) + 1e-9
        if np.array_equal(agree, used):
            break
        used = agree
    centre_value[0], centre_value[1] = coefficients[0, 0], coefficients[1, 0]


@kernel_part(error_model="numpy")
def _fit_weighted_quadric(
    basis: Floats, observed: Floats, weight: Floats, used: NDArray[np.bool_], coefficients: Floats
) -> bool:
    """Weighted least squares over the pixels used, into `coefficients` (2, 6); whether they determine it."""
    normal, right = np.zeros((6, 6)), np.zeros((2, 6))
    for j in range(len(basis)):
        if used[j]:
            sure = weight[j] * weight[j]
            for p in range(6):
                for q in range(p + 1):
                    normal[p, q] += sure * basis[j, p] * basis[j, q]
                right[0, p] += sure * basis[j, p] * observed[j, 0]
                right[1, p] += sure * basis[j, p] * observed[j, 1]
    first = solve_positive(normal, right[0], 0.0, coefficients[0])
    return first and solve_positive(normal, right[1], 0.0, coefficients[1])
