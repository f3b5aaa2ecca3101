"""The named criteria of a verdict: what was measured on a scan, compared with what a good one has."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fpplab.clouds import Cloud
from fpplab.core.config import Positive
from fpplab.diagnosis.causes.stale_calibration import max_epipolar_px
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, harmonics_of_power_law_rad, phase_ripples
from fpplab.diagnosis.limits import LimitsSection, ShareLimit
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.diagnosis.sample import FrameSample
from fpplab.diagnosis.visibility import GreyLevelLimits
from fpplab.phase import Decoded
from fpplab.phase.common_errors import beyond_fringe
from fpplab.phase.precision import coordinate_spread, uncertain_orders


class CriteriaLimits(LimitsSection):
    """What the figures of a good scan are."""

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
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def sentence(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        word = "at least" if self.at_least else "at most"
        return f"{self.meaning} is {self.value:.2g}{unit} ({word} {self.limit:.2g}{unit})"

    def summary(self) -> dict[str, object]:
        bound = {"least" if self.at_least else "most": self.limit}
        return {"name": self.name, "value": self.value, **bound, "unit": self.unit, "met": self.is_met}


def criteria_of(sample: FrameSample, decoded: Decoded, cloud: Cloud | None) -> tuple[Criterion, ...]:
    """Measure what a verdict is given by, on points or on maps alone."""
    criteria = (*_of_points(sample, decoded, cloud), *_of_fringes(sample, decoded))
    return tuple(criterion for criterion in criteria if math.isfinite(criterion.value))


def left_out(sample: FrameSample, decoded: Decoded) -> str:
    """Say by which mask the pixels that see the fringes are not measured, most first; empty where all are."""
    rules, plan = sample.recording.plan.masks, sample.recording.plan
    masks = {"saturated": sample.saturated}
    if decoded.uncertain_order is not None:
        masks["of an uncertain fringe order"] = decoded.uncertain_order[:: sample.step, :: sample.step] > 0
    faint, shallow, bent = (np.zeros(sample.lit.shape, np.bool_) for _ in range(3))
    for k, (fit, fringe) in enumerate(zip(sample.fits, plan.fringes, strict=True)):
        faint |= fit.modulation < rules.modulation_min
        shallow |= fit.modulation < rules.contrast_min * fit.offset
        images = sample.spread[plan.set_starts[k] : plan.set_starts[k + 1]]
        rest = np.einsum("mn,nij->mij", beyond_fringe(fringe.phase_shifts()), images)
        limit = rules.residual_max**2 + sample.errors.sets[k].misfit
        bent |= np.square(rest).mean(axis=0) > limit * np.square(fit.modulation)
    masks |= {"faint": faint, "of low contrast": shallow, "no sinusoids": bent}
    lost = sample.lit & ~decoded.valid[:: sample.step, :: sample.step]
    shares, total = {}, max(int(lost.sum()), 1)
    for name, mask in masks.items():
        shares[name] = (lost & mask).sum() / total
        lost = lost & ~mask
    shares["with sets that contradict each other"] = lost.sum() / total
    shown = sorted((name for name in shares if shares[name] >= 0.005), key=lambda name: -shares[name])
    return ", ".join(f"{shares[name]:.0%} are {name}" for name in shown)


def _of_points(sample: FrameSample, decoded: Decoded, cloud: Cloud | None) -> Iterator[Criterion]:
    limits = sample.limits.of(CriteriaLimits)
    seeing = max(sample.estimate_pixels_seeing_fringes(decoded if cloud is None else cloud), 1.0)
    share = (int(decoded.valid.sum()) if cloud is None else len(cloud)) / seeing
    became = "are measured" if cloud is None else "became points"
    meaning = f"the fraction of the pixels with fringes that {became}"
    yield Criterion("points", meaning, share, limits.min_points_share, at_least=True)
    lost = uncertain_orders(decoded, sample.recording.plan)
    if lost is not None:
        share = min(sum(lost.values()) / seeing, 1.0)
        meaning = "the fraction of pixels discarded because their fringe order is uncertain"
        yield Criterion("wrong_order_risk", meaning, share, limits.max_uncertain_share)
    if cloud is not None and (off := systematic_epipolar_px(cloud)) is not None:
        meaning = "the distance of points from their epipolar lines"
        max_px = max_epipolar_px(sample.limits, decoded)
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
        meaning = "the noise of the coordinate relative to that on a white surface"
        ratio = float(np.median(finite)) / planned
        yield Criterion("uncertainty", meaning, ratio, limits.max_noise_ratio)
