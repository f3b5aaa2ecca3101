"""Flicker of the bench's projector: its light from frame to frame, for the twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim.matching.fluctuation.frame_terms import GAIN, FrameTerms
from sim.matching.fluctuation.waves import change_of
from sim.parameters import TwinParameters


def match_flicker(now: TwinParameters, seen: Sequence[FrameTerms]) -> TwinParameters:
    """Give a twin the flicker of the bench's projector."""
    found = change_of([one.series(GAIN) for one in seen], swings=False)
    flicker = found.random.alike
    sigma = now.sigma_with(projector_flicker=flicker * found.sigma)
    return replace(now, projector_flicker=flicker, sigma=sigma)
