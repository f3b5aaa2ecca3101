"""Vibration of the bench, for the twin, by what frames have beyond the twin's.

An oscillation in step with the fringes' phase steps makes ripples of the phase that random displacements of
the same size do not, so it matters how vibration continues from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from sim.matching.fluctuation.frame_series import FrameFluctuation, fit_fluctuation
from sim.matching.fluctuation.frame_terms import MOVES, FrameTerms
from sim.parameters import NO_LINE, TwinParameters


def match_vibration(now: TwinParameters, terms: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the vibration of the bench."""
    motion = fit_fluctuation([pose.series(MOVES) for pose in terms])
    sigma = now.sigma_with(
        vibration_mm=motion.random.isotropic * motion.sigma, vibration_cycles_per_frame=motion.cycles_sigma
    )
    line = _line(motion)
    x, y, z = line.tolist()
    whole = float(line @ line)
    return replace(
        now,
        vibration_mm=motion.random.isotropic,
        vibration_line_mm=(x, y, z) if whole else NO_LINE,
        vibration_periodic=min(float(motion.oscillation @ motion.oscillation) / whole, 1.0) if whole else 0.0,
        vibration_cycles_per_frame=motion.cycles_per_frame,
        sigma=sigma,
    )


def _line(motion: FrameFluctuation) -> Floats:
    """RMS displacement (3,) along the line, of random numbers and oscillation together."""
    random, oscillation = motion.random.axis, motion.oscillation
    whole = np.outer(random, random) + np.outer(oscillation, oscillation)
    strength, directions = np.linalg.eigh(whole)
    return np.asarray(np.sqrt(max(float(strength.sum()), 0.0)) * directions[:, -1])
