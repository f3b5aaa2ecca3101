"""Brightness of whole frames, which neither fringes nor harmonics of the response should change."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.core.remembered import remembered
from fpplab.diagnosis.limits import LimitsSection, PercentileLimit
from fpplab.diagnosis.sample import FrameSample

HARMONICS = (2, 3, 4)  # of the response that residuals of single frames are freed from, rising


class BrightnessLimits(LimitsSection):
    """From how many stripes on the brightness of a frame does not depend on their phase."""

    min_stripes: Positive = 4.0
    """Stripes of a set that the camera sees whole. Measured on benches."""
    min_stripes_in_part: Positive = 16.0
    """Stripes of a set of which the camera sees a part. Measured on benches."""
    crest_percentile: PercentileLimit = 90.0
    """Share of the pixels, in %, that are darker than the crests of the fringes. Chosen."""


@remembered
def frame_levels(sample: FrameSample) -> Floats:
    """Compute the brightness of each frame at the crests of its fringes, where the scene is bright."""
    # The mean would depend on the phase, where the camera sees few stripes.
    # returns (K,)
    brightest = sample.spread.max(axis=0)
    bright = brightest >= 0.5 * np.percentile(brightest, 95)
    percentile = sample.limits.of(BrightnessLimits).crest_percentile
    return np.asarray(np.percentile(sample.spread[:, bright], percentile, axis=1))


def harmonic_waves(turn: NDArray[np.complex128]) -> Iterator[Floats]:
    """Give those harmonics of the phase, exp(iφ) in N images, that the fit of a sinusoid to them leaves."""
    # turn (N, ...); returns (N, ...)
    harmonic, reached = turn, 1
    for order in HARMONICS:
        if not 1 < order % len(turn) < len(turn) - 1:
            continue
        for _ in range(order - reached):
            harmonic = harmonic * turn
        reached = order
        yield harmonic.real
        yield harmonic.imag
