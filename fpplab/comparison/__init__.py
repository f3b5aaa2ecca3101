"""Comparing a measured cloud with the true shape: distances, alignment, visibility."""

from fpplab.comparison.compare import Comparison, compare, mcd, smcd
from fpplab.comparison.lengths import MeasuredLength
from fpplab.comparison.scale import FittedScale

__all__ = ["Comparison", "FittedScale", "MeasuredLength", "compare", "mcd", "smcd"]
