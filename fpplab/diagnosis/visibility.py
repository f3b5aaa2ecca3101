"""How clearly frames show fringes: whether the projector lights what the camera sees."""

from dataclasses import dataclass

import numpy as np

from fpplab.core.config import Positive
from fpplab.diagnosis.exposure import GreyLevelLimits
from fpplab.diagnosis.limits import CountLimit, LimitsSection
from fpplab.diagnosis.sample import FrameSample


class VisibilityLimits(LimitsSection):
    """When fringes count as seen; distinguishes darkness, weak light and a small field."""

    min_fringe_sigmas: Positive = 15.0
    """Modulation of the strongest fringes, as a multiple of its noise; weaker ones without coherence are
    none. Measured on benches of the limits."""
    min_coherence: Positive = 0.15
    """Share of the modulation's power that neighbours have in common; of noise it is about 0. Measured on
    benches of the limits."""
    min_clear_sigmas: Positive = 25.0
    """Modulation as a multiple of its noise above which fringes are certain. Measured on benches of the
    limits."""
    min_modulation: Positive = 0.5
    """Modulation in grey levels of 255 below which there are no fringes, whatever the noise. Derived:
    rounding to grey levels."""
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
