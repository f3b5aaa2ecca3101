"""Flicker of the bench's projector: its light from frame to frame, for the twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fpplab.matching.frame_terms import GAIN, FrameTerms
from fpplab.matching.waves import change_of
from fpplab.simulation.matchable import TwinParameters


def match_flicker(now: TwinParameters, seen: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the flicker of the bench's projector."""
    found = change_of([one.series(GAIN) for one in seen], swings=False)
    flicker = found.random.alike
    sigma = now.sigma_with(projector_flicker=flicker * found.sigma)
    return replace(now, projector_flicker=flicker, sigma=sigma)
