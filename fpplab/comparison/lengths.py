"""Lengths of an artefact, measured in a cloud that is aligned to it, by robust fits of its features."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fpplab.artefacts import Corner, FeatureLength, FlatFace, SphereFace
from fpplab.calibration.displacements import CoordinateNoise, displacements_by_mode
from fpplab.calibration.model import Calibration
from fpplab.comparison.scale import LIMITS as SCALE
from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import cell_numbers, clustered_covariance, huber_weights, robust_spread


@dataclass(frozen=True)
class LengthLimits:
    """Limits of what is measured on the features of an artefact."""

    edge_mm: float = 1.0
    """Width left out inside the outline of a face, where pixels see two surfaces. Chosen: several pixels."""
    reach_mm: float = 1.0  # from the true feature up to a point on it (chosen as the distance of an outlier)
    min_points: int = 50  # number of points on a feature (chosen)
    cells_per_face: int = 6  # cells along a face, within which errors correlate (chosen)
    fit_rounds: int = 20  # iterations of a robust fit (chosen)
    min_cap_cosine: float = 0.5
    """Between a sphere's normal and the direction to the camera: 60 degrees (chosen)"""
    moved_points: int = 500  # points of a face by which effects of a calibration are found (chosen)


LIMITS = LengthLimits()


@dataclass(frozen=True)
class MeasuredLength:
    """A length of the true shape and of the cloud."""

    name: str  # as the artefact calls it
    true_mm: float  # its true value in mm
    measured_mm: float | None  # its value in the cloud in mm; None where too little of a feature was measured
    sigma_um: float | None  # standard uncertainty of `measured_mm` in µm
    sigma_calibration_um: float = 0.0  # what of it comes from the calibration's uncertainty

    @property
    def error_um(self) -> float | None:
        """Measured minus true value in µm, None where it was not measured."""
        return None if self.measured_mm is None else 1e3 * (self.measured_mm - self.true_mm)

    @property
    def significant(self) -> bool:
        """Whether they differ by more than `ScaleLimits.coverage` standard uncertainties."""
        return (
            self.error_um is not None
            and self.sigma_um is not None
            and abs(self.error_um) > SCALE.coverage * self.sigma_um
        )

    def texts(self) -> tuple[str, str, str, str]:
        if self.measured_mm is None or self.error_um is None or self.sigma_um is None:
            return f"{self.true_mm:.4f}", "–", "–", "–"
        return (
            f"{self.true_mm:.4f}",
            f"{self.measured_mm:.4f}",
            f"{self.error_um:+.1f}",
            f"{self.sigma_um:.1f}",
        )

    def summary(self) -> dict[str, object]:
        return {
            "name": self.name,
            "true_mm": self.true_mm,
            "measured_mm": self.measured_mm,
            "error_um": self.error_um,
            "sigma_um": self.sigma_um,
        }


Displacements = Callable[[Floats], Floats]
"""Displacements (N, 3, m) of points (N, 3) by independent errors of a calibration, each of one sigma."""


def no_displacements(points: Floats) -> Floats:
    # points (N, 3) mm; returns (N, 3, 0) mm
    return np.zeros((*points.shape, 0))


def displacements_by(
    calibration: Calibration | None, at: RigidTransform, noise: CoordinateNoise = (1.0, 1.0)
) -> Displacements:
    """Take those of a calibration in the frame of an artefact that stands at a pose in the camera's."""
    if calibration is None or calibration.uncertainty is None:
        return no_displacements
    to_artefact = at.inverse().rotation

    def displacements(points: Floats) -> Floats:
        return np.asarray(
            np.einsum("ij,njm->nim", to_artefact, displacements_by_mode(at.apply(points), calibration, noise))
        )

    return displacements


def measure_lengths(
    points: Floats,
    camera: Floats,
    lengths: tuple[FeatureLength, ...],
    displacements: Displacements = no_displacements,
) -> tuple[MeasuredLength, ...]:
    # points (N, 3) mm; camera (3,)
    return tuple(_measure_length(points, camera, length, displacements) for length in lengths)


