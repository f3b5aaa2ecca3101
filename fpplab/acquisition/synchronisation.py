"""Check that frame k shows pattern k, from the frames alone.

The frames of a set add up to the same image for all sets, unless the light of the room changed between
them, and a pixel sees a sinusoid in each: all frames of a plan lie in a space of few dimensions, whatever the
scene. Each synchronisation fault is a hypothesis that says which pattern each frame shows, and so another
space. The frames decide between these spaces.

Only their second moments over a sample of pixels are needed, the (K, K) matrix `Moments.all`, so that a
hundred hypotheses cost milliseconds. A hypothesis is rated by its marginal likelihood: the sinusoids'
offset, amplitudes and phases are free parameters, so that hypotheses with more of them do not win for that
alone.

Lamps flicker and ambient light changes, so the brightness of a frame as a whole is ignored; a nonlinear
response distorts the sinusoid, so that a second harmonic is tried too; noise is distinguished from misfit by
the correlation of neighbouring pixels.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Map, Mask
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording


@dataclass(frozen=True)
class SyncLimits:
    """From when on frames are out of step."""

    rows: int = 24  # rows of a frame that are evaluated; chosen
    pixels: int = 1_500  # and pixels, where it has as many; chosen
    min_pixels: int = 40  # that see the fringes; chosen
    # RMS misfit, as a share of the modulation, of frames in step besides noise: a response of gamma 0.5
    # leaves 0.03 beyond its second harmonic.
    misfit_in_step: float = 0.04
    misfit_foreign: float = 0.12  # beyond which frames are not the plan's; chosen: six captures leave 0.02
    # Logarithm of a likelihood ratio per pixel from which on a fault is concluded, and below which two
    # hypotheses explain the frames equally well; chosen.
    min_log_ratio: float = 3.0
    equal_log_ratio: float = 0.05
    # What a fault leaves of the misfit of frames in step; chosen: simulated ones leave a seventh at most, and
    # the likeliest fault leaves seven tenths where a part moves.
    max_left: float = 0.4
    # Prior variance, in squares of modulation, of a sinusoid's coefficients and of a frame that shows no
    # pattern; chosen.
    prior_variance: float = 0.5


LIMITS = SyncLimits()
IMPORTED_REMEDY = "check the order of the image files, and of the plan's sets and steps"
"""Advice on images that another program recorded."""
LINEAR, NONLINEAR = 1, 2
"""Harmonics of a fringe that a pixel may see: with a linear response, and with a nonlinear one."""


class Cause(StrEnum):
    """What can have happened, at a frame where there is one."""

    LATE = "late"  # every frame shows the pattern before its own
    EARLY = "early"  # every frame shows the pattern after its own
    MISSED = "missed"  # a trigger was missed: later frames show the pattern after their own
    DOUBLED = "doubled"  # there was one trigger too many: later frames show the pattern before their own
    FOREIGN = "foreign"  # one frame shows none of the patterns
    SWAPPED = "swapped"  # two frames show each other's pattern


@dataclass(frozen=True)
class SyncFault:
    """One way in which frames are out of step with their patterns."""

    cause: Cause  # what happened
    frame: int = 0  # index of the frame where it begins, from 0
    other: int | None = None  # index of the later of two swapped frames; by default the next

    def shown(self, frames: int) -> list[int | None]:
        k, at = list(range(frames)), self.frame
        match self.cause:
            case Cause.LATE:
                return [None, *k[:-1]]
            case Cause.EARLY:
                return [*k[1:], None]
            case Cause.MISSED:
                return [*k[:at], *k[at + 1 :], None]
            case Cause.DOUBLED:
                return [*k[:at], *k[at - 1 : -1]]
            case Cause.FOREIGN:
                return [*k[:at], None, *k[at + 1 :]]
            case Cause.SWAPPED:
                return [*k[:at], self.partner, *k[at + 1 : self.partner], at, *k[self.partner + 1 :]]

    @property
    def partner(self) -> int:
        """The later of two swapped frames."""
        return self.frame + 1 if self.other is None else self.other

    def describe(self) -> str:
        """Describe what was seen, and what probably happened."""
        at = self.frame
        return {
            Cause.LATE: "every frame shows the pattern before its own (one too late): an extra trigger came "
            "before the first, or the display is slower than the plan's settle_s",
            Cause.EARLY: "every frame shows the pattern after its own (one too early): the first trigger "
            "was missed",
            Cause.MISSED: f"from frame {at} on every frame shows the pattern after its own: the trigger of "
            f"pattern {at} was missed",
            Cause.DOUBLED: f"frame {at} shows pattern {at - 1} again, and so on: there was one trigger too "
            f"many before frame {at}",
            Cause.FOREIGN: f"frame {at} shows none of the plan's patterns: it is dark, or shows parts of two",
            Cause.SWAPPED: f"frames {at} and {self.partner} show each other's pattern",
        }[self.cause]


def considered_faults(frames: int) -> Iterator[SyncFault]:
    yield SyncFault(Cause.LATE)
    yield SyncFault(Cause.EARLY)
    # A trigger missed at the last frame is a foreign last frame; one doubled at the first is a late row.
    yield from (SyncFault(Cause.MISSED, k) for k in range(1, frames - 1))
    yield from (SyncFault(Cause.DOUBLED, k) for k in range(1, frames))
    yield from (SyncFault(Cause.FOREIGN, k) for k in range(frames))
    yield from (SyncFault(Cause.SWAPPED, k) for k in range(frames - 1))


def far_swaps(frames: int) -> Iterator[SyncFault]:
    """Iterate over exchanges of two frames that are not neighbours: files in a wrong order."""
    for first in range(frames - 2):
        yield from (SyncFault(Cause.SWAPPED, first, other) for other in range(first + 2, frames))


@dataclass(frozen=True)
class SyncVerdict:
    """Result of `check_synchronisation`."""

    causes: tuple[SyncFault, ...] = ()  # the faults that explain the frames
    fits: bool = True  # whether any hypothesis explains them
    provable: bool = True  # whether the frames could have revealed a fault
    misfit: float = 0.0  # RMS of what frames in step would leave besides noise, as a share of the modulation

    @property
    def in_step(self) -> bool:
        """Whether nothing speaks against the frames showing their own patterns."""
        return self.fits and not self.causes

    def describe(self) -> str:
        if not self.fits:
            return (
                "the frames do not fit the plan: they are out of step with it, or the scene or its light "
                "changed while they were taken"
            )
        return "; or ".join(fault.describe() for fault in self.causes)


def synchronisation_remedy(plan: Plan) -> str:
    """Give advice to the operator on a session whose frames are out of step."""
    if plan.trigger == "stepped":
        return "give the plan a longer settle_s"
    return "check the trigger's cable, edge and delay"


@dataclass(frozen=True, eq=False)
class Moments:
    """Second moments of K frames over pixels, in squares of the modulation."""

    all: Floats  # of each pixel with itself
    neighbours: Floats  # of each pixel with its neighbour, to which noise does not contribute


def check_synchronisation(recording: Recording) -> SyncVerdict:
    """Ask the frames whether frame k shows pattern k."""
    moments = _moments(recording)
    return SyncVerdict(provable=False) if moments is None else _decide(moments, recording.plan)


def provable(plan: Plan) -> bool:
    """Tell whether a late, early, missed or doubled trigger shows in a plan's frames, for any response."""
    # It does not where what a pixel may see can pass through any frames, such as sinusoids with their second
    # harmonics through a single set of up to five steps.
    free = (np.linalg.matrix_rank(each.waves(NONLINEAR)) for each in plan.sets)
    return plan.images > 1 + sum(int(rank) for rank in free)


