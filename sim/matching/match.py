"""Characterisation matching: the twin's parameters are fitted in steps, each kept only if it lowers the loss.

The steps are those of `sim.matching.steps`; each is one epoch. The last ones are repeated until neither
the loss nor any parameter changes by more than it is uncertain.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, Say, ignore, no_progress
from sim.matching.evaluation import TwinEvaluation, evaluate
from sim.matching.light import light_fit
from sim.matching.light.contrast import sample_contrasts
from sim.matching.loss import Weights
from sim.matching.record import MatchingEpoch, MatchingRecord, ParametersFile
from sim.matching.reference import Reference
from sim.matching.samples import PixelSample, sample_pixels
from sim.matching.scene.artefacts import BenchScan
from sim.matching.steps import (
    CHANGING,
    CHANGING_STEPS,
    EXPLAINS,
    FIRST_STEPS,
    REPEATED_STEPS,
    SAMPLED_POSES,
    SHARPNESS_OF_BOARD,
    VARYING_EFFECTS,
    MatchingContext,
    MatchingStep,
)
from sim.parameters import ADJUSTABLE, TwinParameters
from sim.twin import Twin

CONVERGED = "converged"  # why a matching ends that need not go on


@dataclass(frozen=True)
class StepLimits:
    """How steps of a matching are judged."""

    # of a parameter that has not converged, however well it is known (chosen)
    min_relative_change: float = 1e-3
    compared_poses: int = 6  # whose images judge an epoch, at most (chosen, for speed)
    characterised_poses: int = 12  # whose frames characterise the matched twin, at most (chosen, for speed)
    equal_loss: float = 2e-4  # difference of losses that is noise (chosen)
    usual_images: int = 60  # of a step, about: the scale of the progress (estimated)


LIMITS = StepLimits()

FOCUS_STEPS = {"projector defocus", "depth of field"}
"""The steps that fit the focus; before them the twin may be sharp where the bench is not."""


class MatchingLimits(Document):
    """When a matching stops."""

    epochs: int = 25
    """Greatest number of epochs."""
    seconds: float = 900.0
    """Greatest duration of the epochs in s, of all runs together. A step that lasts longer is abandoned: the
    record then ends with the epoch before."""
    patience: int = 1
    """Number of rounds of the last steps without a gain after which the matching has converged."""
    converged: float = 2e-4
    """Decrease of the loss over the board below which a round has no gain."""
    poses_um: float = 5.0
    """RMS distance in µm by which a round may move the poses and still have no gain; half of their own
    standard uncertainty, where that is more."""


@dataclass(frozen=True, eq=False)
class MatchedTwin:
    """Result of a matching."""

    parameters: TwinParameters  # the best that were found
    epochs: tuple[MatchingEpoch, ...]  # all epochs, those of earlier runs included
    explained: dict[str, float]  # by step
    unexplained: float  # RMS difference over the board that is left, in raw levels
    ended: str  # why the matching stopped

    @property
    def refined_focus(self) -> bool:
        """Whether both focus steps were made, so that sharpness can be compared with the reference's."""
        return {epoch.step for epoch in self.epochs} >= FOCUS_STEPS

    @property
    def ssim_board(self) -> float:
        """Mean SSIM over the board of the best epoch, which knows nothing of the board's sheet."""
        return _best(self.epochs).loss["ssim_board"]


class _TimeOver(Exception):  # noqa: N818 - no fault: the time is over
    """Ends a step that would last longer than the matching may."""


@dataclass(eq=False)
class _StepWatch:
    """Called before the twin computes images: reports progress, and ends a step when the time is over."""

    started: float
    limits: MatchingLimits
    progress: Progress
    tell: Say
    label: str = ""
    number: int = 0
    images: int = 0
    may_end: bool = False

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started

    def begin(self, number: int, label: str, may_end: bool = True) -> None:
        self.number, self.label, self.images, self.may_end = number, label, 0, may_end

    def __call__(self) -> None:
        remaining = self.limits.seconds - self.seconds
        if self.may_end and remaining < 0:
            raise _TimeOver
        done = self.number - np.exp(-self.images / LIMITS.usual_images)
        self.images += 1
        self.progress(min(1.0, float(done + 1.0) / (_usual_steps() + 2)))
        self.tell(f"{self.label}, {max(remaining, 0.0):.0f} s left at most" if self.may_end else self.label)