def _measure_length(
    points: Floats, camera: Floats, length: FeatureLength, displacements: Displacements
) -> MeasuredLength:
    first, second = length.first, length.second
    if isinstance(first, FlatFace) and isinstance(second, FlatFace):
        estimate = _distance_of_planes(points, first, second, displacements)
    elif isinstance(first, SphereFace) and isinstance(second, SphereFace):
        ends = [_fit_centre(points, camera, sphere, displacements) for sphere in (first, second)]
        estimate = _distance_of_places(ends)
    elif isinstance(first, Corner) and isinstance(second, Corner):
        estimate = _distance_of_corners(points, first, second, displacements)
    else:
        raise TypeError(f"{length.name}: its two features are of different kinds")
    if estimate is None:
        return MeasuredLength(length.name, length.true_mm, None, None)
    value, slopes, covariance, changes = estimate
    by_calibration = float(np.linalg.norm(slopes @ changes))
    sigma = float(np.hypot(np.sqrt(slopes @ covariance @ slopes), by_calibration))
    return MeasuredLength(length.name, length.true_mm, value, 1e3 * sigma, 1e3 * by_calibration)


Estimate = tuple[Floats, Floats, Floats]
"""Parameters (n,) in mm, their covariance (n, n), and changes (n, m) by the errors of the calibration."""

Distance = tuple[float, Floats, Floats, Floats]
"""In mm, with its derivatives (n,) by parameters, and the covariance and changes of these."""


def _distance_of_planes(
    points: Floats, first: FlatFace, second: FlatFace, displacements: Displacements
) -> Distance | None:
    on = [points[_on_face(points, face)] for face in (first, second)]
    if min(map(len, on)) < LIMITS.min_points:
        return None
    along = [(q - first.origin) @ first.axes.T for q in on]
    rows = np.concatenate(
        [
            np.column_stack([q[:, :2], np.tile(which, (len(q), 1))])
            for q, which in zip(along, np.eye(2), strict=True)
        ]
    )
    cells = [_cells(q) for q in along]
    cell = np.concatenate([cells[0], cells[0].max() + 1 + cells[1]])
    fit = _robust_fit(rows, np.concatenate([q[:, 2] for q in along]), cell)
    if fit is None:
        return None
    (a, b, low, high), covariance = fit
    stretch = np.sqrt(1.0 + a * a + b * b)
    changes = _changes(rows, first.axes[2:], np.concatenate(on), displacements)
    return abs(high - low) / stretch, np.array([0.0, 0.0, -1.0, 1.0]) / stretch, covariance, changes


def _distance_of_corners(
    points: Floats, first: Corner, second: Corner, displacements: Displacements
) -> Distance | None:
    faces = list(dict.fromkeys([*first.faces, *second.faces]))
    fits = [_fit_plane(points, face, displacements) for face in faces]
    if any(fit is None for fit in fits):
        return None
    planes = [fit for fit in fits if fit is not None]
    values, covariance = np.concatenate([plane[0] for plane in planes]), block_diag(*(p[1] for p in planes))

    def distance(parameters: Floats) -> float:
        ends = [
            _corner([(face, parameters[3 * faces.index(face) :][:3]) for face in corner.faces])
            for corner in (first, second)
        ]
        return float(np.linalg.norm(ends[1] - ends[0]))

    step = 1e-6
    slopes = [
        (distance(values + step * e) - distance(values - step * e)) / (2 * step) for e in np.eye(len(values))
    ]
    return distance(values), np.array(slopes), covariance, np.concatenate([plane[2] for plane in planes])


def _corner(planes: list[tuple[FlatFace, Floats]]) -> Floats:
    normals = np.stack(
        [
            face.axes[2] - parameters[0] * face.axes[0] - parameters[1] * face.axes[1]
            for face, parameters in planes
        ]
    )
    offsets = [
        normal @ face.origin + parameters[2]
        for normal, (face, parameters) in zip(normals, planes, strict=True)
    ]
    return np.asarray(np.linalg.solve(normals, offsets))


