"""Independent modes of the errors that the covariance of a calibration describes.

They are found by the correlations, because variances of px and of k3 are many powers of ten apart.
"""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import Uncertainty
from fpplab.core.conventions import Floats


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


def chi_square(uncertainty: Uncertainty, differences: Floats) -> float:
    """Compute χ² of differences of the parameters: n on average where the covariance holds."""
    # differences (n,)
    _, inverse = independent_modes(uncertainty.covariance)
    return float(np.sum((inverse @ differences) ** 2))


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
