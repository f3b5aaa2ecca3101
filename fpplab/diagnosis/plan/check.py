"""Decide whether a plan describes its images, and which plan next to it does better.

A plan whose sets have wrong stripes, order, signs or origins decodes to positions on which the sets do not
agree. One figure alone does not decide: a right heterodyne plan with a bent response may disagree more than a
wrong one of few stripes. So a bent response is straightened first where that makes the sets agree better,
the plans next to it are tried too, and a plan is called wrong only where another one fits much better. Where
two that differ fit equally, both are named and neither is advised. Signs and axes that are wrong in all sets
mirror or turn the result without any disagreement, as do images that are mirrored or turned; with both axes
coded a mirrored one is impossible, with one axis it is unusual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, full_scale
from fpplab.core.errors import ConfigError
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.plan.bend import Bend, fitted_bends
from fpplab.diagnosis.plan.edits import (
    Edit,
    Sets,
    finest_of,
    image_orders,
    is_mirrored,
    neighbouring_edits,
    scales_agree,
    upright_edit,
)
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.diagnosis.plan.sample import PhaseSample, gradient_directions
from fpplab.diagnosis.points import expected_change
from fpplab.patterns.fringe_sets import SteppedFringes, indices_along
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import decode

TROUGH, CREST = 0.25, 0.65
"""Level of zero, and range of grey levels above it, as shares of full scale where a response is straightened.
Chosen."""
EVERY_ORDER = {"masks": MaskRules(disagreement_max=0.5, wrong_order_max=1.0)}
"""Of plans that are tried: a pixel left out for a doubtful order would count as one that contradicts."""
MAX_EQUAL_ORIGIN_RAD = 0.1  # phase origins that are the same (chosen: a sixtieth of a stripe)


class Disagreement(NamedTuple):
    """How much the sets disagree at the lit pixels, in units of what noise explains; infinite where lost."""

    lower: float  # at the lower quantile of the limits
    median: float  # at half of them


@dataclass(frozen=True)
class PlanCheck:
    """What the images say of their plan."""

    disagreement: float  # median over the lit pixels, in units of what noise explains, as straightened
    better: Edit | None = None  # A plan that fits much better
    better_disagreement: float = np.nan  # its disagreement
    runner_up: Edit | None = None  # another one that fits as well, by which points lie elsewhere
    unusual: Edit | None = None  # another plan that fits as well, by which camera and projector stand upright
    mirrored: bool = False  # whether the plan has the scene mirrored, so that it cannot be right
    exponent: float | None = None  # of the response that was straightened; None where none was

    @property
    def fault(self) -> str | None:
        """What is wrong with the plan, and what to write; None where nothing is known to be."""
        if self.better is not None:
            mistake, remedy = self.better.mistake, self.better.remedy
            if self.runner_up is not None:
                mistake += f", or {self.runner_up.mistake}; both fit"
                remedy = "find out how the images were taken: the images alone do not show which"
            return (
                f"the plan does not fit its images: {mistake} (the sets disagree by "
                f"{_shown(self.disagreement)} times their noise, and then by "
                f"{self.better_disagreement:.1f}{self._straightened}); {remedy}"
            )
        if self.mirrored and self.unusual is not None:
            return (
                "the plan does not fit its images: it has the scene mirrored, and "
                f"{self.unusual.mistake}; {self.unusual.remedy}"
            )
        return None

    @property
    def _straightened(self) -> str:
        return f" with a response of gamma {self.exponent:.1f} straightened" if self.exponent else ""

    @property
    def note(self) -> str | None:
        """What is unusual, and right only where a device is turned; None where nothing is."""
        if self.fault is not None or self.unusual is None:
            return None
        return (
            f"{self.unusual.mistake}: this is right where camera or projector is turned or stands on its "
            f"head; otherwise {self.unusual.remedy}"
        )


@dataclass(frozen=True, eq=False)
class _Trial:
    """Sampled frames as they are, or without the bend of a response, and how the plan fits them."""

    sampled: Recording
    sample: PhaseSample
    stated: Disagreement
    agrees: bool  # whether nothing else need be tried
    exponent: float | None = None

    @classmethod
    def of(
        cls, sampled: Recording, sets: Sets, sample: PhaseSample, bends: tuple[Bend, ...] | None = None
    ) -> _Trial:
        stated = disagreement(sampled, sampled.plan, sample)
        agrees = not stated.median > sample.limits.max_agreeing and scales_agree(sets, sample)
        exponent = bends[finest_of(sets)].exponent if bends else None
        return cls(sampled, sample, stated, agrees, exponent)


def straightened(
    recording: Recording, sampled: Recording, sample: PhaseSample
) -> tuple[Recording, PhaseSample, tuple[Bend, ...]] | None:
    """Take the bend of a response off sampled frames; None where the images show none."""
    images = [s.images for s in recording.plan.fringes]
    parts = np.split(np.stack(sampled.frames).astype(np.float64), np.cumsum(images)[:-1])
    bends = fitted_bends([part[:, sample.lit] for part in parts], sample.limits)
    if bends is None:
        return None
    full = recording.full_scale
    straight = PhaseSample.of(recording.frames, images, full, sample.limits, bends)
    if straight is None:
        return None
    levels = [bend.straightened_levels(part) for bend, part in zip(bends, parts, strict=True)]
    # Without harmonics the troughs lie below zero, and at 16 bits rounding adds nothing.
    shares = TROUGH + CREST * np.concatenate(levels) / full
    deep = np.rint(full_scale(16) * shares.clip(0.0, 1.0)).astype(np.uint16)
    return replace(sampled, frames=list(deep), bits=16, merged=None), straight, bends


def check_plan_fit(
    recording: Recording, limits: DiagnosisLimits = USUAL_LIMITS, calibration: Calibration | None = None
) -> PlanCheck | None:
    """Ask the images of a recording whether their plan describes them."""
    sets = tuple(s for s in recording.plan.sets if isinstance(s, SteppedFringes))
    if len(sets) < len(recording.plan.sets):
        return None
    check_limits = limits.of(PlanCheckLimits)
    sample = PhaseSample.of(recording.frames, [s.images for s in sets], recording.full_scale, check_limits)
    if sample is None:
        return None
    sampled = recording.part(sample.rows)
    trial = _Trial.of(sampled, sets, sample)
    trials = [trial]
    if not trial.agrees and (straight := straightened(recording, sampled, sample)):
        sampled, sample, bends = straight
        trials.append(_Trial.of(sampled, sets, sample, bends))
    best = min(trials, key=lambda tried: (not tried.agrees, tried.stated.median))
    if not best.agrees:
        better = [check for tried in trials if (check := _find_better_plan(tried, sets, best, calibration))]
        if better:
            return min(better, key=lambda check: check.better_disagreement / check.disagreement)
        if reordered := _find_better_order(recording, sets, best.stated, check_limits):
            return reordered
    return _orientation(sets, best.sample, best.stated.median)


def _find_better_order(
    recording: Recording, sets: Sets, stated: Disagreement, limits: PlanCheckLimits
) -> PlanCheck | None:
    """Find an order of the images in which they fit their plan."""
    fitting = []
    for edit in image_orders(sets):
        ordered = replace(recording, frames=[recording.frames[k] for k in edit.images])
        sample = PhaseSample.of(ordered.frames, [s.images for s in sets], recording.full_scale, limits)
        if sample is None:
            continue
        misfit = disagreement(ordered.part(sample.rows), recording.plan, sample)
        is_better = misfit.median <= limits.max_better_ratio * stated.median
        if is_better and misfit.median <= limits.max_proposed and scales_agree(sets, sample):
            fitting.append((misfit.median, edit))
    if not fitting:
        return None
    (least, best), *others = sorted(fitting, key=lambda each: each[0])
    as_good = [edit for misfit, edit in others if misfit <= limits.max_equal_ratio * max(least, 1.0)]
    return PlanCheck(stated.median, best, least, next(iter(as_good), None))


def _find_better_plan(
    trial: _Trial, sets: Sets, best: _Trial, calibration: Calibration | None
) -> PlanCheck | None:
    """Find the simplest of the plans that fit much better than `best`, and another one that fits as well."""
    limits, sample, stated = trial.sample.limits, trial.sample, best.stated
    tried = [
        (edit, disagreement(trial.sampled, edit.plan(trial.sampled.plan), sample))
        for edit in neighbouring_edits(sets, sample)
        if scales_agree(edit.sets, sample)
    ]
    max_ratio = limits.max_better_ratio if scales_agree(sets, best.sample) else np.inf
    fitting = [
        (edit, misfit.median)
        for edit, misfit in tried
        if misfit.median <= min(max_ratio * stated.median, limits.max_proposed)
        and misfit.lower <= max_ratio * stated.lower
    ]
    if not fitting:
        return None
    lowest = min(d for _, d in fitting)
    good = [(edit, d) for edit, d in fitting if d <= limits.max_equal_ratio * max(lowest, 1.0)]
    # Reversed and late steps differ in the direction of the fringes alone.
    good = [each for each in good if _runs_usually(each[0].sets, sample, calibration)] or good
    first, misfit = good[0]
    runner_up = next((edit for edit, _ in good[1:] if not _is_same(edit.sets, first.sets)), None)
    return PlanCheck(trial.stated.median, first, misfit, runner_up, exponent=trial.exponent)


def _runs_usually(sets: Sets, sample: PhaseSample, calibration: Calibration | None) -> bool:
    """Whether coordinates run along the image as the calibration says, or to the right and down."""
    if calibration is None:
        return _orientation(sets, sample, np.nan).unusual is None
    expected = expected_change(calibration)
    for axis in AXES:
        for k in indices_along(sets, axis)[-1:]:
            along = sets[k].shift_sign * sample.gradients[k] @ expected[AXES.index(axis)]
            if not np.median(along) > 0.0:
                return False
    return True


def _is_same(sets: Sets, others: Sets) -> bool:
    """Whether two plans give the same coordinates, but for small differences of origins."""
    for a, b in zip(sets, others, strict=True):
        turn = np.angle(np.exp(1j * (a.phase_origin_rad - b.phase_origin_rad)))
        if (
            abs(turn) > MAX_EQUAL_ORIGIN_RAD
            or a.model_copy(update={"phase_origin_rad": b.phase_origin_rad}) != b
        ):
            return False
    return True


def _orientation(sets: Sets, sample: PhaseSample, stated: float) -> PlanCheck:
    observed = gradient_directions(sample, finest_of(sets))
    return PlanCheck(stated, unusual=upright_edit(sets, observed), mirrored=is_mirrored(sets, sample))


def disagreement(sampled: Recording, plan: Plan, sample: PhaseSample) -> Disagreement:
    """Decode some pixels by a plan and say how much its sets disagree."""
    has_single_sets = all(len(plan.sets_along(axis)) < 2 for axis in plan.axes)
    if has_single_sets or unwrapping_methods()[plan.unwrapping].guided:
        return Disagreement(np.nan, np.nan)
    try:
        with np.errstate(over="ignore"):  # of other patterns the noise may seem beyond measure
            decoded = decode(replace(sampled, plan=plan.model_copy(update=EVERY_ORDER)))
    except ConfigError:
        return Disagreement(np.inf, np.inf)
    assert decoded.disagreement is not None
    values = np.nan_to_num(decoded.disagreement[sample.lit], nan=np.inf, posinf=np.inf)
    return Disagreement(*np.quantile(values, (sample.limits.lower_quantile, 0.5), method="higher").tolist())


def _shown(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "so much that most pixels are lost, more than 100"
