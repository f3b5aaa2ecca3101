"""Comparing a measured cloud with the true shape: distances, alignment, visibility."""

from fpplab.comparison.compare import Comparison, UnseenMeshError, compare, mcd, smcd
from fpplab.comparison.lengths import MeasuredLength
from fpplab.comparison.misplacement import find_misplacement
from fpplab.comparison.scale import FittedScale

__all__ = [
    "Comparison",
    "FittedScale",
    "MeasuredLength",
    "UnseenMeshError",
    "compare",
    "find_misplacement",
    "mcd",
    "smcd",
]
