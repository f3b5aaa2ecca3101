"""Reference marks: what has changed between the time of the characterisation and a scan that shows them.

Where the marks are does not count, only what camera and projector see of them: as at the time of the
characterisation, but for one rigid motion of all marks, which is as free as the pose of a board. So marks are
judged as a board whose points are where the calibration triangulated them. The calibration's own errors are
the same both times and cancel; the noise of both times counts.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fpplab.calibration.board import FittedErrors, LocatedMarks
from fpplab.calibration.displacements import covariance_root
from fpplab.calibration.model import PARAMETERS, Calibration
from fpplab.characterisation.correction import estimate_change, with_parameters
from fpplab.characterisation.judging import CalibrationAsFitted, Judgement, judge_as_fitted
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.observation import Observation, coordinates_at_points
from fpplab.characterisation.parameters import parameter_names
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.robust import robust_spread
from fpplab.phase import Decoded
from fpplab.targets import Target
from fpplab.targets.limits import TARGET_LIMITS

NEIGHBOURS = 3
"""Points that a point is compared with for its noise: as many as a mark has beside it."""

ROBUST_ROUNDS = 20
"""Rounds of a fit that points which disagree do not pull. Chosen: weights change little after ten."""

NOISE_WEIGHT = 12
"""Degrees of freedom by which the errors of the characterisation's board count as those of the marks. Chosen:
as many as four marks have; fewer say little of their noise."""


@dataclass(frozen=True, eq=False)
class MarksComparison:
    """What reference marks say about the rig at a scan."""

    as_characterised: Judgement  # whether the marks look as they did
    change: Floats  # (P,) what has changed, as now expected, in the order of `PARAMETERS`
    covariance: Floats  # (P, P) of the change
    probabilities: dict[str, float]  # that each part of the rig has changed
    after: Judgement  # whether the marks look as the calibration with the change has them
    corrected: Calibration  # the calibration with the change

    @property
    def contradicted(self) -> bool:
        """Whether the marks look differently than chance explains."""
        return self.as_characterised.contradicted

    @property
    def explained(self) -> bool:
        """Whether the change explains how the marks look."""
        return not self.after.contradicted


def observe_marks(name: str, image: NDArray[Any], decoded: Decoded, target: Target) -> Observation | None:
    """Find reference marks in a scan; None where none are found. An axis that is not coded is NaN."""
    # image (height, width)
    detection = target.detect(image)
    if detection is None:
        return None
    maps = np.stack([decoded.u, decoded.v], axis=-1).astype(np.float64)
    coded = np.isfinite(maps).any(axis=(0, 1))
    maps[..., ~coded] = 0.0
    half_mm = target.layout.point_model().half_mm  # beyond it may be another surface
    coordinates = coordinates_at_points(maps, decoded.modulation, target, detection, half_mm)
    measured = np.isfinite(coordinates).all(axis=1)
    coordinates[:, ~coded] = np.nan
    return Observation(name, detection.ids[measured], detection.pixels[measured], coordinates[measured])


def locate_marks(name: str, image: NDArray[Any], decoded: Decoded, target: Target) -> LocatedMarks:
    """Record how camera and projector see reference marks, to be kept with the calibration."""
    observed = observe_marks(name, image, decoded, target)
    if observed is None or len(observed.ids) < TARGET_LIMITS.min_points:
        count = 0 if observed is None else len(observed.ids)
        raise CalibrationError(
            f"{name}: {count} points of reference marks found (at least {TARGET_LIMITS.min_points}); show "
            "them to camera and projector, and large enough: 4 px or more for a module of a marker"
        )
    if not np.isfinite(observed.projector_px).all():
        raise CalibrationError(f"{name}: locating reference marks needs fringes along x and y")
    return LocatedMarks(config.plain(target), observed.ids, observed.camera_px, observed.projector_px)


def compare_marks(calibration: Calibration, marks: LocatedMarks, observed: Observation) -> MarksComparison:
    """Compare reference marks with how they looked when the rig was characterised."""
    fitted = CalibrationAsFitted.of(calibration, "the calibration")
    known = _as_board(fitted, calibration, marks)
    now = _agreeing(known, _without_misfit(known, calibration, marks, observed))
    change = estimate_change(calibration, known, [now])
    known = replace(known, errors=_errors_of_marks(known.with_parameters(change.parameters), now))
    change = estimate_change(calibration, known, [now])
    at = known.with_parameters(change.parameters)
    places = [PARAMETERS.index(name) for name in parameter_names(known.level)]
    whole, covariance = np.zeros(len(PARAMETERS)), np.zeros((len(PARAMETERS), len(PARAMETERS)))
    whole[places] = change.parameters - known.parameters()
    covariance[np.ix_(places, places)] = change.covariance
    updated = change.covariance + fitted.factor @ fitted.factor.T + np.outer(at.longer, at.longer)
    return MarksComparison(
        judge_as_fitted(known, [now]),
        whole,
        covariance,
        change.probabilities,
        judge_as_fitted(replace(at, factor=covariance_root(change.covariance)), [now]),
        with_parameters(calibration, at, updated),
    )


def triangulate_marks(calibration: Calibration, marks: LocatedMarks) -> Floats:
    # returns (K, 3) mm
    camera, projector, pose = calibration.camera, calibration.projector, calibration.T_projector_camera
    rays = [
        cv2.undistortPoints(pixels[:, None], device.matrix, device.distortion)[:, 0]
        for device, pixels in ((camera, marks.camera_px), (projector, marks.projector_px))
    ]
    first, second = np.eye(3, 4), np.column_stack([pose.rotation, pose.translation])
    points = cv2.triangulatePoints(first, second, rays[0].T, rays[1].T)
    return np.asarray((points[:3] / points[3]).T, np.float64)


def _as_board(
    known: CalibrationAsFitted, calibration: Calibration, marks: LocatedMarks
) -> CalibrationAsFitted:
    """Take the marks as the board that a calibration, which is exact here, is judged by."""
    points = np.full((marks.ids.max() + 1, 3), np.nan)
    points[marks.ids] = triangulate_marks(calibration, marks)
    both = {
        name: np.sqrt(2.0) * getattr(known.errors, name)
        for name in ("camera_px", "projector_px", "camera_shared_px", "projector_shared_px")
    }  # of then and now
    errors = known.errors.model_copy(update=both)
    n = len(known.parameters())
    return replace(
        known, devices=replace(known.devices, board=points), errors=errors, factor=np.zeros((n, n))
    )


def _without_misfit(
    known: CalibrationAsFitted, calibration: Calibration, marks: LocatedMarks, observed: Observation
) -> Observation:
    """Take off how far the points were seen from where they were triangulated, which recurs."""
    common, then, now = np.intersect1d(marks.ids, observed.ids, return_indices=True)
    if len(common) < TARGET_LIMITS.min_points:
        raise CalibrationError(
            f"{observed.name}: {len(common)} points of the reference marks are in view "
            f"(at least {TARGET_LIMITS.min_points})"
        )
    points, pose = known.devices.board[common], calibration.T_projector_camera
    camera = marks.camera_px[then] - calibration.camera.project(points)
    projector = marks.projector_px[then] - calibration.projector.project(points, pose)
    return Observation(
        observed.name, common, observed.camera_px[now] - camera, observed.projector_px[now] - projector
    )


def _agreeing(known: CalibrationAsFitted, now: Observation) -> Observation:
    """Leave out points that have not moved as the others have, as where something hides part of a circle.

    Any change of the rig moves the points in both devices as smooth functions of where they are.
    """
    problem, at = known.problem(now, known.pose(now))
    off = problem.weighted_residuals(0, at, np.inf)[0].reshape(2, -1, 2).transpose(1, 0, 2).reshape(-1, 4)
    places = known.devices.board[now.ids]
    x, y, z = ((places - places.mean(axis=0)) / np.ptp(places, axis=0).max()).T
    terms = np.stack([np.ones_like(x), x, y, z, x * x, x * y, y * y], axis=1)[:, : max(3, len(x) // 4)]
    weights = np.ones(len(x))
    for _ in range(ROBUST_ROUNDS):
        smooth, *_ = np.linalg.lstsq(terms * weights[:, None], off * weights[:, None], rcond=1e-6)
        rest = off - terms @ smooth
        sizes = np.abs(rest) / [robust_spread(column, 1.0) for column in rest.T]
        weights = np.sqrt(1.0 / np.maximum(sizes.max(axis=1), 1.0))
    kept = sizes.max(axis=1) < USUAL_LIMITS.max_residual_sigmas
    return Observation(now.name, now.ids[kept], now.camera_px[kept], now.projector_px[kept])


def _errors_of_marks(known: CalibrationAsFitted, now: Observation) -> FittedErrors:
    """Estimate the independent errors by how far points are off the mean of the points next to them."""
    problem, at = known.problem(now, known.pose(now))
    whitened = problem.weighted_residuals(0, at, np.inf)[0].reshape(2, -1, 2)
    _, nearest = cKDTree(now.camera_px).query(now.camera_px, NEIGHBOURS + 1)
    off = (whitened - whitened[:, nearest[:, 1:]].mean(axis=2)) / np.sqrt(1.0 + 1.0 / NEIGHBOURS)
    updated = {}
    for device, of_device in zip(("camera_px", "projector_px"), off, strict=True):
        coded = of_device[of_device != 0.0]  # the rows of a coordinate that was not coded are zero
        square = robust_spread(coded, 0.0) ** 2
        square = (len(coded) * square + NOISE_WEIGHT) / (len(coded) + NOISE_WEIGHT)
        updated[device] = np.sqrt(square) * getattr(known.errors, device)
    return known.errors.model_copy(update=updated)
