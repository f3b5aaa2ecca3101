"""Limits of the exposure, and by what to multiply it."""

import math
from typing import ClassVar

import numpy as np

from fpplab.core.config import Positive
from fpplab.diagnosis.limits import LimitsSection, PercentileLimit, ShareLimit
from fpplab.diagnosis.sample import FrameSample


class GreyLevelLimits(LimitsSection):
    """Between which grey levels lit pixels should lie."""

    section: ClassVar[str] = "exposure"

    max_saturated_share: ShareLimit = 0.05
    """Share of the lit pixels that may be saturated. Chosen: highlights."""
    min_peak_share: ShareLimit = 0.07
    """Share of full scale that the brightest lit pixels should reach. Measured on benches of the limits."""
    best_peak_share: ShareLimit = 0.9
    """Share of full scale that the brightest lit pixels reach at the best exposure. Chosen."""
    brightest_percentile: PercentileLimit = 90.0
    """Percentile of the lit pixels' mean level that determines how far an exposure must be
    lowered. Chosen."""
    min_dimming: Positive = 0.1
    """Least factor of an exposure that saturates. Chosen: two steps correct one that is eight times too
    long."""
    max_dimming: ShareLimit = 0.9
    """Greatest factor of an exposure that saturates. Chosen."""


def dimming_factor(sample: FrameSample) -> float:
    """Estimate the factor of the exposure by which the brightest lit pixels reach their best level."""
    # A fringe that swings from dark to p times full scale is saturated for the share s of its phases with 1/p
    # = (1 + cos πs)/2. Where all images of a pixel are saturated it is unknown by how much.
    limits = sample.limits.of(GreyLevelLimits)
    levels = sample.spread[:, sample.lit]
    mean = levels.mean(axis=0)
    brightest = levels[:, mean >= np.percentile(mean, limits.brightest_percentile)]
    share = float(np.mean(brightest >= sample.recording.grey * sample.errors.saturation))
    within = 0.5 + 0.5 * math.cos(math.pi * share)
    return min(max(limits.best_peak_share * within, limits.min_dimming), limits.max_dimming)