@dataclass(eq=False)
class _State:
    at: MatchingContext
    weights: Weights
    record: MatchingRecord
    epochs: list[MatchingEpoch]
    started: float
    watch: _StepWatch

    @property
    def best(self) -> MatchingEpoch:
        return _best(self.epochs)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started


EpochObserver = Callable[[MatchingEpoch], None]


def match_twin(
    reference: Reference,
    twin: Twin,
    start: TwinParameters,
    record: MatchingRecord,
    weights: Weights,
    limits: MatchingLimits,
    scans: Sequence[BenchScan] = (),
    *,
    progress: Progress = no_progress,
    observe: EpochObserver = ignore,
    tell: Say = ignore,
) -> MatchedTwin:
    epochs = record.read()
    if not epochs:
        start = ParametersFile.of(start).parameters()  # as a continued matching reads them
    elif epochs[-1].next_frame is not None:
        twin.count_frames_from(epochs[-1].next_frame)
    twin = twin.with_parameters(_best(epochs).parameters.parameters() if epochs else start)
    white = "paper" if reference.response is not None else "white"
    samples = _samples_of_poses(reference, epochs[-1].parameters.parameters() if epochs else start)
    before = epochs[-1].seconds if epochs else 0.0
    started = time.monotonic() - before
    watch = _StepWatch(started, limits, progress, tell)
    contrasts = tuple(sample_contrasts(twin, scans, reference.plan))
    at = MatchingContext(reference, twin.with_progress(watch), samples, white, contrasts)
    state = _State(at, weights, record, epochs, started, watch)
    if not epochs:
        watch.begin(0, "epoch 0, start", may_end=False)
        first = _evaluate_epoch(state, at).loss.summary()
        _record_epoch(state, "start", ParametersFile.of(start), first, _difference(at), True, observe)
    ended = _make_steps_until_limit(state, limits, observe)
    watch.begin(_usual_steps() + 1, "judging the result", may_end=False)
    best = state.best.parameters.parameters()
    at = replace(at, samples=_samples_of_poses(reference, best)).with_parameters(best)
    unexplained = _difference(at)
    explained = explained_shares(state.epochs) | _changing_shares(at, unexplained**2)
    return MatchedTwin(best, tuple(state.epochs), explained, unexplained, ended)


def _best(epochs: Sequence[MatchingEpoch]) -> MatchingEpoch:
    return next(epoch for epoch in reversed(epochs) if epoch.accepted)


def explained_shares(epochs: Sequence[MatchingEpoch]) -> dict[str, float]:
    """Compute the share of the difference that each step of `EXPLAINS` but `CHANGING` removed."""
    # Shadows need relief: a flat board has none, so `shadowing` explains nothing.
    shares, last = {"shadowing": 0.0}, epochs[0]
    for epoch in epochs[1:]:
        if epoch.step in EXPLAINS.keys() - CHANGING and last.difference > 0:
            gained = 1.0 - (epoch.difference / last.difference) ** 2
            shares[epoch.step] = gained if epoch.accepted else 0.0
        if epoch.accepted:
            last = epoch
    return shares


def _samples_of_poses(reference: Reference, parameters: TwinParameters) -> list[PixelSample]:
    images = sorted({*reference.one_of_each_set, *reference.finest})
    return sample_pixels(reference, parameters, reference.spread_poses(SAMPLED_POSES), images)


def _usual_steps() -> int:
    return len(FIRST_STEPS) + 2 * len(REPEATED_STEPS) + len(CHANGING_STEPS)


