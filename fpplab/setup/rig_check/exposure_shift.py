"""How far a triggered exposure is shifted against its pattern: light of two patterns adds in its level."""

from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Floats


@dataclass(frozen=True)
class ShiftLimits:
    """From when on exposures are shifted; all chosen."""

    max_misfit: float = 0.02  # RMS that the mixture leaves, as a share of the levels' range
    min_share: float = 0.03  # of a neighbour in a frame
    max_share: float = 0.9  # beyond which it is a slip


LIMITS = ShiftLimits()


@dataclass(frozen=True)
class ExposureShift:
    """A shift of the exposures."""

    is_late: bool  # whether the frames mix in the next pattern; otherwise the one before
    share: float  # share of the exposure that falls into the neighbour


def find_exposure_shift(stepped: Floats, triggered: Floats) -> ExposureShift | None:
    # stepped (K,); triggered (K,)
    if not (np.isfinite(stepped).all() and np.isfinite(triggered).all()):
        return None
    mixtures = [
        (_fit_mixture_with_neighbour(stepped, triggered, neighbour), neighbour) for neighbour in (1, -1)
    ]
    (misfit, share), neighbour = min(mixtures)
    if misfit > LIMITS.max_misfit * np.ptp(stepped) or not LIMITS.min_share <= share <= LIMITS.max_share:
        return None
    return ExposureShift(neighbour > 0, share)


def _fit_mixture_with_neighbour(stepped: Floats, triggered: Floats, step: int) -> tuple[float, float]:
    """RMS misfit of the best mixture with the neighbour `step` patterns on, and that one's share."""
    inner = slice(1, -1)
    neighbour = np.roll(stepped, -step)[inner]
    columns = np.stack([stepped[inner], neighbour, np.ones(len(neighbour))], axis=1)
    factors, *_ = np.linalg.lstsq(columns, triggered[inner], rcond=None)
    misfit = float(np.sqrt(np.mean((columns @ factors - triggered[inner]) ** 2)))
    total = float(factors[0] + factors[1])
    share = float(factors[1] / total) if total > 0 and min(factors[:2]) >= 0 else 0.0
    return misfit, share
