"""Poses of a board -> camera, projector, and the pose between them."""

from fpplab.characterisation.bundle import Level
from fpplab.characterisation.fitting import characterise
from fpplab.characterisation.observation import Observation, finest_periods, observe
from fpplab.characterisation.result import Characterisation, Rejected, Trial

__all__ = [
    "Characterisation",
    "Level",
    "Observation",
    "Rejected",
    "Trial",
    "characterise",
    "finest_periods",
    "observe",
]
