"""How sharp camera and projector are, by region, and how sharp they have been.

Camera: the RMS of the image's gradient under even light, per px and relative to its level. Noise would pass
for sharpness; so the gradients of two images of the same scene are multiplied, whose noise is independent.
Projector: the modulation of the finest stripes over that of the widest, which neither exposure nor the
part's colour changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.diagnosis.sample import FrameSample
from fpplab.live.regions import REGIONS, region_medians, region_slices

TEXTURE_SIGMAS = 4.0
"""So many times its standard uncertainty a region's gradient must be, or it has no texture to focus on."""

DARK_LEVEL = 2.0 / 255.0
"""Mean level, of full scale, below which a region is dark."""

ALIKE_SHARE = 0.98
"""A measure is at its best from this share of it on: noise alone changes it by as much."""


def camera_sharpness(one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> Floats:
    """Measure the sharpness of the camera's image.

    Parameters
    ----------
    one, other : ndarray of float, (height, width)
        Two images of the same scene in the same even light, as shares of full scale.

    Returns
    -------
    ndarray of float64, `REGIONS`
        RMS gradient over the mean level, 1/px; NaN where the region is dark or without texture.
    """
    found = np.full(REGIONS, np.nan)
    for region, part in region_slices(one.shape):
        a, b = (image[part].astype(np.float64) for image in (one, other))
        level = a.mean() * b.mean()
        if level < DARK_LEVEL**2 or min(a.shape) < 3:
            continue
        power, noises = 0.0, 0.0
        for axis in (0, 1):
            first, second = np.gradient(a, axis=axis), np.gradient(b, axis=axis)
            # About their means: light that falls off across the region is no texture.
            power += float(np.mean(first * second) - first.mean() * second.mean())
            noises += float(np.mean(np.square(first - second)))
        # Of two gradients with independent noise; neighbours share half of it.
        sigma = noises / 2.0 * math.sqrt(2.0 / a.size)
        if power > TEXTURE_SIGMAS * sigma:
            found[region] = math.sqrt(power / level)
    return found


def projector_contrast(sample: FrameSample) -> Floats:
    """Measure how much of the fringes' contrast the projector's lens, and the camera's, leave.

    Parameters
    ----------
    sample : FrameSample
        Of fringes of two widths along one axis.

    Returns
    -------
    ndarray of float64, `REGIONS`
        Modulation of the finest over that of the widest; NaN where the region is not lit, or saturated.
    """
    fine = sample.fits[sample.recording.plan.finest_set()]
    ratio = fine.modulation / np.maximum(sample.widest.modulation, 1e-9)
    return region_medians(ratio, sample.measured)


def overall(values: Floats) -> float | None:
    """Give one figure for all regions.

    Parameters
    ----------
    values : ndarray of float64
        By region, NaN where not known.

    Returns
    -------
    float or None
        The mean of those known; None where none is.
    """
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


@dataclass
class FocusTracker:
    """A measure of focus as it changes, with the best of each region so far.

    Attributes
    ----------
    now : ndarray of float64, `REGIONS`
        The latest; NaN where not known.
    best : ndarray of float64, `REGIONS`
        The greatest of each region; NaN where it was never known.
    """

    now: Floats = field(default_factory=lambda: np.full(REGIONS, np.nan))
    best: Floats = field(default_factory=lambda: np.full(REGIONS, np.nan))
    _best_overall: float | None = None

    def update(self, values: Floats) -> None:
        """Take the latest measure.

        Parameters
        ----------
        values : ndarray of float64, `REGIONS`
            NaN where not known.
        """
        self.now = values
        self.best = np.fmax(self.best, values)
        if (mean := overall(values)) is not None:
            self._best_overall = max(mean, self._best_overall or 0.0)

    def reset(self) -> None:
        """Forget what was best, after the part or its place has changed."""
        self.best, self._best_overall = self.now.copy(), overall(self.now)

    @property
    def shares(self) -> Floats:
        """The latest of each region over its best, `REGIONS`; NaN where not known."""
        return np.asarray(self.now / self.best)

    def summary(self) -> dict[str, float | bool | None]:
        """Collect what is shown.

        Returns
        -------
        dict
            `now` and `best` over all regions, `share` of the best, and `at_best`.
        """
        now, best = overall(self.now), self._best_overall
        share = now / best if now is not None and best else None
        at_best = share is not None and share >= ALIKE_SHARE
        return {"now": now, "best": best, "share": share, "at_best": at_best}
