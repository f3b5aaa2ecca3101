"""How far a cloud is from the true shape."""

from fpplab.comparison.compare import Comparison, compare, mcd, smcd

__all__ = ["Comparison", "compare", "mcd", "smcd"]
