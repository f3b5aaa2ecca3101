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
    measured="positions of a standard compared with those that its file asks for",
    limit="all of them",
)
NO_LIMITS = _cause(
    key="no_limits",
    meaning="No maximum permissible error is stated, so that nothing is judged.",
    remedy="state them in the standard's file, or with --mpe PF=…,SD=…",
    measured="whether any maximum permissible error is stated",
    limit="one",
)
FORM = _error(
    key="form",
    meaning="A measured sphere or plane is bent: neighbouring pixels share the error.",
    remedy="measure the response with 'fpplab gamma', take more steps, and characterise again with poses "
    "over the whole volume; coat shiny standards",
    measured="PF and F compared with what is permitted, where neighbouring pixels share the error",
    limit="the permissible error; half of the variance shared",
)
NOISE = _error(
    key="noise",
    meaning="A measured sphere or plane is rough: neighbouring pixels do not share the error.",
    remedy="expose longer or open the aperture, take more steps or more stripes, and shade the scene",
    measured="PF and F compared with what is permitted, where neighbouring pixels do not share the error",
    limit="the permissible error; half of the variance shared",
)
SCALE = _error(
    key="scale",
    meaning="All lengths are wrong by the same ratio.",
    remedy="measure the spacing of the characterisation's board and correct its target file, then "
    "characterise again",
    measured="mean relative error of a ball bar's spacings, which their scatter does not explain",
    limit="the permissible SD; 1 %",
)
UNEVEN_LENGTHS = _error(
    key="uneven_lengths",
    meaning="Lengths are wrong by a ratio that depends on where they are measured.",
    remedy="characterise again, with more poses that cover the whole volume, and keep temperature and "
    "lenses as they are",
    measured="mean relative error of a ball bar's spacings, where their scatter explains it",
    limit="the permissible SD",
)
SPHERE_SIZE = _error(
    key="sphere_size",
    meaning="Spheres are measured too large or too small although lengths are right.",
    remedy="use matt, opaque spheres of known diameter, and check for a bent response with 'fpplab check'",
    measured="PS that is left when the scale is taken out",
    limit="the permissible PS",
)