def _fit_plane(points: Floats, face: FlatFace, displacements: Displacements) -> Estimate | None:
    on = points[_on_face(points, face)]
    along = (on - face.origin) @ face.axes.T
    if len(along) < LIMITS.min_points:
        return None
    rows = np.column_stack([along[:, :2], np.ones(len(along))])
    fit = _robust_fit(rows, along[:, 2], _cells(along))
    return None if fit is None else (*fit, _changes(rows, face.axes[2:], on, displacements))


def _fit_centre(
    points: Floats, camera: Floats, sphere: SphereFace, displacements: Displacements
) -> Estimate | None:
    away = points - sphere.centre
    reach = np.linalg.norm(away, axis=1)
    view = (camera - sphere.centre) / np.linalg.norm(camera - sphere.centre)
    cap = (np.abs(reach - sphere.radius) <= LIMITS.reach_mm) & (away @ view >= LIMITS.min_cap_cosine * reach)
    away = away[cap]
    if len(away) < LIMITS.min_points:
        return None
    cell = _cells(away)
    moved, covariance = np.zeros(4), np.zeros((4, 4))
    for _ in range(LIMITS.fit_rounds):
        local = away - moved[:3]
        length = np.linalg.norm(local, axis=1)
        rows = np.column_stack([local / length[:, None], np.ones(len(local))])
        fit = _robust_fit(rows, length - sphere.radius - moved[3], cell)
        if fit is None:
            return None
        step, covariance = fit
        moved = moved + step
        if np.abs(step).max() < 1e-9:
            break
    changes = _changes(rows, rows[:, :3], sphere.centre + away, displacements)
    return sphere.centre + moved[:3], covariance[:3, :3], changes[:3]


def _distance_of_places(ends: list[Estimate | None]) -> Distance | None:
    first, second = ends
    if first is None or second is None:
        return None
    between = second[0] - first[0]
    distance = float(np.linalg.norm(between))
    return distance, between / distance, first[1] + second[1], second[2] - first[2]


def _changes(rows: Floats, directions: Floats, points: Floats, displacements: Displacements) -> Floats:
    """Fit the displacements of points, along directions (N or 1, 3), as `_robust_fit` fits their values."""
    few = slice(None, None, max(1, len(points) // LIMITS.moved_points))
    moved = np.einsum(
        "ni,nim->nm", np.broadcast_to(directions, points.shape)[few], displacements(points[few])
    )
    return np.asarray(np.linalg.lstsq(rows[few], moved, rcond=None)[0])


def _on_face(points: Floats, face: FlatFace) -> Mask:
    """Find the points (N,) that lie on a face, at least `LIMITS.edge_mm` inside its outlines."""
    near = np.flatnonzero(np.abs((points - face.origin) @ face.axes[2]) <= LIMITS.reach_mm)
    on = np.zeros(len(points), np.bool_)
    for outline in face.outlines:
        edges = np.roll(outline, -1, axis=0) - outline
        inwards = np.cross(face.axes[2], edges) / np.linalg.norm(edges, axis=1)[:, None]
        inside = points[near] @ inwards.T - np.einsum("ij,ij->i", outline, inwards)
        on[near] |= inside.min(axis=1) >= LIMITS.edge_mm
    return on


def _cells(points: Floats) -> NDArray[np.int64]:
    """Number the cells of a face, across its first two axes, that points (N, 3) of it lie in, (N,)."""
    side = max(float(np.ptp(points, axis=0).max()) / LIMITS.cells_per_face, 1e-6)
    return cell_numbers(points[:, :2], side)


def _robust_fit(rows: Floats, values: Floats, cell: NDArray[np.int64]) -> tuple[Floats, Floats] | None:
    """Fit `rows @ x = values` with Huber's weights; None if the cells are too few for a covariance."""
    if cell.max() + 1 <= rows.shape[1] + 1:
        return None
    weight = np.ones(len(values))
    for _ in range(LIMITS.fit_rounds):
        solution = np.linalg.lstsq(rows * np.sqrt(weight)[:, None], values * np.sqrt(weight), rcond=None)[0]
        residuals = values - rows @ solution
        weight = huber_weights(residuals, robust_spread(residuals))
    return solution, clustered_covariance(rows, weight * residuals, weight == 1.0, cell)
