"""Circles of a board as ellipses in its image."""

from __future__ import annotations

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.targets.views import apply_homography


def eccentricity(matrix: Floats, circles: Floats, radius: float) -> Floats:
    """Compute the offset of the centres of ellipses from the images of the circles' centres."""
    # matrix (3, 3); circles (K, 2) mm; radius mm; returns (K, 2) px
    duals = np.stack([_dual_circle(circle, radius) for circle in circles])
    ellipses = matrix @ duals @ matrix.T
    return np.asarray(ellipses[:, :2, 2] / ellipses[:, 2:, 2] - apply_homography(matrix, circles))


def _dual_circle(centre: Floats, radius: float) -> Floats:
    pole = np.append(centre, 1.0)
    return np.asarray(np.outer(pole, pole) - radius**2 * np.diag([1.0, 1.0, 0.0]))
