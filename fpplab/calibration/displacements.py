"""How errors of a calibration displace the points that camera and projector measure.

A point X lies on the ray of its camera pixel m, where its image in the projector meets the coordinates c.
With the devices' projections m(X, θ) and p(X, θ), the parameters θ, the slope j = ∂p/∂X · X along the ray and
the coordinates' inverse variances W this is

    m(X, θ) = m,    jᵀ W (p(X, θ) - c) = 0,

and by the implicit function theorem `∂X/∂θ = -A⁻¹ B`, with A and B the derivatives of the three equations by
X and by θ. The change of j itself is proportional to the distance from the epipolar curve, and is neglected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import INTRINSICS, PARAMETERS, Calibration, Uncertainty
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole, RigidTransform

CoordinateNoise = tuple[float, float]
"""Standard deviations of the projector's u and v, relative to one another; infinite for an axis not coded."""

AnyPoints = NDArray[np.floating[Any]]


def calibration_jacobian(points: AnyPoints, calibration: Calibration, noise: CoordinateNoise) -> Floats:
    """Compute the derivatives of points by the calibration's parameters."""
    # Camera pixels and projector coordinates are held.
    # points (N, 3) mm; returns (N, 3, n)
    pose, n = calibration.T_projector_camera, len(INTRINSICS)
    observed, by_camera = projection_derivatives(points, calibration.camera, RigidTransform.identity())
    projected, by_projector = projection_derivatives(points, calibration.projector, pose)
    seen_by_point, projected_by_point = observed[..., 3:], projected[..., 3:] @ pose.rotation
    weights = np.einsum("nij,nj->ni", projected_by_point, points) / np.square(noise)
    depth_by_point = np.einsum("ni,nij->nj", weights, projected_by_point)
    slopes = np.zeros((len(points), 3, len(PARAMETERS)))
    slopes[:, :2, :n] = by_camera
    slopes[:, 2, n : 2 * n] = np.einsum("ni,nij->nj", weights, by_projector)
    slopes[:, 2, 2 * n :] = np.einsum("ni,nij->nj", weights, projected)
    return -_invert_3x3(seen_by_point[:, 0], seen_by_point[:, 1], depth_by_point) @ slopes


def displacements_by_mode(points: AnyPoints, calibration: Calibration, noise: CoordinateNoise) -> Floats:
    """Compute how the independent modes of calibration error displace points."""
    # Any error of the calibration is a sum of the modes, each times a number drawn from the standard normal
    # distribution.
    # points (N, 3) mm; returns (N, 3, n) mm
    return ErrorModes.of(calibration, noise).moved(points)


def projection_derivatives(points: AnyPoints, device: Pinhole, pose: RigidTransform) -> tuple[Floats, Floats]:
    """Differentiate the projected pixels by `POSE`, (N, 2, 6), and by `INTRINSICS`, (N, 2, n)."""
    local = np.ascontiguousarray(points, np.float64)
    turn, shift = pose.rotation_vector, pose.translation
    _, slopes = cv2.projectPoints(local, turn, shift, device.matrix, device.distortion)
    shaped = np.asarray(slopes, np.float64).reshape(len(points), 2, -1)
    return shaped[..., :6], shaped[..., 6:]


def _invert_3x3(first: Floats, second: Floats, third: Floats) -> Floats:
    """Invert matrices with these rows, (N, 3) each, to (N, 3, 3); in a fraction of LAPACK's time."""
    columns = np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=-1)
    return np.asarray(columns / np.einsum("ni,ni->n", third, columns[..., 2])[:, None, None])


@dataclass(frozen=True, eq=False)
class ErrorModes:
    """Independent modes of calibration error, each with the size of one standard deviation."""

    calibration: Calibration
    noise: CoordinateNoise
    changes: Floats  # (all, n) of `PARAMETERS` by each of n modes; the covariance is `changes changesᵀ`

    @classmethod
    def of(cls, calibration: Calibration, noise: CoordinateNoise) -> ErrorModes:
        uncertainty = calibration.uncertainty
        if uncertainty is None:
            raise CalibrationError(
                "the calibration has no covariance; characterise the rig with `fpplab characterise` to get it"
            )
        changes = np.zeros((len(PARAMETERS), len(uncertainty.names)))
        changes[[PARAMETERS.index(name) for name in uncertainty.names]] = error_modes(uncertainty)
        return cls(calibration, noise, changes)

    def moved(self, points: AnyPoints) -> Floats:
        """Return the displacement of points (N, 3) by each mode: (N, 3, n) in mm."""
        jacobian = calibration_jacobian(points, self.calibration, self.noise)
        # As one matrix: NumPy multiplies a stack of small ones several times as slowly.
        flat = jacobian.reshape(-1, len(self.changes)) @ self.changes
        return np.asarray(flat.reshape(len(points), 3, -1))


def error_modes(uncertainty: Uncertainty) -> Floats:
    """Compute independent modes of error, each with the size of one standard deviation."""
    # returns (n, n)
    scale, variances, directions = _of_correlations(uncertainty.covariance)
    return np.asarray(scale[:, None] * directions * np.sqrt(np.maximum(variances, 0.0)))


def covariance_root(covariance: Floats) -> Floats:
    """Compute a factor F of a covariance, F F' = covariance, also where some numbers are exact."""
    # covariance (n, n); returns (n, n)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def independent_modes(covariance: Floats) -> tuple[Floats, Floats]:
    """Compute independent modes, each of one standard deviation, and their inverse."""
    # covariance (n, n); returns modes (n, n), inverse (n, n)
    scale, variances, directions = _of_correlations(covariance)
    smallest = 1e-12 * variances[-1]  # chosen near rounding: no mode is known better
    sizes = np.sqrt(np.maximum(variances, smallest))
    return scale[:, None] * directions * sizes, (directions / sizes).T / scale


def _of_correlations(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Standard uncertainties (n,), and variances (n,), rising, and directions (n, n) of the correlations."""
    scale = np.sqrt(np.diag(covariance))
    variances, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale, variances, directions
