"""How far calibrations are from the truth, in their own stated uncertainties."""

import numpy as np

from fpplab.calibration.changes import parameter_vector
from fpplab.calibration.displacements import independent_modes
from fpplab.calibration.model import PARAMETERS, Calibration


def mean_chi_square(calibration: Calibration, truth: Calibration) -> float:
    """Average the squared errors of the covariance's independent modes: 1 on average where it holds."""
    uncertainty = calibration.uncertainty
    assert uncertainty is not None
    places = [PARAMETERS.index(name) for name in uncertainty.names]
    errors = (parameter_vector(truth) - parameter_vector(calibration))[places]
    _, inverse = independent_modes(uncertainty.covariance)
    return float(np.mean((inverse @ errors) ** 2))
