"""Changes of a rig since its characterisation that the frames of a scan do not show, and what they cost.

A change moves points off their epipolar lines, which is seen, and along them, which is not in a scene of
unknown shape. Its size is a normal variable, conditioned on how near the points lie to their epipolar lines.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.changes import changed_rigs, parameter_vector
from fpplab.calibration.displacements import CoordinateNoise, calibration_jacobian, projection_derivatives
from fpplab.calibration.model import INTRINSICS, Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS


@dataclass(frozen=True)
class HiddenChange:
    """A change of the rig that a scan would not show."""

    meaning: str  # such as `the projector turned by 0.1° about its y axis`
    displacement_um: float  # RMS over the points, of as much of it as can have happened unseen


def sampled(values: NDArray[np.float32]) -> Floats:
    """Take some of a cloud's values, which suffice for means and medians of what varies slowly."""
    # values (points, ...)
    return values[:: max(1, len(values) // LIMITS.hidden_change_points)].astype(np.float64)


def hidden_changes(
    cloud: Cloud, calibration: Calibration, noise: CoordinateNoise, epipolar_limit_px: float
) -> tuple[HiddenChange, ...]:
    # `epipolar_limit_px` is the systematic distance from the epipolar lines at which a change is noticed.
    points = sampled(cloud.points)
    changed = changed_rigs(calibration)
    changes = np.stack(
        [parameter_vector(rig) - parameter_vector(calibration) for rig in changed.values()], axis=1
    )
    jacobian = calibration_jacobian(points, calibration, noise)
    displaced = jacobian @ changes  # (N, 3, kinds) mm
    unseen = np.ones(len(changed))  # standard deviations given the evidence, beside those without
    if np.all(np.isfinite(noise)):
        off = _distances_from_epipolar_lines(points, calibration, jacobian) @ changes
        unseen = 1.0 / np.sqrt(1.0 + np.square(off).mean(axis=0) / epipolar_limit_px**2)
    each_um = 1e3 * unseen * np.sqrt(np.square(displaced).sum(axis=1).mean(axis=0))
    hidden = [HiddenChange(name, float(um)) for name, um in zip(changed, each_um, strict=True)]
    return tuple(sorted(hidden, key=lambda change: -change.displacement_um))


def _distances_from_epipolar_lines(points: Floats, calibration: Calibration, jacobian: Floats) -> Floats:
    """Differentiate the distance of the coordinates from the epipolar line by the parameters, (N, n)."""
    pose, n = calibration.T_projector_camera, len(INTRINSICS)
    projected, by_projector = projection_derivatives(points, calibration.projector, pose)
    by_point = projected[..., 3:] @ pose.rotation
    off = by_point @ jacobian
    off[..., n : 2 * n] += by_projector
    off[..., 2 * n :] += projected
    along = np.einsum("nij,nj->ni", by_point, points)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(np.einsum("ni,nij->nj", across, off))
