"""Comparing a measured cloud with the true shape: distances, alignment, visibility."""

from fpplab.comparison.compare import Comparison, compare, mcd, smcd

__all__ = ["Comparison", "compare", "mcd", "smcd"]
