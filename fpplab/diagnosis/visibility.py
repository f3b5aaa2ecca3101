"""How clearly frames show fringes, whether the projector lights what the camera sees, and the exposure."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fpplab.core.config import Positive
from fpplab.diagnosis.limits import CountLimit, LimitsSection, PercentileLimit, ShareLimit
from fpplab.diagnosis.sample import FrameSample


class GreyLevelLimits(LimitsSection):
    """Between which grey levels lit pixels should lie."""

    section: ClassVar[str] = "exposure"

    max_saturated_share: ShareLimit = 0.05
    """Share of the lit pixels that may be saturated. Chosen: highlights."""
    min_peak_share: ShareLimit = 0.07
    """Share of full scale that the brightest lit pixels should reach. Measured on benches."""
    best_peak_share: ShareLimit = 0.9
    """Share of full scale that the brightest lit pixels reach at the best exposure. Chosen."""
    brightest_percentile: PercentileLimit = 90.0
    """Percentile of the lit pixels' mean level that decides how far exposure is lowered. Chosen."""
    min_dimming: Positive = 0.1
    """Least factor of an exposure that saturates. Chosen: two steps correct one eight times too long."""
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


class VisibilityLimits(LimitsSection):
    """When fringes count as seen; distinguishes darkness, weak light and a small field."""

    min_fringe_sigmas: Positive = 15.0
    """Modulation of the strongest fringes, as a multiple of its noise; weaker ones without coherence are
    none. Measured on benches."""
    min_coherence: Positive = 0.15
    """Share of the modulation's power that neighbours share; of noise it is about 0. Measured on benches."""
    min_clear_sigmas: Positive = 25.0
    """Modulation as a multiple of its noise above which fringes are certain. Measured on benches."""
    min_modulation: Positive = 0.5
    """Modulation in grey levels of 255 below which there are no fringes. Derived: rounding."""
    min_tiny_part_pixels: CountLimit = 4
    """Pixels of the sample that see clear fringes, of a part that is tiny in the image. Chosen."""
    min_lit_share: Positive = 0.03
    """Share of the image that the fringes should light. Chosen: a part of a sixth of its width and height."""


@dataclass(frozen=True)
class Visibility:
    """Strength of the fringes in the frames, and where they are."""

    strength: float  # modulation of the strongest fringes as a multiple of its noise
    lit_share: float  # share of the image that sees fringes
    is_dark: bool  # whether there are no fringes
    is_weak: bool  # whether they cannot be distinguished from the dark in most of the image
    tiny_part_share: float | None  # share of the image with clear fringes where all else is dark or weak
    limits: VisibilityLimits


def visibility(sample: FrameSample) -> Visibility:
    limits = sample.limits.of(VisibilityLimits)
    noise = float(np.median(sample.noise(sample.widest.offset)))
    strength, share = sample.strongest / noise, float(sample.lit.mean())
    incoherent = strength < limits.min_fringe_sigmas and sample.coherence < limits.min_coherence
    most_saturated = sample.limits.of(GreyLevelLimits).max_saturated_share
    dark = (incoherent or sample.strongest < limits.min_modulation) and (
        sample.saturated.mean() <= most_saturated
    )
    weak = share < limits.min_lit_share and strength < limits.min_clear_sigmas
    tiny_share = _tiny_part_share(sample, limits) if dark or weak else None
    return Visibility(strength, share, bool(dark), weak, tiny_share, limits)


def _tiny_part_share(sample: FrameSample, limits: VisibilityLimits) -> float | None:
    """Share of the pixels that do see fringes, of every set, where all others are dark."""
    strengths = [fit.modulation / sample.noise(fit.offset) for fit in sample.fits]
    seeing = np.min(strengths, axis=0) >= limits.min_clear_sigmas
    seeing &= np.min([fit.modulation for fit in sample.fits], axis=0) >= limits.min_modulation
    return float(seeing.mean()) if np.count_nonzero(seeing) >= limits.min_tiny_part_pixels else None
