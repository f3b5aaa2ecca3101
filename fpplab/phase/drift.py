"""How fast the projector's picture walks over the scene while a recording is taken.

A picture that walks evenly adds a ramp to the phases of the frames of a set. What its frames show beside a
sinusoid, gains and harmonics tells this ramp, since the same few numbers rule all pixels; its mean, by which
the coordinate is displaced, they do not show. A ramp is told from vibration by how evenly the frames
follow it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import stdtr

from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, axis_length
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase.common_errors import beyond_fringe, fit_sinusoids, fringe_levels
from fpplab.phase.limits import DRIFT


@dataclass(frozen=True)
class PointingDrift:
    """A drift of the projector's picture along one axis."""

    px_per_frame: float  # in px of the projector
    sigma_px: float  # standard uncertainty of it
    frames: float  # from the first frame to the mean of the finest set

    @property
    def shift_px(self) -> float:
        """By how much the coordinate is displaced since the first frame."""
        return self.px_per_frame * self.frames


@dataclass(frozen=True, eq=False)
class _Modes:
    """Combinations of a set's frames whose displacement is seen."""

    displaced: Floats  # (K,) px
    variances: Floats  # (K,) px² by noise
    frames: Floats  # (K,) the same combinations of the frames' numbers


def pointing_drifts(samples: Sequence[Image], recording: Recording) -> dict[Axis, PointingDrift]:
    """Measure drifts by axis, where chance and vibration do not explain them."""
    # samples (N, P) raw values of each set
    plan, drifts = recording.plan, dict[Axis, PointingDrift]()
    for axis in plan.axes:
        size, modes = axis_length(recording.projector_size, axis), []
        for k in _fine_sets(plan, axis):
            period = size / plan.fringes[k].stripes
            sample = recording.grey * samples[k].astype(np.float64)
            modes += _modes_of_set(sample, plan.fringes[k], plan.masks.modulation_min, period)
        modes += _modes_of_repeats(samples, recording, axis)
        slope, sigma, freedom = _even_motion(modes)
        if freedom > 0 and 2.0 * stdtr(freedom, -abs(slope) / sigma) < DRIFT.max_chance:
            finest = [
                k for k in plan.sets_along(axis) if plan.fringes[k] == plan.fringes[plan.finest_set(axis)]
            ]
            drifts[axis] = PointingDrift(slope, sigma, float(np.mean([_middle(plan, k) for k in finest])))
    return drifts


def can_show_drift(plan: Plan) -> bool:
    """Tell whether frames of a plan show drift along its first axis."""
    sets = [plan.fringes[k] for k in _fine_sets(plan, plan.axes[0])]
    return any(fringe.images >= DRIFT.min_steps or sets.count(fringe) > 1 for fringe in sets)


def _fine_sets(plan: Plan, axis: Axis) -> list[int]:
    """Sets of fringes about as fine as the finest: what a response leaves of wide ones hides drift."""
    min_stripes = DRIFT.min_stripes_share * plan.fringes[plan.finest_set(axis)].stripes
    return [k for k in plan.sets_along(axis) if plan.fringes[k].stripes >= min_stripes]


def phase_ramp(drift: PointingDrift, fringe: FringeSet, size: int) -> Floats:
    """By how much the phase of each frame of a set lies beside that of their mean, (N,) in rad."""
    frames = np.arange(fringe.images) - 0.5 * (fringe.images - 1)
    return np.asarray(TWO_PI * fringe.stripes / size * drift.px_per_frame * frames)


def ramp_error_rad(ramp: Floats, fringe: FringeSet) -> float:
    """RMS phase error of a set, twice in a period, by the ramp of its frames' phases."""
    turns = np.exp(2j * fringe.phase_shifts())
    return float(np.abs(ramp @ turns) / fringe.images / np.sqrt(2.0))


def without_ramp(sample: Floats, fringe: FringeSet, ramp: Floats) -> Floats:
    """Frames as they would be if the picture had stood still while the set was taken."""
    # sample (N, P); ramp (N,) rad
    by_phase = fringe_levels(fit_sinusoids(sample, fringe), fringe.phase_shifts())[1]
    return np.asarray(sample - ramp[:, None] * by_phase)


def _middle(plan: Plan, k: int) -> float:
    return 0.5 * (plan.set_starts[k] + plan.set_starts[k + 1] - 1)


def _modes_of_repeats(samples: Sequence[Image], recording: Recording, axis: Axis) -> list[_Modes]:
    """Compare the frames of sets that a plan shows twice: each pair shows the motion between them."""
    plan, modes = recording.plan, []
    for first, again in combinations(_fine_sets(plan, axis), 2):
        fringe = plan.fringes[first]
        if fringe != plan.fringes[again]:
            continue
        before, after = (recording.grey * samples[k].astype(np.float64) for k in sorted((first, again)))
        fitted = fit_sinusoids(0.5 * (before + after), fringe)
        bright = np.flatnonzero(np.hypot(fitted[1], fitted[2]) >= max(plan.masks.modulation_min, 1.0))
        if len(bright) < DRIFT.min_pixels:
            continue
        levels, by_phase = fringe_levels(fitted[:, bright], fringe.phase_shifts())
        change = (after - before)[:, bright]
        fits = [
            _displaced(c, np.stack([slope, level, np.ones_like(level)]))
            for c, slope, level in zip(change, by_phase, levels, strict=True)
        ]
        rad, variances = np.array(fits).T
        to_px = axis_length(recording.projector_size, axis) / fringe.stripes / TWO_PI
        apart = abs(_middle(plan, again) - _middle(plan, first))
        modes.append(_Modes(to_px * rad, to_px**2 * variances, np.full(len(rad), apart)))
    return modes


