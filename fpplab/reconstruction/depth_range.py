"""Which projector coordinates a camera pixel may have, from the calibration and a range of depths."""

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis, Floats
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import KnownCoordinate
from fpplab.phase.bounds import DecodingBounds, PossibleCoordinates, PredictedCoordinate
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS
from fpplab.reconstruction.triangulation import camera_slopes, predict_coordinate

KnownPixels = tuple[tuple[int, int, float], ...]
"""Column and row of pixels, and what is known there: a distance in mm or a coordinate in px."""


def decoding_bounds(plan: Plan, calibration: Calibration, depth: DepthRange | None) -> DecodingBounds:
    bounds: dict[Axis, PossibleCoordinates | PredictedCoordinate] = {}
    if depth is not None:
        bounds |= depth_bounds(plan, calibration, depth)
    if (axis := plan.guided_axis) is not None:
        bounds[axis] = PredictedCoordinate(lambda known: predict_coordinate(known, axis, calibration))
    return bounds


def coordinates_of_points(
    known_mm: KnownPixels, axis: Axis, calibration: Calibration
) -> tuple[KnownCoordinate, ...]:
    """Give the projector coordinates of points whose distance along the camera's axis is known."""
    slopes, points = camera_slopes(calibration.camera), []
    height, width = slopes.shape[1:]
    for column, row, depth_mm in known_mm:
        if not (0 <= column < width and 0 <= row < height and depth_mm > 0):
            raise ConfigError(
                f"--known: {column},{row},{depth_mm:g} is no pixel of {width} x {height} and a distance in mm"
            )
        ray = np.array([*slopes[:, row, column], 1.0])
        projected = calibration.projector.project(calibration.T_projector_camera.apply(depth_mm * ray))
        points.append(KnownCoordinate((column, row), float(projected[AXES.index(axis)])))
    return tuple(points)


def depth_bounds(plan: Plan, calibration: Calibration, depth: DepthRange) -> dict[Axis, PossibleCoordinates]:
    """Compute the possible projector coordinates of every camera pixel within a range of depths."""
    width, height = calibration.camera.size
    slopes = camera_slopes(calibration.camera)
    columns, rows = _nodes(width), _nodes(height)
    if not np.isfinite(slopes[:, rows[:, None], columns]).all():
        columns, rows = np.arange(width), np.arange(height)
    pixels = _ray_images_between_depths(slopes[:, rows[:, None], columns], calibration, depth)
    across, down = _interpolation(columns, width), _interpolation(rows, height)
    bounds: dict[Axis, PossibleCoordinates] = {}
    for axis in plan.unwrapped_axes:
        along = pixels[..., AXES.index(axis)]
        last = calibration.projector.size[AXES.index(axis)] - 0.5
        lower, upper = (
            np.clip(down @ end @ across.T, -0.5, last)
            for end in (
                along.min(axis=0) - LIMITS.interval_margin_px,
                along.max(axis=0) + LIMITS.interval_margin_px,
            )
        )
        bounds[axis] = PossibleCoordinates(lower.astype(np.float32), upper.astype(np.float32))
    return bounds


def _nodes(pixels: int) -> NDArray[np.intp]:
    """Every sixteenth pixel, the first and the last among them."""
    return np.unique(np.linspace(0, pixels - 1, pixels // LIMITS.segment_grid_px + 2).astype(np.intp))


def _interpolation(nodes: NDArray[np.intp], pixels: int) -> Floats:
    at = np.arange(pixels)
    return np.stack([np.interp(at, nodes, weights) for weights in np.eye(len(nodes))], axis=1)


def _ray_images_between_depths(slopes: Floats, calibration: Calibration, depth: DepthRange) -> Floats:
    """Images in the projector of each ray between two depths, (depths, rows, columns, 2) in px."""
    rays = np.stack([*slopes, np.ones_like(slopes[0])], axis=-1)
    depths = 1.0 / np.linspace(1.0 / depth.mm[0], 1.0 / depth.mm[1], LIMITS.segment_points)
    points = calibration.T_projector_camera.apply(rays * depths[:, None, None, None])
    if not (points[..., 2] > 0).all():
        raise ConfigError(
            f"{depth.source}: {depth.mm[0]:g} to {depth.mm[1]:g} mm has points behind the projector; "
            "give the range of distances from the camera in which the object lies"
        )
    # Beyond its reach the lens model folds back; such points lie outside of the projector's image anyway.
    radius = np.hypot(points[..., 0], points[..., 1]) / points[..., 2]
    points[..., :2] *= np.minimum(1.0, calibration.projector.reach / np.maximum(radius, 1e-12))[..., None]
    return calibration.projector.project(points)
