"""Circles of a board as ellipses in its image."""

from __future__ import annotations

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.targets.views import apply_homography


def eccentricity(matrix: Floats, circles: Floats, radius: float) -> Floats:
    """Compute the offset of the centres of ellipses from the images of the circles' centres.

    The centre of a conic is the pole of the line at infinity, so it is read off the dual conic of
    each circle, C* -> H C* H^T. The lens distorts the ellipse as well, which is neglected: a
    displacement d shifts the centre of a disc of radius r px by r^2/8 times the Laplacian of d, for
    d = k1 f x (x^2 + y^2) that is k1 x r^2/f: 0.001 px for k1 = 0.1, r = 15 px at x = 0.15, f = 3600 px.

    Only the camera sees ellipses. The projector's coordinates of a point are those of the decoded
    maps at the corrected centre.
    """
    # matrix (3, 3); circles (K, 2) mm; radius mm; returns (K, 2) px
    duals = np.stack([_dual_circle(circle, radius) for circle in circles])
    ellipses = matrix @ duals @ matrix.T
    return np.asarray(ellipses[:, :2, 2] / ellipses[:, 2:, 2] - apply_homography(matrix, circles))


def _dual_circle(centre: Floats, radius: float) -> Floats:
    pole = np.append(centre, 1.0)
    return np.asarray(np.outer(pole, pole) - radius**2 * np.diag([1.0, 1.0, 0.0]))
