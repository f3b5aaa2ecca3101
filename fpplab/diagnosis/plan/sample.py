"""Phases of every fringe set at some pixels, and how fast they change along the image.

How fast the phase of a set changes from pixel to pixel depends on its stripes, its axis and the sign of its
steps, and on no phase origin. Relative to another set's it distinguishes them on any surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats, Image, Mask, phase_steps
from fpplab.diagnosis.plan.bend import MAX_UNEVENNESS, Bend
from fpplab.diagnosis.plan.limits import PlanCheckLimits

LAGS = (1, 2, 4, 8, 16, 32, 64)  # distances in px over which phases are compared

MIN_STEPS = 3
"""Fewest images of a set. Derived: a sinusoid has three unknowns."""


@dataclass(frozen=True, eq=False)
class PhaseSample:
    """Phases of S sets at P pixels that see all of them."""

    phases: Floats  # in rad, as if every set had equal steps, no origin, and the usual sign
    gradients: Floats  # change of phase in rad per px to the right and down
    rows: tuple[slice, slice]  # which pixels of a frame the sample was taken from
    lit: Mask  # of those, the P pixels
    limits: PlanCheckLimits  # that the plan is checked by

    @classmethod
    def of(
        cls,
        frames: Sequence[Image],
        images: Sequence[int],
        full_scale: int,
        limits: PlanCheckLimits | None = None,
        bends: Sequence[Bend] | None = None,
    ) -> PhaseSample | None:
        """Measure phases at pixels spread over the image, straightened by the bend of each set."""
        # frames (height, width)
        limits = limits or PlanCheckLimits()
        height, width = frames[0].shape
        step = max(1, int(np.sqrt(height * width / limits.pixels)))
        lags = [lag for lag in LAGS if 4 * lag < min(height, width)]
        rows = slice(0, height - lags[-1], step), slice(0, width - lags[-1], step)
        here = _phasors(frames, images, rows, (0, 0), bends)
        strength = np.abs(here)
        strongest = np.quantile(strength, 0.95, axis=(1, 2), keepdims=True)
        lowest = np.maximum(limits.min_lit_share * strongest, limits.min_lit_level * full_scale / 255)
        lit = np.all(strength >= lowest, axis=0)
        lit &= np.max([frame[rows] for frame in frames], axis=0) < full_scale
        if lit.sum() < limits.min_lit_pixels:
            return None
        if np.any(_coherence(frames, images, rows, lit) < limits.min_coherence):
            return None
        gradients = np.zeros((*here[:, lit].shape, 2))
        for axis in (0, 1):
            usable = np.ones(len(images), np.bool_)
            for lag in lags:
                shifted = _phasors(frames, images, rows, (0, lag) if axis == 0 else (lag, 0), bends)
                turn = np.angle(shifted[:, lit] * here[:, lit].conj())
                usable &= (np.median(np.abs(turn), axis=1) <= limits.max_turn_rad) | (lag == lags[0])
                gradients[usable, :, axis] = turn[usable] / lag
        return cls(np.angle(here)[:, lit], gradients, rows, lit, limits)

    def has_speed(self, k: int, images: int) -> bool:
        """Whether the phase of a set of these images changes as its stripes say, under any response."""
        # Three images bend phases three times in a period; over phases that are spread evenly this averages.
        return images > MIN_STEPS or abs(np.mean(np.exp(1j * self.phases[k]))) < MAX_UNEVENNESS


def _phasors(
    frames: Sequence[Image],
    images: Sequence[int],
    rows: tuple[slice, slice],
    offset: tuple[int, int],
    bends: Sequence[Bend] | None = None,
) -> Floats:
    """Sum of each set's frames times exp(iδ_n), (S, rows, columns), some pixels further on."""
    moved = tuple(
        slice(part.start + by, part.stop + by, part.step) for part, by in zip(rows, offset, strict=True)
    )
    starts = np.cumsum([0, *images])
    sums = []
    for (first, end), count in zip(pairwise(starts), images, strict=True):
        levels = np.stack([frame[moved] for frame in frames[first:end]]).astype(np.float64)
        sums.append(np.tensordot(np.exp(1j * phase_steps(count)), levels, 1) * (2.0 / count))
    if bends is not None:
        sums = [
            np.abs(phasor) * np.exp(1j * bend.straightened(np.angle(phasor), count))
            for phasor, bend, count in zip(sums, bends, images, strict=True)
        ]
    return np.stack(sums)


def _coherence(
    frames: Sequence[Image], images: Sequence[int], rows: tuple[slice, slice], lit: Mask
) -> Floats:
    """How well the phases (S,) of three neighbours in a row lie on a line: 1 for fringes, 0 for noise."""
    left, middle, right = (np.angle(_phasors(frames, images, rows, (0, k))[:, lit]) for k in range(3))
    return np.asarray(np.cos(left - 2.0 * middle + right).mean(axis=1))


def wrapped(phase: Floats) -> Floats:
    return np.asarray((phase + np.pi) % TWO_PI - np.pi)


@dataclass(frozen=True)
class Direction:
    """How a set's phase changes relative to that of another, the reference."""

    along: float  # change along the reference's gradient and across it, as shares of the reference's
    across: float  # change along the reference's gradient and across it, as shares of the reference's
    right: float  # typical change in rad per px to the right and down
    down: float  # typical change in rad per px to the right and down

    @property
    def parallel(self) -> bool:
        """Whether the set codes the same axis as the reference."""
        return abs(self.along) > abs(self.across)

    @property
    def speed(self) -> float:
        """Change of the phase in rad per px, whatever its direction."""
        return float(np.hypot(self.right, self.down))

    @property
    def level(self) -> bool:
        """Whether the phase changes along the rows of the image rather than down."""
        return abs(self.right) >= abs(self.down)

    def way(self, level: bool) -> Literal[1, -1]:
        return 1 if (self.right if level else self.down) > 0 else -1


def gradient_directions(sample: PhaseSample, reference: int) -> list[Direction]:
    u, v = sample.gradients[reference].T
    square = np.maximum(u * u + v * v, 1e-12)
    compared = []
    for gradient in sample.gradients:
        right, down = gradient.T
        along, across = (right * u + down * v) / square, (down * u - right * v) / square
        compared.append(Direction(*(float(np.median(each)) for each in (along, across, right, down))))
    return compared
