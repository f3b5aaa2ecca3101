"""Decide whether a plan describes its images, and which plan next to it does better.

A plan whose sets have wrong stripes, order, signs or origins decodes to positions on which the sets do not
agree. One figure alone does not decide: a right heterodyne plan with a bent response may disagree more than a
wrong one of few stripes. So the plans next to it are tried too, and a plan is called wrong only where another
one fits much better. Signs and axes that are wrong in all sets mirror or turn the result without any
disagreement; with both axes coded a mirrored one is impossible, with one axis it is unusual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fpplab.core.errors import ConfigError
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.plan.edits import Edit, Sets, finest_of, is_mirrored, neighbouring_edits, upright_edit
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.diagnosis.plan.sample import PhaseSample, gradient_directions
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import decode


class Disagreement(NamedTuple):
    """How much the sets disagree at the lit pixels, in units of what noise explains; infinite where lost."""

    lower: float
    """At the lower quantile of the limits."""
    median: float
    """At half of them."""


@dataclass(frozen=True)
class PlanCheck:
    """What the images say of their plan."""

    disagreement: float  # median over the lit pixels, in units of what noise explains
    better: Edit | None = None  # A plan that fits much better
    better_disagreement: float = np.nan  # its disagreement
    unusual: Edit | None = None  # another plan that fits as well, by which camera and projector stand upright
    mirrored: bool = False  # whether the plan has the scene mirrored, so that it cannot be right

    @property
    def fault(self) -> str | None:
        """What is wrong with the plan, and what to write; None where nothing is known to be."""
        if self.better is not None:
            return (
                f"the plan does not fit its images: {self.better.mistake} (the sets disagree by "
                f"{_shown(self.disagreement)} times their noise, and then by "
                f"{self.better_disagreement:.1f}); {self.better.remedy}"
            )
        if self.mirrored and self.unusual is not None:
            return (
                "the plan does not fit its images: it has the scene mirrored, and "
                f"{self.unusual.mistake}; {self.unusual.remedy}"
            )
        return None

    @property
    def note(self) -> str | None:
        """What is unusual, and right only where a device is turned; None where nothing is."""
        if self.fault is not None or self.unusual is None:
            return None
        return (
            f"{self.unusual.mistake}: this is right where camera or projector is turned or stands on its "
            f"head; otherwise {self.unusual.remedy}"
        )


def check_plan_fit(recording: Recording, limits: DiagnosisLimits = USUAL_LIMITS) -> PlanCheck | None:
    """Ask the images of a recording whether their plan describes them."""
    sets = tuple(s for s in recording.plan.fringes if isinstance(s, Sinusoid))
    if len(sets) < len(recording.plan.fringes):
        return None
    check_limits = limits.of(PlanCheckLimits)
    sample = PhaseSample.of(recording.frames, [s.images for s in sets], recording.full_scale, check_limits)
    if sample is None:
        return None
    sampled = replace(recording, frames=[np.ascontiguousarray(f[sample.rows]) for f in recording.frames])
    stated = disagreement(sampled, recording.plan, sample)
    if stated.median > check_limits.max_agreeing and (
        better := _find_better_plan(sampled, sets, sample, stated)
    ):
        return better
    return _orientation(sets, sample, stated.median)


def _find_better_plan(
    sampled: Recording, sets: Sets, sample: PhaseSample, stated: Disagreement
) -> PlanCheck | None:
    """Find the simplest of the plans that fit much better."""
    limits = sample.limits
    tried = [
        (edit, disagreement(sampled, edit.plan(sampled.plan), sample))
        for edit in neighbouring_edits(sets, sample)
    ]
    fitting = [
        (edit, misfit.median)
        for edit, misfit in tried
        if misfit.median <= min(limits.max_better_ratio * stated.median, limits.max_proposed)
        and misfit.lower <= limits.max_better_ratio * stated.lower
    ]
    if not fitting:
        return None
    lowest = min(d for _, d in fitting)
    good = [(edit, d) for edit, d in fitting if d <= limits.max_equal_ratio * max(lowest, 1.0)]
    # Reversed and late steps differ in the direction of the fringes alone.
    upright_candidates = [
        candidate
        for candidate in good
        if _orientation(candidate[0].sets, sample, candidate[1]).unusual is None
    ]
    return PlanCheck(stated.median, *(upright_candidates or good)[0])


def _orientation(sets: Sets, sample: PhaseSample, stated: float) -> PlanCheck:
    observed = gradient_directions(sample, finest_of(sets))
    return PlanCheck(stated, unusual=upright_edit(sets, observed), mirrored=is_mirrored(sets, sample))


def disagreement(sampled: Recording, plan: Plan, sample: PhaseSample) -> Disagreement:
    """Decode some pixels by a plan and say how much its sets disagree."""
    has_single_sets = all(len(plan.sets_along(axis)) < 2 for axis in plan.axes)
    if has_single_sets or unwrapping_methods()[plan.unwrapping].guided:
        return Disagreement(np.nan, np.nan)
    try:
        decoded = decode(replace(sampled, plan=plan.model_copy(update={"order_vote": None})))
    except ConfigError:
        return Disagreement(np.inf, np.inf)
    assert decoded.disagreement is not None
    values = np.nan_to_num(decoded.disagreement[sample.lit], nan=np.inf, posinf=np.inf)
    return Disagreement(*np.quantile(values, (sample.limits.lower_quantile, 0.5), method="higher").tolist())


def _shown(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "so much that most pixels are lost, more than 100"
