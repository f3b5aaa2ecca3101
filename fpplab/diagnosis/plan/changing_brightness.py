"""Tell whether a camera that sets its brightness by itself explains why frames do not show their patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Floats, Image, phase_steps
from fpplab.diagnosis.plan.limits import GUESS_LIMITS, GuessLimits
from fpplab.diagnosis.plan.other_patterns import lit_levels

ITERATIONS = 20  # of gains and offsets in turn (chosen)


def describe_changing_brightness(
    frames: Sequence[Image], full: int, sizes: Sequence[int], limits: GuessLimits = GUESS_LIMITS
) -> str | None:
    """Say in which fringe sets frames are sinusoids of different brightness; None where anything else is."""
    # frames (height, width)
    levels = lit_levels(frames, full, limits)
    if levels is None:
        return None
    starts = np.cumsum([0, *sizes])
    fits = {
        k: _BrightnessFit.of(levels[starts[k] : starts[k] + count])
        for k, count in enumerate(sizes)
        if count > 3  # three images fit any brightness
    }
    if not all(fit.is_explained(limits) for fit in fits.values()):
        return None
    changing = [k for k, fit in fits.items() if fit.is_changing(limits)]
    if not changing:
        return None
    worst = max(changing, key=lambda k: fits[k].change)
    return (
        f"the brightness changes from frame to frame, by {100 * fits[worst].change:.0f} % RMS in "
        f"'fringes[{worst}]': a gain and an offset for each frame make them equal; switch the camera's "
        "automatic exposure, gain and contrast off, save images without stretching them to their range, and "
        "record again"
    )


@dataclass(frozen=True, eq=False)
class _BrightnessFit:
    """Sinusoids with equal steps, each frame times a gain and plus an offset."""

    gains: Floats  # (N,), mean 1
    unchanged_misfit: float  # mean square that equal brightness leaves
    misfit: float  # mean square that gains and offsets leave
    variance: float  # of the sinusoids

    @classmethod
    def of(cls, levels: Floats) -> _BrightnessFit:
        # levels (N, P)
        shifts = phase_steps(len(levels))
        waves = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
        gains, offsets = np.ones((len(levels), 1)), np.zeros((len(levels), 1))
        misfits = []
        for _ in range(ITERATIONS):
            plain = waves @ np.linalg.lstsq(waves * gains, levels - offsets, rcond=None)[0]
            misfits.append(float(np.mean((levels - offsets - gains * plain) ** 2)))
            mean = plain.mean(axis=1, keepdims=True)
            changes = plain - mean
            gains = np.sum(changes * levels, axis=1, keepdims=True) / np.sum(
                changes**2, axis=1, keepdims=True
            )
            gains /= gains.mean()
            offsets = levels.mean(axis=1, keepdims=True) - gains * mean
            offsets -= offsets.mean()
        return cls(gains.ravel(), misfits[0], misfits[-1], float(np.mean(np.var(plain, axis=0))))

    @property
    def change(self) -> float:
        """Standard deviation of the gains."""
        return float(np.std(self.gains))

    def is_explained(self, limits: GuessLimits) -> bool:
        """Whether the images are sinusoids but for their brightness."""
        is_possible = self.gains.min() > limits.min_gain
        return bool(is_possible and self.misfit <= limits.max_unexplained * self.variance)

    def is_changing(self, limits: GuessLimits) -> bool:
        """Whether gains and offsets explain most of what equal brightness leaves."""
        is_better = self.unchanged_misfit > limits.min_explained_ratio * self.misfit
        return is_better and self.change > limits.min_gain_change
