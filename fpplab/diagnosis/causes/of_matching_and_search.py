"""Causes that matching a twin and searching for a plan report."""

from functools import partial

from fpplab.diagnosis.finding import FaultCause

SHOWN_BY = "the page of the matching or of the search"
_cause = partial(FaultCause, shown_by=SHOWN_BY)

ENDED_EARLY = _cause(
    key="ended_early",
    meaning="A fit or a search stopped before it had converged.",
    remedy="run it longer",
    measured="whether a fit or search ended by its limits",
    limit="converged",
    seen_in="match, optimise",
)
AT_BORDER = _cause(
    key="at_border",
    meaning="A parameter lies at the border of its range.",
    remedy="widen the range",
    measured="a parameter's distance from the end of its range, beyond which the rig could go",
    limit="none",
    seen_in="match, optimise",
)
NO_GAIN = _cause(
    key="no_gain",
    meaning="The result is not better than where it started from.",
    remedy="start from another point, or keep the original",
    measured="loss compared with that before; distance to the surface compared with the start's, with "
    "other seeds",
    limit="2 standard uncertainties",
    seen_in="match, optimise",
)
UNLIKE_IMAGES = _cause(
    key="unlike_images",
    meaning="The images of a matched twin differ from the bench's by more than noise.",
    remedy="give the board's true pattern and material in the twin's world, and cover what else the camera "
    "sees",
    measured="RMS difference of bench and twin over the board, without the noise",
    limit="3 % of full scale",
    seen_in="match",
)
POINTS_MISFIT = _cause(
    key="points_misfit",
    meaning="Points of the board fit in the twin's images as they do not in the bench's.",
    remedy="take the poses again with the board at rest, and check the board against its target file",
    measured="reprojection error of the twin compared with the bench's",
    limit="0.1 px",
    seen_in="match",
)
ARTEFACT_MISFIT = _cause(
    key="artefact_misfit",
    meaning="The twin measures an artefact better or worse than the bench does.",
    remedy="give the artefact's true shape and material in the twin's world, and measure the response with "
    "'fpplab gamma'",
    measured="distance of an artefact's points from its surface, in the twin compared with the bench",
    limit="30 %, and 2 µm",
    seen_in="match",
)
FLAT_OPTIMUM = _cause(
    key="flat_optimum",
    meaning="The optimum of a search cannot be distinguished from its neighbours.",
    remedy="measure with more --seeds, or take any of these plans",
    measured="distance to the surface of candidates a tenth of the ranges away, compared with the optimum's, "
    "seed by seed",
    limit="2 standard uncertainties",
    seen_in="optimise",
)
LIMITS_BROKEN = _cause(
    key="limits_broken",
    meaning="Measured again, the optimum of a search exceeds the study's limits.",
    remedy="search with more --seeds, or with limits that leave a margin",
    measured="limits of the study with other seeds",
    limit="none exceeded",
    seen_in="optimise",
)
FAILED_CANDIDATES = _cause(
    key="failed_candidates",
    meaning="Many candidates of a search could not be measured.",
    remedy="narrow the study's space to what the rig measures; the journal says why each failed",
    measured="share of candidates that could not be measured",
    limit="half",
    seen_in="optimise",
)
NOT_CONFIRMED = _cause(
    key="not_confirmed",
    meaning="Where it was confirmed, the plan found is not better than that of the start.",
    remedy="match the simulation to this rig with 'fpplab match' and search again, or search on the rig "
    "itself",
    measured="gain over the start on the rig of `--confirm`",
    limit="2 standard uncertainties",
    seen_in="optimise",
)
