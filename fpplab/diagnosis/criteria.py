"""The named criteria of a verdict: what was measured on a scan, compared with what a good one has."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fpplab.clouds import Cloud
from fpplab.core.config import Positive
from fpplab.diagnosis.causes.stale_calibration import StaleCalibrationLimits
from fpplab.diagnosis.exposure import GreyLevelLimits
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, harmonics_of_power_law_rad, phase_ripples
from fpplab.diagnosis.limits import LimitsSection, ShareLimit
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.diagnosis.sample import FrameSample
from fpplab.phase import Decoded
from fpplab.phase.precision import coordinate_spread, uncertain_orders


class CriteriaLimits(LimitsSection):
    """What the figures of a good scan are."""

    section: ClassVar[str] = "criteria"

    min_points_share: ShareLimit = 0.5
    """Share of the pixels that see the fringes which become points. Chosen."""
    min_contrast: Positive = 0.1
    """Modulation of the finest fringes as a share of the mean level. Chosen."""
    max_uncertain_share: Positive = 0.2
    """Share of the pixels that see the fringes whose fringe order is too uncertain. Chosen."""
    max_noise_ratio: Positive = 15.0
    """Noise of the coordinate compared with that on a white surface, exposed as well as it can be. Chosen:
    dark parts have more than white ones."""


@dataclass(frozen=True)
class Criterion:
    """A figure of a scan, and its limit."""

    name: str  # A short key
    meaning: str  # what it is, for people
    value: float  # as measured
    limit: float  # of a good scan
    unit: str = ""  # of both; empty for shares and ratios
    at_least: bool = False  # whether the limit is the least value, and not the greatest

    @property
    def is_met(self) -> bool:
        """Whether the value is within its limit."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def sentence(self) -> str:
        """The criterion in words."""
        unit = f" {self.unit}" if self.unit else ""
        word = "at least" if self.at_least else "at most"
        return f"{self.meaning} is {self.value:.2g}{unit} ({word} {self.limit:.2g}{unit})"

    def summary(self) -> dict[str, object]:
        """Collect what is printed."""
        bound = {"least" if self.at_least else "most": self.limit}
        return {"name": self.name, "value": self.value, **bound, "unit": self.unit, "met": self.is_met}


def criteria_of(sample: FrameSample, decoded: Decoded, cloud: Cloud) -> tuple[Criterion, ...]:
    """Measure what a verdict is given by."""
    criteria = (*_of_points(sample, decoded, cloud), *_of_fringes(sample, decoded))
    return tuple(criterion for criterion in criteria if math.isfinite(criterion.value))


def _of_points(sample: FrameSample, decoded: Decoded, cloud: Cloud) -> Iterator[Criterion]:
    limits = sample.limits.of(CriteriaLimits)
    seeing = sample.estimate_pixels_seeing_fringes(cloud)
    share = len(cloud) / seeing
    meaning = "the share of the pixels that see the fringes which became points"
    yield Criterion("points", meaning, share, limits.min_points_share, at_least=True)
    lost = uncertain_orders(decoded, sample.recording.plan)
    if lost is not None:
        share = min(sum(lost.values()) / seeing, 1.0)
        meaning = "the share of pixels left out for their uncertain fringe order"
        yield Criterion("wrong_order_risk", meaning, share, limits.max_uncertain_share)
    if (off := systematic_epipolar_px(cloud)) is not None:
        meaning = "the distance of points from their epipolar lines"
        max_px = sample.limits.of(StaleCalibrationLimits).max_epipolar_px
        yield Criterion("epipolar_residual", meaning, off, max_px, "px")


def _of_fringes(sample: FrameSample, decoded: Decoded) -> Iterator[Criterion]:
    if not sample.measured.any():
        return
    limits = sample.limits.of(CriteriaLimits)
    plan, used = sample.recording.plan, sample.measured
    finest = plan.finest_set()
    fit = sample.fits[finest]
    contrast = float(np.median(fit.modulation[used] / np.maximum(fit.offset[used], 1.0)))
    yield Criterion(
        "contrast", "the contrast of the finest fringes", contrast, limits.min_contrast, at_least=True
    )
    harmonic_rad = max(harmonics_of_power_law_rad(sample), *phase_ripples(sample), 0.0)
    limit = max(sample.limits.of(FringeShapeLimits).min_harmonic_rad, sample.phase_noise(finest))
    yield Criterion("waves", "the phase error of harmonics of the fringes", harmonic_rad, limit, "rad")
    best = 0.5 * sample.limits.of(GreyLevelLimits).best_peak_share * 255.0
    noise = math.sqrt(float(sample.errors.noise.variance(best))) / best
    planned = noise * coordinate_spread(plan, plan.axes[0], sample.recording.projector_size)
    sigma = decoded.sigma[:: sample.step, :: sample.step]
    finite = sigma[np.isfinite(sigma)]
    if finite.size and planned > 0.0:
        meaning = "the noise of the coordinate compared with that which the plan has on a white surface"
        ratio = float(np.median(finite)) / planned
        yield Criterion("uncertainty", meaning, ratio, limits.max_noise_ratio)