def _make_steps_until_limit(state: _State, limits: MatchingLimits, observe: EpochObserver) -> str:
    for number, step in enumerate(FIRST_STEPS, 1):
        if ended := _step_within(state, limits, observe, number, step):
            return ended
    idle = 0
    number = len(FIRST_STEPS)
    repeated = [repeatable for repeatable in REPEATED_STEPS if repeatable.applies(state.at)]
    while idle < limits.patience:
        before = _best(state.epochs[: number + 1])
        for step in _worth_trying(repeated, state.epochs[: number + 1], limits):
            number += 1
            if ended := _step_within(state, limits, observe, number, step):
                return ended
        idle = 0 if _has_changed(before, _best(state.epochs[: number + 1]), limits) else idle + 1
    # By the rounds alone: a matching that goes on has taken some of what follows already.
    at = state.at.with_parameters(_best(state.epochs[: number + 1]).parameters.parameters())
    # Errors of points follow from the geometry, which light and noise found since hardly change.
    changing = [step for step in CHANGING_STEPS if not step.characterises]
    last = [step for step in (SHARPNESS_OF_BOARD, *changing) if step.applies(at)]
    for later, step in enumerate(last, number + 1):
        if _step_within(state, limits, observe, later, step):
            break
    return CONVERGED


def _worth_trying(
    steps: Sequence[MatchingStep], epochs: Sequence[MatchingEpoch], limits: MatchingLimits
) -> list[MatchingStep]:
    """Leave out the steps that were refused and are not tried again, or last changed nothing that counts."""
    last = {epoch.step: number for number, epoch in enumerate(epochs)}

    def is_worth(step: MatchingStep) -> bool:
        if step.name not in last:
            return True
        tried = epochs[last[step.name]]
        if not tried.accepted:
            return step.again
        return _has_changed(_best(epochs[: last[step.name]]), tried, limits)

    return [step for step in steps if is_worth(step)]


def _step_within(
    state: _State, limits: MatchingLimits, observe: EpochObserver, number: int, step: MatchingStep
) -> str | None:
    """Make a step unless an earlier run took it; return the limit that ended it, None for none."""
    if number < len(state.epochs):
        return None
    if number > limits.epochs:
        return f"after {limits.epochs} epochs"
    if state.seconds > limits.seconds:
        return f"after {state.seconds:.0f} s"
    loss = state.best.loss["loss_board"]
    state.watch.begin(number, f"epoch {number}, {step.name}: loss over the board {loss:.4f}")
    try:
        _take_step(state, step, observe)
    except _TimeOver:
        return f"after {state.seconds:.0f} s"
    return None


def _has_changed(before: MatchingEpoch, after: MatchingEpoch, limits: MatchingLimits) -> bool:
    """Whether a round or step still changed the loss, or a parameter by more than it is uncertain."""
    if before.loss["loss_board"] - after.loss["loss_board"] >= limits.converged:
        return True
    old, new = before.parameters.parameters(), after.parameters.parameters()
    if moved_um(old, new) > max(limits.poses_um, 0.5 * new.sigma.get("poses_um", 0.0)):
        return True
    for name in new.sigma.keys() & ADJUSTABLE.keys():
        values = [
            ADJUSTABLE[name].read(parameters)
            for parameters in (old, new)
            if getattr(parameters, name, 0.0) is not None
        ]
        if len(values) < 2 or abs(values[1] - values[0]) > max(
            new.sigma[name], LIMITS.min_relative_change * abs(values[0])
        ):
            return True
    return False


def moved_um(before: TwinParameters, after: TwinParameters) -> float:
    off = [a.translation - b.translation for a, b in zip(before.poses, after.poses, strict=True)]
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.square(off), axis=-1))))