def _displaced(change: Floats, terms: Floats) -> tuple[float, float]:
    """The first of the factors (3,) by which terms (3, P) make a change (P,), and its variance."""
    inverse = np.linalg.inv(np.einsum("ip,jp->ij", terms, terms))
    best = inverse @ np.einsum("ip,p->i", terms, change)
    return float(best[0]), float(inverse[0, 0] * np.mean((change - best @ terms) ** 2))


def _even_motion(modes: Sequence[_Modes]) -> tuple[float, float, int]:
    """Displacement by frame, its standard uncertainty, and the degrees of freedom of that."""
    if not modes:
        return 0.0, 1.0, 0
    y, noise, x = (
        np.concatenate([getattr(m, name) for m in modes]) for name in ("displaced", "variances", "frames")
    )
    freedom, scatter = len(y) - 1, 0.0
    for _ in range(DRIFT.scatter_passes):  # beside noise, each frame may lie elsewhere, as by vibration
        weight = 1.0 / (noise + scatter + 1e-12)  # frames without noise
        slope = float(np.sum(weight * x * y) / np.sum(weight * x * x))
        square = float(np.sum(weight * (y - slope * x) ** 2))
        scatter = max(scatter + (square - freedom) / float(weight.sum()), 0.0)
    worse = max(square / max(freedom, 1), 1.0)
    return slope, float(np.sqrt(worse / np.sum(weight * x * x))), freedom


def _modes_of_set(sample: Floats, fringe: FringeSet, modulation_min: float, period_px: float) -> list[_Modes]:
    shift = fringe.phase_shifts()
    fitted = fit_sinusoids(sample, fringe)
    bright = np.flatnonzero(np.hypot(fitted[1], fitted[2]) >= max(modulation_min, 1.0))
    bright = bright[:: max(1, len(bright) // DRIFT.max_pixels)]
    if len(shift) < DRIFT.min_steps or len(bright) < DRIFT.min_pixels:
        return []
    projection, count = beyond_fringe(shift), len(shift)
    for _ in range(DRIFT.fit_passes):
        frames, common = _causes_of_misfit(fitted[:, bright], shift)
        rest = projection @ sample[:, bright]
        normal, right = _equations(frames, common, rest, projection)
        best = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ right
        explained = np.einsum("kn,knp->np", best[: 2 * count].reshape(2, count), frames)
        left = rest - projection @ (explained + np.einsum("h,hnp->np", best[2 * count :], common))
        power = np.square(left).sum(axis=0)
        bright = bright[power <= DRIFT.outlier_ratio * np.median(power)]
    variance = float(power.mean()) / (count - 3)
    own, others = slice(0, count), slice(count, None)
    through = normal[own, others] @ np.linalg.pinv(normal[others, others], rcond=1e-9, hermitian=True)
    information = normal[own, own] - through @ normal[others, own]
    strength, directions = np.linalg.eigh(information)
    observable = strength > 1e-6 * strength[-1]
    modes, strength = directions[:, observable].T, strength[observable]
    rad_to_px = period_px / TWO_PI
    displaced = rad_to_px * modes @ (right[own] - through @ right[others]) / strength
    return [_Modes(displaced, rad_to_px**2 * variance / strength, modes @ np.arange(count))]


def _causes_of_misfit(waves: Floats, shift: Floats) -> tuple[Floats, Floats]:
    """What displacement and gain do to frames, (2, N, P), and harmonics of the response, (4, N, P)."""
    levels, by_phase = fringe_levels(waves, shift)
    wave = waves[1] + 1j * waves[2]
    phasor = wave / np.maximum(np.abs(wave), 1e-9)
    bent = [np.exp(-1j * k * shift)[:, None] * wave * phasor ** (k - 1) for k in (2, 3)]
    return np.stack([by_phase, levels]), np.stack([part for w in bent for part in (w.real, w.imag)])


def _equations(frames: Floats, common: Floats, rest: Floats, projection: Floats) -> tuple[Floats, Floats]:
    """Normal equations of displacement and gain of each frame, and of harmonics."""
    shown = projection @ common
    corner = np.block([[projection * np.einsum("np,mp->nm", a, b) for b in frames] for a in frames])
    side = np.einsum("knp,hnp->knh", frames, shown).reshape(len(corner), -1)
    normal = np.block([[corner, side], [side.T, np.einsum("gnp,hnp->gh", shown, common)]])
    right = np.einsum("knp,np->kn", frames, rest).ravel()
    return normal, np.concatenate([right, np.einsum("hnp,np->h", common, rest)])
