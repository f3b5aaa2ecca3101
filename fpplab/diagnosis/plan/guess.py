"""Guess a plan from images alone: sets, steps, axes, stripes, signs.

What images cannot show is assumed to be usual: sinusoids with equal steps, columns that run to the right in
the image and rows down, a coarsest set of one stripe (or whole numbers of stripes that fit the measured
ratios) whose phase has no origin.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import AXES, Floats, Image, Mask, full_scale, phase_steps
from fpplab.core.errors import DataError
from fpplab.diagnosis.plan.check import disagreement, straightened
from fpplab.diagnosis.plan.edits import Sets, refined_stripes, upright_edit, with_origins
from fpplab.diagnosis.plan.guess_codes import guess_codes
from fpplab.diagnosis.plan.limits import GUESS_LIMITS, GuessLimits
from fpplab.diagnosis.plan.other_patterns import name_other_patterns, sampled_levels
from fpplab.diagnosis.plan.sample import MIN_STEPS, PhaseSample, gradient_directions
from fpplab.patterns.fringe_sets import indices_along, stepped_fringes
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping.heterodyne import Heterodyne
from fpplab.patterns.unwrapping.hierarchical import Hierarchical


@dataclass(frozen=True)
class PlanGuess:
    """A plan that describes some images."""

    plan: Plan  # the plan
    disagreement: float  # of its sets, in units of what noise explains
    assumed: tuple[str, ...]  # what the images do not show, one sentence each


def guess_plan(
    frames: Sequence[Image],
    bits: int,
    projector_size: tuple[int, int],
    finest: float | None = None,
    limits: GuessLimits = GUESS_LIMITS,
) -> PlanGuess:
    """Find a plan that describes images."""
    # frames (height, width); projector_size (width, height) px
    try:
        images = set_sizes(frames, full_scale(bits), limits)
    except DataError:
        if (codes := guess_codes(frames, bits, projector_size, limits)) is None:
            raise
        return PlanGuess(codes.plan, codes.misfit, codes.assumed)
    sample = PhaseSample.of(frames, images, full_scale(bits))
    if sample is None:
        raise DataError("too few pixels see the fringes of every set; look at the images")
    upright_sets = _axes_and_signs(images, sample, projector_size)
    sampled = Recording(
        [np.ascontiguousarray(f[sample.rows]) for f in frames],
        Plan(fringes=upright_sets),
        projector_size,
        bits,
    )
    recording = Recording(frames, sampled.plan, projector_size, bits)
    if straight := straightened(recording, sampled, sample):
        sampled, sample, _ = straight
    for sets in _with_stripes(upright_sets, sample, finest, limits):
        coarsest = max(sets[along[0]].stripes for axis in AXES if (along := indices_along(sets, axis)))
        method = Hierarchical.name if coarsest <= 1.0 else Heterodyne.name
        plan = Plan(fringes=with_origins(sets, sample) if coarsest <= 1.0 else sets, unwrapping=method)
        misfit = disagreement(sampled, plan, sample).median
        if not misfit > sample.limits.max_agreeing:
            return PlanGuess(plan, misfit, _list_assumptions(coarsest, finest))
    shown = f"the images show sets of {str(images)[1:-1]} steps"
    if finest is not None:
        raise DataError(
            f"{shown}, but with {finest:g} stripes in the finest they agree on no position; see whether that "
            "number is right, and measure the response with 'fpplab gamma', which bends phases"
        )
    raise DataError(
        f"{shown}, but how many stripes they have across the whole projector cannot be determined; say with "
        "--finest how many the finest set has"
    )


def _list_assumptions(coarsest: float, finest: float | None) -> tuple[str, ...]:
    sentences = ["camera and projector stand upright: columns run to the right in the image, rows down"]
    if coarsest <= 1.0:
        sentences.append("the coarsest set of each axis has one stripe across the whole projector")
    elif finest is None:
        sentences.append("stripes are the least whole numbers with the ratios that the images show")
    return (
        *sentences,
        "the phase of the coarsest set has no origin; a wrong one shifts all coordinates equally",
    )


def set_sizes(frames: Sequence[Image], full: int, limits: GuessLimits = GUESS_LIMITS) -> list[int]:
    """Find which runs of images are sets of phase-shifted sinusoids."""
    # frames (height, width)
    count = len(frames)
    if count < MIN_STEPS:
        raise DataError(f"{count} images are too few: a set has at least {MIN_STEPS}")
    moments = _moments(frames, full, limits)
    cost, last = [0.0] + [np.inf] * count, [0] * (count + 1)
    for end in range(MIN_STEPS, count + 1):
        for start in range(end - MIN_STEPS + 1):
            worth = (
                cost[start]
                + _residual_squares(moments[start:end, start:end]) / limits.usual_misfit**2
                + limits.min_squares_per_set
            )
            if worth < cost[end]:
                cost[end], last[end] = worth, start
    sizes: list[int] = []
    end = count
    while end > 0 and np.isfinite(cost[end]):
        sizes.insert(0, end - last[end])
        end = last[end]
    starts = np.cumsum([0, *sizes])
    misfit = sum(
        _residual_squares(moments[a : a + n, a : a + n]) for a, n in zip(starts, sizes, strict=False)
    )
    if np.sqrt(misfit / max(count - 2 * len(sizes), 1)) > limits.max_misfit:
        explanation = (
            name_other_patterns(frames, full, limits=limits)
            or "leave out white, black and other images by --skip"
        )
        raise DataError(
            f"the {count} images are not made up of sets of phase-shifted sinusoids with equal steps, one "
            f"set after the other; {explanation}"
        )
    return sizes


def _moments(frames: Sequence[Image], full: int, limits: GuessLimits) -> Floats:
    """Second moments (K, K) of what frames differ from their mean, in squares of the modulation."""
    levels = sampled_levels(frames, limits.pixels)
    levels = levels[:, levels.max(axis=0) < full]
    ripple = levels - levels.mean(axis=0)
    strength = np.sqrt(2.0 * np.mean(ripple * ripple, axis=0))
    lit = strength > 0.5 * np.quantile(strength, 0.95) if strength.size else np.zeros(0, np.bool_)
    if lit.sum() < MIN_STEPS * 10:
        raise DataError("too few pixels see fringes that are not saturated; look at the images")
    ripple = ripple[:, lit] / strength[lit]
    return np.asarray(ripple @ ripple.T / ripple.shape[1])


def _residual_squares(moments: Floats) -> float:
    """What a sinusoid around the mean of all images leaves of a run of images, in squares of modulation."""
    shift = phase_steps(len(moments))
    waves = np.stack([np.cos(shift), np.sin(shift)]) * np.sqrt(2.0 / len(moments))
    return float(np.trace(moments) - np.sum((waves @ moments) * waves))


def _axes_and_signs(images: list[int], sample: PhaseSample, size: tuple[int, int]) -> Sets:
    """Sets with the axes and signs of devices that stand upright; stripes as fast as in the image."""
    reference = int(np.argmax(np.median(np.hypot(*np.moveaxis(sample.gradients, -1, 0)), axis=1)))
    observed = gradient_directions(sample, reference)
    axis, other = AXES if observed[reference].level else AXES[::-1]
    sets = tuple(
        stepped_fringes(axis if each.parallel else other, each.speed, n, projector_size=size)
        for each, n in zip(observed, images, strict=True)
    )
    edit = upright_edit(sets, observed)
    return sets if edit is None else edit.sets


def _with_stripes(
    sets: Sets, sample: PhaseSample, finest: float | None, limits: GuessLimits
) -> Iterator[Sets]:
    """Numbers of stripes that have the ratios measured, the least first."""
    by_axis = [along for axis in AXES if (along := indices_along(sets, axis))]
    scaled = [
        _scaled_stripes(_ratios(sets, along), _visible_periods(sample, along[0]), finest, limits)
        for along in by_axis
    ]
    for numbers in zip(*scaled, strict=False):
        edited = list(sets)
        if max(map(np.max, numbers)) > sample.limits.max_stripes:
            continue
        for along, stripes in zip(by_axis, numbers, strict=True):
            for k, number in zip(along, stripes, strict=True):
                edited[k] = edited[k].model_copy(update={"stripes": float(number)})
            for k in along[1:] if stripes[0] <= 1.0 else []:
                exact = refined_stripes(tuple(edited), along, k, edited[k].stripes, sample)
                edited[k] = edited[k].model_copy(update={"stripes": exact})
        yield tuple(edited)


def _ratios(sets: Sets, along: Sequence[int]) -> Floats:
    return np.array([sets[k].stripes for k in along]) / sets[along[0]].stripes


def _visible_periods(sample: PhaseSample, k: int) -> float:
    """Periods of a set across the lit pixels."""
    places = np.argwhere(sample.lit)
    steps = np.array([part.step for part in sample.rows])
    height, width = (places.max(axis=0) - places.min(axis=0)) * steps
    right, down = np.abs(np.median(sample.gradients[k], axis=0))
    return float(max(right * width, down * height) / (2.0 * np.pi))


def _scaled_stripes(
    ratios: Floats, turns: float, finest: float | None, limits: GuessLimits
) -> Iterator[Floats]:
    """Go through stripes of the sets of one axis, coarsest first."""
    if finest is not None:
        stripes = ratios * finest / ratios[-1]
        if turns <= limits.max_visible_periods:
            yield np.array([1.0, *stripes[1:]])
        yield np.where(_nearly_whole(stripes, limits), np.rint(stripes), stripes)
        yield stripes
        return
    if turns <= limits.max_visible_periods:
        yield ratios
        return
    for coarsest in range(max(int(turns / limits.max_visible_periods), 2), limits.max_stripes):
        stripes = ratios * coarsest
        if len(ratios) > 1 and np.all(_nearly_whole(stripes, limits)):
            yield np.rint(stripes)


def _nearly_whole(stripes: Floats, limits: GuessLimits) -> Mask:
    return np.asarray(np.abs(stripes - np.rint(stripes)) < limits.max_whole_difference * stripes)
