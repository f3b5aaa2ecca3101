"""How sharp camera and projector are, by region, and how sharp they have been."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.diagnosis.sample import FrameSample
from fpplab.setup.live.regions import REGIONS, region_medians, region_slices

AT_BEST_SHARE = 0.98  # of the best measure (chosen: noise alone changes it as much)


@dataclass(frozen=True, eq=False)
class FocusMeasure:
    """How sharp an image is."""

    regions: Floats  # by region; NaN where not known
    whole: float | None  # of the whole image; None where it is known of no region


UNKNOWN = FocusMeasure(np.full(REGIONS, np.nan), None)  # where nothing can be measured


def camera_sharpness(
    first_image: NDArray[np.floating[Any]], second_image: NDArray[np.floating[Any]]
) -> FocusMeasure:
    # one, other (height, width)
    by_region = np.full(REGIONS, np.nan)
    powers, levels = 0.0, 0.0
    for region, part in region_slices(first_image.shape):
        a, b = (image[part].astype(np.float64) for image in (first_image, second_image))
        level = float(a.mean() * b.mean())
        if level < (2.0 / 255.0) ** 2 or min(a.shape) < 3:  # darker than two grey levels
            continue
        power, sigma = _gradient_power(a, b)
        powers, levels = powers + max(power, 0.0) * a.size, levels + level * a.size
        if power > 4.0 * sigma:  # otherwise it has no texture to focus on
            by_region[region] = math.sqrt(power / level)
    any_known = np.isfinite(by_region).any()
    return FocusMeasure(by_region, math.sqrt(powers / levels) if any_known else None)


def _gradient_power(image: Floats, second_image: Floats) -> tuple[float, float]:
    """Mean square gradient that two images share, and its standard uncertainty by noise alone."""
    power, noises = 0.0, 0.0
    for axis in (0, 1):
        first, second = np.gradient(image, axis=axis), np.gradient(second_image, axis=axis)
        # About their means: light that falls off across the region is no texture.
        power += float(np.mean(first * second) - first.mean() * second.mean())
        noises += float(np.mean(np.square(first - second)))
    # Of products of two gradients with independent noise; neighbours share half of it.
    return power, noises / 2.0 * math.sqrt(2.0 / image.size)


def projector_contrast(sample: FrameSample) -> FocusMeasure:
    measured = sample.measured
    if not measured.any():
        return UNKNOWN
    fine = sample.fits[sample.recording.plan.finest_set()]
    ratio = fine.modulation / np.maximum(sample.widest.modulation, 1e-9)
    return FocusMeasure(region_medians(ratio, measured), float(np.median(ratio[measured])))


@dataclass(frozen=True, eq=False)
class FocusTracker:
    """A measure of focus, with the best so far."""

    now: FocusMeasure = UNKNOWN  # the latest
    best: Floats = field(default_factory=lambda: UNKNOWN.regions)  # the greatest of each region
    best_whole: float | None = None  # the greatest of the whole image

    def after(self, measure: FocusMeasure) -> FocusTracker:
        values = [value for value in (measure.whole, self.best_whole) if value is not None]
        return FocusTracker(measure, np.fmax(self.best, measure.regions), max(values, default=None))

    def forgotten(self) -> FocusTracker:
        return FocusTracker(self.now, self.now.regions, self.now.whole)

    @property
    def shares(self) -> Floats:
        """The latest of each region over its best, `REGIONS`; NaN where not known."""
        return np.asarray(self.now.regions / self.best)

    @property
    def share(self) -> float | None:
        """The latest of the whole image over its best; None where not known."""
        return self.now.whole / self.best_whole if self.now.whole is not None and self.best_whole else None

    def summary(self) -> dict[str, object]:
        share = self.share
        shares = [[None if np.isnan(x) else round(float(x), 3) for x in row] for row in self.shares]
        return {
            "now": self.now.whole,
            "best": self.best_whole,
            "share": share,
            "at_best": share is not None and share >= AT_BEST_SHARE,
            "regions": shares,
        }
