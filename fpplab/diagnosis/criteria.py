"""The named criteria of a verdict: what was measured on a scan, beside what a good one has."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fpplab.clouds import Cloud
from fpplab.diagnosis.fringe_shape import ripples
from fpplab.diagnosis.geometry import MOST_EPIPOLAR_PX, systematic_epipolar_px
from fpplab.diagnosis.light import BEST_PEAK, LEAST_HARMONIC_RAD
from fpplab.diagnosis.sample import FrameSample
from fpplab.phase import Decoded
from fpplab.phase.precision import coordinate_spread, uncertain_orders

LEAST_POINTS = 0.5
"""Share of the pixels that see the fringes which become points."""

LEAST_CONTRAST = 0.1
"""Modulation of the finest fringes as a share of the mean level."""

MOST_UNCERTAIN = 0.2
"""Share of the pixels that see the fringes whose fringe order is too uncertain."""

MOST_NOISE = 15.0
"""Noise of the coordinate beside a white surface, exposed as well as it can be: dark parts have more."""


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
        least = {"least" if self.at_least else "most": self.limit}
        return {"name": self.name, "value": self.value, **least, "unit": self.unit, "met": self.is_met}


def criteria_of(sample: FrameSample, decoded: Decoded, cloud: Cloud) -> tuple[Criterion, ...]:
    """Measure what a verdict is given by."""
    found = (*_of_points(sample, decoded, cloud), *_of_fringes(sample, decoded))
    return tuple(one for one in found if math.isfinite(one.value))


def _of_points(sample: FrameSample, decoded: Decoded, cloud: Cloud) -> Iterator[Criterion]:
    seeing = sample.pixels_seeing_fringes(cloud)
    share = len(cloud) / seeing
    yield Criterion(
        "points", "the share of the pixels that see the fringes which became points", share, LEAST_POINTS,
        at_least=True,
    )  # fmt: skip
    lost = uncertain_orders(decoded, sample.recording.plan)
    if lost is not None:
        share = min(sum(lost.values()) / seeing, 1.0)
        yield Criterion(
            "wrong_order_risk", "the share of pixels left out for their uncertain fringe order", share,
            MOST_UNCERTAIN,
        )  # fmt: skip
    if (off := systematic_epipolar_px(cloud)) is not None:
        meaning = "the distance of points from their epipolar lines"
        yield Criterion("epipolar_residual", meaning, off, MOST_EPIPOLAR_PX, "px")


def _of_fringes(sample: FrameSample, decoded: Decoded) -> Iterator[Criterion]:
    if not sample.measured.any():
        return
    plan, used = sample.recording.plan, sample.measured
    finest = plan.finest_set()
    fit = sample.fits[finest]
    contrast = float(np.median(fit.modulation[used] / np.maximum(fit.offset[used], 1.0)))
    yield Criterion(
        "contrast", "the contrast of the finest fringes", contrast, LEAST_CONTRAST, at_least=True
    )  # fmt: skip
    phase_noise = sample.phase_noise(finest)
    bent = [float(np.nan_to_num(sample.errors.sets[finest].harmonic_rad)), *ripples(sample)]
    limit = max(LEAST_HARMONIC_RAD, phase_noise)
    yield Criterion("waves", "the phase error of harmonics of the fringes", max(bent), limit, "rad")
    axis = plan.axes[0]
    best = 0.5 * BEST_PEAK * 255.0
    noise = math.sqrt(float(sample.errors.noise.variance(best))) / best
    planned = noise * coordinate_spread(plan, axis, sample.recording.projector_size)
    sigma = decoded.sigma[:: sample.step, :: sample.step]
    known = sigma[np.isfinite(sigma)]
    if known.size and planned > 0.0:
        meaning = "the noise of the coordinate beside that which the plan has on a white surface"
        yield Criterion("uncertainty", meaning, float(np.median(known)) / planned, MOST_NOISE)
