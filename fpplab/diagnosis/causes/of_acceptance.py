"""Causes that an acceptance test reports; `fpplab.diagnosis.acceptance` looks for them."""

from functools import partial

from fpplab.core.config import Positive
from fpplab.diagnosis.finding import FaultCause
from fpplab.diagnosis.limits import LimitsSection, ShareLimit

SHOWN_BY = "the page of the acceptance test"
USELESS_ERROR = 10.0
"""Error as a multiple of the permissible one, above which the system must not be used. Chosen."""
_cause = partial(FaultCause, seen_in="verify", shown_by=SHOWN_BY)
_error = partial(_cause, useless_from=USELESS_ERROR)


class AcceptanceTestLimits(LimitsSection):
    """How errors of an acceptance test are distinguished."""

    min_shared_variance: ShareLimit = 0.5
    """Share of the variance that neighbours have in common, from which an error is no noise. Chosen."""
    min_scale_sigmas: Positive = 3.0
    """Standard uncertainties by which the mean error of the lengths differs from zero if it is one of scale.
    Chosen: chance reaches it once in 370 tests."""
    useless_scale: Positive = 0.01
    """Relative error of all lengths that makes a system useless, whatever is permitted. Chosen."""


FEW_POSITIONS = _cause(
    key="few_positions",
    meaning="A standard was measured in fewer positions than an acceptance test needs.",
    remedy="measure the standard in more positions, spread over the measuring volume",
    measured="number of positions relative to that required by the standard file",
    limit="all of them",
)
NO_LIMITS = _cause(
    key="no_limits",
    meaning="No maximum permissible error is stated, so nothing is judged.",
    remedy="state the errors in the standard file, or with --mpe PF=…,SD=…",
    measured="whether any maximum permissible error is stated",
    limit="one",
)
FORM = _error(
    key="form",
    meaning="A measured sphere or plane is distorted: neighbouring pixels have the same error.",
    remedy="measure the response with 'fpplab gamma', take more steps, and characterise again with poses "
    "over the whole volume; coat shiny standards",
    measured="PF and F relative to their limits, with errors shared by neighbouring pixels",
    limit="the permissible error; half of the variance shared",
)
NOISE = _error(
    key="noise",
    meaning="A measured sphere or plane is noisy: neighbouring pixels have independent errors.",
    remedy="expose longer or open the aperture, take more steps or more stripes, and shade the scene",
    measured="PF and F relative to their limits, with independent errors of neighbouring pixels",
    limit="the permissible error; half of the variance shared",
)
SCALE = _error(
    key="scale",
    meaning="All lengths are wrong by the same factor.",
    remedy="measure the point spacing of the board and correct its target file, then characterise again",
    measured="mean relative error of the sphere spacings that their scatter does not explain",
    limit="the permissible SD; 1 %",
)
UNEVEN_LENGTHS = _error(
    key="uneven_lengths",
    meaning="Lengths are wrong by a factor that depends on their position.",
    remedy="characterise again with more poses that cover the whole volume, at constant temperature "
    "and lens settings",
    measured="mean relative error of the sphere spacings that their scatter explains",
    limit="the permissible SD",
)
SPHERE_SIZE = _error(
    key="sphere_size",
    meaning="Spheres are measured too large or too small although lengths are correct.",
    remedy="use matt, opaque spheres of known diameter, and check the linearity of the response with "
    "'fpplab check'",
    measured="PS after removing the error of scale",
    limit="the permissible PS",
)
