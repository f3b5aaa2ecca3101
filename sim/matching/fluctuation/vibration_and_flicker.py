"""Vibration of the bench and flicker of its projector, for the twin, by what frames have beyond the twin's.

An oscillation in step with the fringes' phase steps makes ripples of the phase that random displacements of
the same size do not, so it matters how vibration continues from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from sim.matching.fluctuation.frame_series import FrameFluctuation, fit_fluctuation
from sim.matching.fluctuation.frame_terms import GAIN, MOVES, FrameTerms
from sim.parameters import NO_LINE, TwinParameters


def match_vibration(now: TwinParameters, seen: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the vibration of the bench."""
    found = fit_fluctuation([one.series(MOVES) for one in seen])
    sigma = now.sigma_with(
        vibration_mm=found.random.isotropic * found.sigma, vibration_cycles_per_frame=found.cycles_sigma
    )
    line = _line(found)
    x, y, z = line.tolist()
    whole = float(line @ line)
    return replace(
        now,
        vibration_mm=found.random.isotropic,
        vibration_line_mm=(x, y, z) if whole else NO_LINE,
        vibration_periodic=min(float(found.oscillation @ found.oscillation) / whole, 1.0) if whole else 0.0,
        vibration_cycles_per_frame=found.cycles_per_frame,
        sigma=sigma,
    )


def _line(found: FrameFluctuation) -> Floats:
    """RMS displacement (3,) along the line, of random numbers and oscillation together."""
    random, oscillation = found.random.axis, found.oscillation
    whole = np.outer(random, random) + np.outer(oscillation, oscillation)
    strength, directions = np.linalg.eigh(whole)
    return np.asarray(np.sqrt(max(float(strength.sum()), 0.0)) * directions[:, -1])


def match_flicker(now: TwinParameters, seen: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the flicker of the bench's projector."""
    found = fit_fluctuation([one.series(GAIN) for one in seen], oscillates=False)
    flicker = found.random.isotropic
    sigma = now.sigma_with(projector_flicker=flicker * found.sigma)
    return replace(now, projector_flicker=flicker, sigma=sigma)
