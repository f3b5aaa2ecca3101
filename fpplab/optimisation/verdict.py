"""Whether to believe what a search has found: by its neighbours, its borders, its end, and other seeds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.diagnosis import Diagnosis, Finding, diagnosis_of
from fpplab.diagnosis.causes.of_matching_and_search import (
    AT_BORDER,
    ENDED_EARLY,
    FAILED_CANDIDATES,
    FLAT_OPTIMUM,
    LIMITS_BROKEN,
    NO_GAIN,
    NOT_CONFIRMED,
)
from fpplab.optimisation.candidate import MeasuredCandidate, Point, seed_means
from fpplab.optimisation.confirm import ConfirmedPlan
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.space import Parameter


@dataclass(frozen=True)
class SearchVerdictLimits:
    """Limits by which the result of a search is judged."""

    significance: float = 2.0
    """Standard uncertainties by which two figures must differ (chosen: 5 % by chance)"""
    min_neighbour_distance: float = 0.1  # of neighbours, as a share of the ranges (chosen)
    max_failed_share: float = 0.5  # share of candidates that may fail (chosen)
    min_steps: int = 3
    """Of a phase-shifted set (derived: it has three unknowns, so this bound cannot be widened)"""
    beyond_border: float = 0.05  # share of the range by which the rig is asked beyond a border (chosen)


LIMITS = SearchVerdictLimits()

DISTANCE = "surface_smcd_um"
RUINOUS = {NO_GAIN: 1.0 + 1e-9, NOT_CONFIRMED: 1.0 + 1e-9}
"""What is worse than the start beyond its uncertainty has an excess of more than 1 and is of no use."""


def diagnose_search(result: SearchResult, confirmed: Sequence[ConfirmedPlan] = ()) -> Diagnosis:
    # It is useless where the plan found is worse than the start's beyond the uncertainty, with seeds that the
    # search did not use or where it was confirmed.
    findings = [
        *_find_missing_gain(result),
        *_find_flat_neighbourhood(result),
        *_extendable_borders(result),
        *_end(result),
        *_find_exceeded_limits(result),
        *_find_failed_candidates(result),
        *_confirmed(result, confirmed),
    ]
    unknown = [] if confirmed else ["not_confirmed: no rig to --confirm the plan on was given"]
    if len(result.study.seeds) < 2:
        unknown.append("flat_optimum: one seed does not show the uncertainty; give more --seeds")
    good = f"{result.optimum.candidate.images} images, {result.optimum.figures.surface_smcd_um:.2f} µm"
    good += "; the optimum is within the space and better than its neighbours"
    return diagnosis_of(findings, good, unknown, RUINOUS)


def _seeks_distance(result: SearchResult) -> bool:
    return result.study.objectives[0] == DISTANCE


def _find_missing_gain(result: SearchResult) -> Iterator[Finding]:
    gain = result.gain
    if gain is None or gain.uncertainty_um is None:
        return
    worse = -gain.down_um / max(LIMITS.significance * gain.uncertainty_um, 1e-9)
    evidence = (
        f"with other seeds the optimum is {gain.down_um:.2f} ± {gain.uncertainty_um:.2g} µm nearer to the "
        "surface than the start"
    )
    if _seeks_distance(result):
        if worse > -1.0:
            yield Finding(NO_GAIN, evidence, max(worse, 1.0))
    elif result.optimum.candidate == result.start.candidate:
        yield Finding(NO_GAIN, "no plan is better than the start's", 1.0)


def _find_flat_neighbourhood(result: SearchResult) -> Iterator[Finding]:
    """Whether candidates a tenth of the ranges away are worse than the optimum beyond the uncertainty."""
    if not _seeks_distance(result) or len(result.study.seeds) < 2:
        return
    best, parameters = result.optimum, result.space.parameters
    away = {
        trial: distance
        for trial in result.trials
        if result.ranking.is_acceptable(trial)
        and (distance := _distance(parameters, trial.point, best.point)) >= LIMITS.min_neighbour_distance
    }
    nearest = sorted(away, key=lambda trial: away[trial])[: 2 * len(parameters)]
    indistinct = []
    for trial in nearest:
        by, sigma = _difference_by_seeds_um(trial, best)
        if by <= LIMITS.significance * sigma:
            indistinct.append((trial, by, sigma))
    if indistinct:
        trial, by, sigma = indistinct[0]
        evidence = (
            f"{len(indistinct)} of {len(nearest)} neighbours cannot be distinguished from it; "
            f"{_differing(parameters, trial.point, best.point)} is worse by {by:.2f} ± {sigma:.2g} µm"
        )
        yield Finding(FLAT_OPTIMUM, evidence, 1.0)


def _distance(parameters: Sequence[Parameter], point: Point, other: Point) -> float:
    differences = [p.fraction(a) - p.fraction(b) for p, a, b in zip(parameters, point, other, strict=True)]
    return float(np.linalg.norm(differences))


def _difference_by_seeds_um(candidate: MeasuredCandidate, best: MeasuredCandidate) -> tuple[float, float]:
    """By how much a candidate is worse, seed by seed, and the standard uncertainty of that, in µm."""
    best_by_seed, trial_by_seed = seed_means(best.scores), seed_means(candidate.scores)
    differences = np.array(
        [trial_by_seed[seed] - best_by_seed[seed] for seed in best_by_seed if seed in trial_by_seed]
    )
    if len(differences) < 2:
        return float(differences.mean()) if len(differences) else 0.0, float("inf")
    return float(differences.mean()), float(differences.std(ddof=1) / np.sqrt(len(differences)))


def _differing(parameters: Sequence[Parameter], point: Point, other: Point) -> str:
    changed = [f"{p.name} {a:g}" for p, a, b in zip(parameters, point, other, strict=True) if a != b]
    return ", ".join(changed)


def _extendable_borders(result: SearchResult) -> Iterator[Finding]:
    """Parameters whose optimum lies at a border beyond which the rig could go."""
    space = result.space
    for i, parameter in enumerate(space.parameters):
        value = result.optimum.point[i]
        for border, outwards in ((parameter.lower, -1.0), (parameter.upper, 1.0)):
            if value != border or parameter.name in ("axis", "alternative"):
                continue
            step = 1.0 if parameter.is_integer else LIMITS.beyond_border * (parameter.upper - parameter.lower)
            beyond = value + outwards * step
            if beyond <= 0 and parameter.name != "stage_mm" and parameter.name != "convergence_deg":
                continue
            if parameter.name == "sets" or (parameter.name.startswith("steps") and beyond < LIMITS.min_steps):
                continue
            point = (*result.optimum.point[:i], beyond, *result.optimum.point[i + 1 :])
            candidate = space.candidate(point)
            if candidate != result.optimum.candidate and space.refusal(candidate) is None:
                evidence = (
                    f"{parameter.name} is {value:g}, at the border of its range from {parameter.lower:g} to "
                    f"{parameter.upper:g}"
                )
                advice = f"widen 'space.{parameter.name}' of the study, and search again"
                yield Finding(AT_BORDER, evidence, 1.0, advice)


def _end(result: SearchResult) -> Iterator[Finding]:
    if result.ended_early:
        evidence = f"the search ended because {result.ended}"
        advice = "give the study a greater 'budget', and name another --out"
        yield Finding(ENDED_EARLY, evidence, 1.0, advice)


def _find_exceeded_limits(result: SearchResult) -> Iterator[Finding]:
    """Limits of the study that the optimum exceeds when it is measured with other seeds."""
    scores = result.rescored.get(result.optimum.candidate)
    if not scores:
        return
    start = result.rescored.get(result.start.candidate) or result.start.scores
    ranking = replace(result.ranking, start=replace(result.start, scores=start))
    broken = ranking.violations(replace(result.optimum, scores=scores))
    over = {name: by for name, by in broken.items() if by > 0}
    if over:
        exceeded = ", ".join(f"{name} by {by:.3g}" for name, by in over.items())
        yield Finding(LIMITS_BROKEN, f"measured with other seeds it exceeds {exceeded}", 1.0)


def _find_failed_candidates(result: SearchResult) -> Iterator[Finding]:
    failed = [trial for trial in result.trials if trial.failed]
    share = len(failed) / max(len(result.trials), 1)
    if share > LIMITS.max_failed_share:
        evidence = (
            f"{len(failed)} of {len(result.trials)} candidates could not be measured: {failed[-1].failed}"
        )
        yield Finding(FAILED_CANDIDATES, evidence, share / LIMITS.max_failed_share)


def _confirmed(result: SearchResult, confirmed: Sequence[ConfirmedPlan]) -> Iterator[Finding]:
    for confirmed_plan in confirmed:
        confirmation = confirmed_plan.confirmation
        worse = -confirmation.gain / max(LIMITS.significance * confirmation.uncertainty, 1e-9)
        gain = f"{100 * confirmation.gain:.1f} ± {100 * confirmation.uncertainty:.1f} %"
        evidence = (
            f"on {confirmed_plan.rig} {confirmed_plan.plan.name} is {gain} nearer to the surface than the "
            "start's plan"
        )
        if not _seeks_distance(result):
            continue  # its aim is fewer images, which is sure; the study's limits say what they may cost
        if worse > -1.0:
            yield Finding(NOT_CONFIRMED, evidence, max(worse, 1.0))
