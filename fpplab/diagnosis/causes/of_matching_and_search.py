"""Causes that matching a twin and searching for a plan report."""

from functools import partial

from fpplab.diagnosis.finding import FaultCause

SHOWN_BY = "the page of the matching or of the search"
_cause = partial(FaultCause, shown_by=SHOWN_BY)

ENDED_EARLY = _cause(
    key="ended_early",
    meaning="A fit or a search stopped before it had converged.",
    remedy="run it longer",
    measured="whether a fit or search stopped at its limits",
    limit="converged",
    seen_in="match, optimise",
)
AT_BORDER = _cause(
    key="at_border",
    meaning="A parameter is at the limit of its range.",
    remedy="widen the range",
    measured="distance of a parameter from the limit of its range, if the rig allows more",
    limit="none",
    seen_in="match, optimise",
)
NO_GAIN = _cause(
    key="no_gain",
    meaning="The result is no better than the initial state.",
    remedy="start from other values, or keep the original",
    measured="loss relative to the initial loss; distance to the surface relative to the initial "
    "plan's, with other seeds",
    limit="2 standard uncertainties",
    seen_in="match, optimise",
)
UNLIKE_IMAGES = _cause(
    key="unlike_images",
    meaning="The images of the matched twin differ from those of the bench by more than noise.",
    remedy="state the true pattern and material of the board in the twin's world, and cover "
    "everything else in view",
    measured="RMS difference between bench and twin over the board, without noise",
    limit="3 % of full scale",
    seen_in="match",
)
POINTS_MISFIT = _cause(
    key="points_misfit",
    meaning="The board points fit differently in the images of the twin and of the bench.",
    remedy="record the poses again with the board at rest, and compare the board with its target file",
    measured="reprojection error of the twin relative to the bench",
    limit="0.1 px",
    seen_in="match",
)
ARTEFACT_MISFIT = _cause(
    key="artefact_misfit",
    meaning="The twin measures an artefact better or worse than the bench.",
    remedy="state the true shape and material of the artefact in the twin's world, and measure the "
    "response with 'fpplab gamma'",
    measured="distance of the points from the artefact's surface, twin relative to bench",
    limit="30 %, and 2 µm",
    seen_in="match",
)
FLAT_OPTIMUM = _cause(
    key="flat_optimum",
    meaning="The optimum of the search cannot be distinguished from its neighbours.",
    remedy="repeat with more --seeds, or use any of these plans",
    measured="distance to the surface of candidates a tenth of the range away, relative to the "
    "optimum, seed by seed",
    limit="2 standard uncertainties",
    seen_in="optimise",
)
LIMITS_BROKEN = _cause(
    key="limits_broken",
    meaning="When measured again, the optimum exceeds the limits of the study.",
    remedy="search with more --seeds, or with stricter limits",
    measured="limits of the study, with other seeds",
    limit="none exceeded",
    seen_in="optimise",
)
FAILED_CANDIDATES = _cause(
    key="failed_candidates",
    meaning="Many candidates of a search could not be measured.",
    remedy="reduce the search space to what the rig can measure; the journal says why each candidate failed",
    measured="fraction of candidates that could not be measured",
    limit="half",
    seen_in="optimise",
)
NOT_CONFIRMED = _cause(
    key="not_confirmed",
    meaning="On the confirming rig the optimised plan is no better than the initial plan.",
    remedy="match the simulation to this rig with 'fpplab match' and search again, or search on the rig "
    "itself",
    measured="gain over the initial plan on the rig of `--confirm`",
    limit="2 standard uncertainties",
    seen_in="optimise",
)
