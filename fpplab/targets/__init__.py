"""Characterisation boards: what is printed on them, and the detection of their points in images."""

from fpplab.targets.partial import UnclearPart
from fpplab.targets.target import Target

__all__ = ["Target", "UnclearPart"]