def _take_step(state: _State, step: MatchingStep, observe: EpochObserver) -> None:
    best = state.best
    at = state.at.with_parameters(best.parameters.parameters())
    before = step.misfit(at)
    written = ParametersFile.of(step.propose(at))
    tried = at.with_parameters(written.parameters())
    after = step.misfit(tried)
    better = not is_worse(before, after) if before is not None and after is not None else None
    refused = better is False
    if step.same_images and (refused or not step.characterises):
        loss, difference = best.loss, best.difference
    else:
        known_twin_rms_px = None if step.characterises and not refused else best.loss["epsilon_v_px"]
        loss = _evaluate_epoch(state, tried, known_twin_rms_px).loss.summary()
        samples = _samples_of_poses(at.reference, tried.twin.parameters)
        state.at = replace(state.at, samples=samples)
        difference = _difference(replace(tried, samples=samples))
    accepted = not refused and (_is_step_accepted(best, loss, difference) if better is None else better)
    _record_epoch(state, step.name, written, loss, difference, accepted, observe)


def is_worse(before: float | Floats, after: float | Floats) -> bool:
    """Whether a misfit has grown, in the mean of poses by more than its own standard error."""
    # A twin's noise is drawn anew each time: without the error, chance would refuse half of the small steps.
    grown = np.atleast_1d(np.subtract(after, before))
    error = grown.std(ddof=1) / np.sqrt(len(grown)) if len(grown) > 1 else 0.0
    return bool(grown.mean() > error)


def _evaluate_epoch(
    state: _State, context: MatchingContext, known_twin_rms_px: float | None = None
) -> TwinEvaluation:
    compared = context.reference.spread_poses(LIMITS.compared_poses)
    return evaluate(context.reference, context.twin, state.weights, known_twin_rms_px, poses=compared)


def _is_step_accepted(best: MatchingEpoch, loss: Mapping[str, float], difference: float) -> bool:
    """Decide by the loss over the board; where losses are equal, by the mean square difference."""
    gain = best.loss["loss_board"] - loss["loss_board"]
    if abs(gain) > LIMITS.equal_loss:
        return gain > 0
    return difference <= best.difference * (1.0 + 1e-3)


def _difference(at: MatchingContext) -> float:
    """RMS of bench less twin at the samples, in raw levels."""
    return float(np.sqrt(light_fit.mean_square_difference(at.reference, at.twin, at.samples)))


def _changing_shares(context: MatchingContext, mean_square: float) -> dict[str, float]:
    """Shares of what is left that flicker, bands, vibration and the sensor's noise make."""
    now, whole = context.twin.parameters, _mean_square_noise(context)
    without = {effect.name: effect.without(now) if effect.is_in(now) else None for effect in VARYING_EFFECTS}
    shares = dict.fromkeys(without, 0.0)
    for step, steady in without.items():
        if steady is not None:
            shares[step] = (whole - _mean_square_noise(context.with_parameters(steady))) / mean_square
    return {**shares, "noise": whole / mean_square - sum(shares.values())}


def _mean_square_noise(context: MatchingContext) -> float:
    """Mean square of the twin's own noise at the samples, since expected images have no noise."""
    reference, twin = context.reference, context.twin
    squares = []
    for sample in context.samples[::2]:  # every other pose: noise is alike in all
        patterns = reference.shown(sample.images)
        expected = twin.expected_at(sample.pose, patterns, reference.settings, sample.pixels)
        for frame, level in zip(
            twin.frames(sample.pose, patterns, reference.settings), expected, strict=True
        ):
            off = frame[sample.pixels].astype(np.float64) - level
            squares.append(float(np.mean(off**2)))
    return float(np.mean(squares))


def _record_epoch(
    state: _State,
    name: str,
    tried: ParametersFile,
    loss: dict[str, float],
    difference: float,
    accepted: bool,
    observe: EpochObserver,
) -> None:
    if not np.isfinite(loss["loss_board"]):
        raise CalibrationError(
            f"the step '{name}' led to images that cannot be compared: their SSIM is not finite"
        )
    epoch = MatchingEpoch(
        epoch=len(state.epochs),
        step=name,
        accepted=accepted,
        loss=loss,
        difference=difference,
        seconds=state.seconds,
        parameters=tried,
        next_frame=state.at.twin.next_frame,
        poses_um=moved_um(state.best.parameters.parameters(), tried.parameters()) if state.epochs else None,
    )
    state.record.add(epoch)
    state.epochs.append(epoch)
    observe(epoch)
