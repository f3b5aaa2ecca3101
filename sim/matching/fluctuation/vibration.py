"""Vibration of the bench, for the twin: how much, in which direction, and what of it has one frequency.

A swing in step with the fringes' phase steps makes ripples of the phase that random displacements of the same
size do not, so it matters how vibration goes on from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Floats
from sim.matching.fluctuation.frame_terms import MOVES, FrameTerms
from sim.matching.fluctuation.waves import Change, change_of
from sim.parameters import NO_LINE, TwinParameters


def match_vibration(now: TwinParameters, seen: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the vibration of the bench."""
    found = change_of([one.series(MOVES) for one in seen])
    sigma = now.sigma_with(
        vibration_mm=found.random.alike * found.sigma, vibration_cycles_per_frame=found.cycles_sigma
    )
    line = _line(found)
    x, y, z = line.tolist()
    whole = float(line @ line)
    return replace(
        now,
        vibration_mm=found.random.alike,
        vibration_line_mm=(x, y, z) if whole else NO_LINE,
        vibration_periodic=min(float(found.swing @ found.swing) / whole, 1.0) if whole else 0.0,
        vibration_cycles_per_frame=found.cycles_per_frame,
        sigma=sigma,
    )


def _line(found: Change) -> Floats:
    """RMS displacement (3,) along the line, of random numbers and swing together."""
    random, swing = found.random.line, found.swing
    whole = np.outer(random, random) + np.outer(swing, swing)
    strength, directions = np.linalg.eigh(whole)
    return np.asarray(np.sqrt(max(float(strength.sum()), 0.0)) * directions[:, -1])
