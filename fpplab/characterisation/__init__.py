"""Poses of a board -> camera, projector, and the pose between them."""

from fpplab.characterisation.observation import Observation, finest_periods, observe
from fpplab.characterisation.zhang import Characterisation, characterise

__all__ = ["Characterisation", "Observation", "characterise", "finest_periods", "observe"]
