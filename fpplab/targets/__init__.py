"""Boards: what is printed on them, and where their points are in a picture."""

from fpplab.targets.detection import Detection
from fpplab.targets.partial import UnclearPart
from fpplab.targets.target import Target

__all__ = ["Detection", "Target", "UnclearPart"]