def _moments(recording: Recording) -> Moments | None:
    """Of a sample of pixels that see the fringes and are not saturated; None where there are too few."""
    frames = recording.frames
    height, width = frames[0].shape
    down = max(1, height // LIMITS.rows)
    columns_per_cell = max(2, len(range(0, height, down)) * width // LIMITS.pixels)
    rows, used = slice(down // 2, None, down), width // columns_per_cell * columns_per_cell
    cells = [
        frame[rows, :used].reshape(-1, used // columns_per_cell, columns_per_cell) for frame in frames
    ]  # views
    pair = [np.stack([cell[..., i].ravel() for cell in cells]) for i in (0, 1)]
    unsaturated = np.maximum(*(levels.max(axis=0) for levels in pair)) < recording.full_scale
    ripple, neighbour = (_ripple(levels[:, unsaturated].astype(np.float32)) for levels in pair)
    if ripple.shape[1] < LIMITS.min_pixels:
        return None
    modulation = np.sqrt(2.0 * np.mean(ripple * ripple, axis=0))
    min_modulation = max(
        0.5 * float(np.quantile(modulation, 0.95)), recording.plan.masks.modulation_min / recording.grey
    )
    used = modulation >= min_modulation
    if used.sum() < LIMITS.min_pixels:
        return None
    ripple = ripple[:, used] / modulation[used]
    neighbour = neighbour[:, used] / modulation[used]
    cross = ripple @ neighbour.T
    pixels = int(used.sum())
    return Moments(_floats(ripple @ ripple.T / pixels), _floats((cross + cross.T) / (2 * pixels)))


def _floats(moment: Map) -> Floats:
    return np.asarray(moment, np.float64)


def _ripple(levels: Map) -> Map:
    """Changes from frame to frame, (K, P), without the brightness of each frame as a whole."""
    offset = levels.mean(axis=0)
    ripple = levels - offset
    ripple -= np.outer(ripple @ (offset / max(offset @ offset, np.float32(1e-12))), offset)
    return np.asarray(ripple, np.float32)


def _waves(plan: Plan, harmonics: int, own_offsets: bool) -> Floats:
    """Basis of what a pixel may see of every pattern: own harmonics for each set, and one common offset."""
    # With own offsets the room's light changed between the sets, which their phases do not see.
    offsets = [np.ones((each.images, 1)) for each in plan.sets]
    waves = scipy.linalg.block_diag(*(each.waves(harmonics) for each in plan.sets))
    return np.concatenate(
        [scipy.linalg.block_diag(*offsets) if own_offsets else np.vstack(offsets), waves], axis=1
    )


@dataclass(frozen=True, eq=False)
class _Spaces:
    """The spaces in which frames lie under H hypotheses: orthogonal axes in the space of the K frames."""

    axes: Floats  # (H, K, R), zero rows where a frame shows something else
    square: Floats  # (H, R), the axes' squared lengths
    free: Mask  # (H, R), those lengths that count
    has_pattern: Floats  # (H, K), frames that show a pattern
    freedom: NDArray[np.int64]  # (H,), the number of dimensions left to misfit

    def residual(self, moment: Floats) -> Floats:
        """Residual sum of squares of each hypothesis, (H,)."""
        spread = np.einsum("hkr,hkr->hr", self.axes, np.matmul(moment, self.axes)) / self.square
        total = self.has_pattern @ np.diag(moment)
        return np.asarray(np.maximum(total - np.where(self.free, spread, 0.0).sum(axis=1), 0.0))

    def log_likelihoods(self, moments: Moments) -> Floats:
        """Logarithm of each hypothesis' marginal likelihood per pixel, up to a constant, (H,)."""
        residual = self.residual(moments.all)
        foreign = self.has_pattern.shape[1] - self.has_pattern.sum(axis=1)
        variance = np.maximum(residual / np.maximum(self.freedom, 1), LIMITS.misfit_in_step**2)
        volume = np.where(self.free, np.log(self.square * LIMITS.prior_variance), 0.0).sum(axis=1)
        deviance = self.freedom * np.log(variance) + residual / variance + volume
        return np.asarray(-0.5 * (deviance + foreign * (np.log(LIMITS.prior_variance) + 1.0)))

    def misfits(self, moments: Moments) -> Floats:
        """RMS residual of each hypothesis besides noise, (H,)."""
        return np.asarray(np.sqrt(self.residual(moments.neighbours) / np.maximum(self.freedom, 1)))

    def misfit(self, moments: Moments) -> float:
        """RMS residual of the first hypothesis besides noise."""
        return float(self.misfits(moments)[0])


@lru_cache(maxsize=16)
def _signal_spaces(
    plan: Plan, harmonics: int, named: tuple[SyncFault, ...] = (), own_offsets: bool = False
) -> _Spaces:
    """The space of frames in step, and then those of the faults named."""
    count = plan.images
    shown: list[list[int | None]] = [list(range(count)), *(fault.shown(count) for fault in named)]
    has_pattern = np.array([[k is not None for k in row] for row in shown], np.float64)
    waves = (
        _waves(plan, harmonics, own_offsets)[[[k or 0 for k in row] for row in shown]]
        * has_pattern[..., None]
    )
    square, directions = np.linalg.eigh(waves.transpose(0, 2, 1) @ waves)
    free = square > 1e-9 * count
    freedom = has_pattern.sum(axis=1).astype(int) - free.sum(axis=1)
    return _Spaces(waves @ directions, np.where(free, square, 1.0), free, has_pattern, freedom)


def _decide(moments: Moments, plan: Plan) -> SyncVerdict:
    # A fault can be likelier at most by the misfit that it explains.
    explained = 2 * LIMITS.min_log_ratio * LIMITS.misfit_in_step**2
    if _signal_spaces(plan, LINEAR).residual(moments.all)[0] <= explained:
        return SyncVerdict(provable=provable(plan), misfit=_signal_spaces(plan, NONLINEAR).misfit(moments))
    named = tuple(considered_faults(plan.images))
    likelihood = _likelihood(moments, plan, named)
    misfit = _signal_spaces(plan, NONLINEAR).misfit(moments)
    best = likelihood.max()
    if _likelihood(moments, plan, own_offsets=True)[0] > best:
        changed = _signal_spaces(plan, NONLINEAR, own_offsets=True)
        return SyncVerdict(provable=provable(plan), misfit=changed.misfit(moments))
    causes: tuple[SyncFault, ...] = ()
    if best > likelihood[0] + LIMITS.min_log_ratio:
        likely = tuple(named[i - 1] for i in np.flatnonzero(likelihood > best - LIMITS.equal_log_ratio))
        causes = _explaining(moments, plan, likely)
    fits = bool(causes) or misfit <= LIMITS.misfit_foreign
    if not fits or (causes and all(fault.cause is Cause.FOREIGN for fault in causes)):
        swaps = _explaining(moments, plan, _swaps(moments, plan, float(best) + LIMITS.min_log_ratio))
        causes, fits = swaps or causes, fits or bool(swaps)
    return SyncVerdict(causes, fits=fits, provable=provable(plan) or bool(causes), misfit=misfit)


def _explaining(moments: Moments, plan: Plan, likely: tuple[SyncFault, ...]) -> tuple[SyncFault, ...]:
    """Those of the likeliest faults that explain what frames in step leave, and not a part of it."""
    misfit, *left = _signal_spaces(plan, NONLINEAR, likely).misfits(moments)
    return tuple(f for f, own in zip(likely, left, strict=True) if own <= LIMITS.max_left * misfit)


def _likelihood(
    moments: Moments, plan: Plan, named: tuple[SyncFault, ...] = (), own_offsets: bool = False
) -> Floats:
    """Likelihood of frames in step, and then of the faults named, by the response that suits each better."""
    spaces = (_signal_spaces(plan, harmonics, named, own_offsets) for harmonics in (LINEAR, NONLINEAR))
    return np.asarray(np.maximum(*(space.log_likelihoods(moments) for space in spaces)))


def _swaps(moments: Moments, plan: Plan, min_likelihood: float) -> tuple[SyncFault, ...]:
    """Exchanges of two distant frames that are likelier than a limit."""
    named = tuple(far_swaps(plan.images))
    likelihood = _likelihood(moments, plan, named)[1:]
    if not named or likelihood.max() <= min_likelihood:
        return ()
    return tuple(named[i] for i in np.flatnonzero(likelihood > likelihood.max() - LIMITS.equal_log_ratio))
