"""Characterisation: calibrate a camera, a projector and the pose between them from poses of a board."""

from fpplab.characterisation.combination import Combination, combine
from fpplab.characterisation.correction import Correction, correct
from fpplab.characterisation.fitting import characterise
from fpplab.characterisation.judging import Judgement, judge, judged_board
from fpplab.characterisation.observation import Observation, finest_periods, observe
from fpplab.characterisation.parameters import DistortionModel
from fpplab.characterisation.result import Characterisation

__all__ = [
    "Characterisation",
    "Combination",
    "Correction",
    "DistortionModel",
    "Judgement",
    "Observation",
    "characterise",
    "combine",
    "correct",
    "finest_periods",
    "judge",
    "judged_board",
    "observe",
]
