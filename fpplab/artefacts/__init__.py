"""True shapes: artefacts, a ball bar, parts read from files, and each of them as a printer makes it."""

from fpplab.artefacts.models import (
    NAMES,
    ROUND,
    STANDARDS,
    Pillars,
    Pyramid,
    StepsSizes,
    make,
    save_stl,
    usual_sizes,
)
from fpplab.artefacts.parts import check_solid, load_part
from fpplab.artefacts.slicing import layer_count, sliced
from fpplab.artefacts.standards import BallBar

__all__ = [
    "NAMES",
    "ROUND",
    "STANDARDS",
    "BallBar",
    "Pillars",
    "Pyramid",
    "StepsSizes",
    "check_solid",
    "layer_count",
    "load_part",
    "make",
    "save_stl",
    "sliced",
    "usual_sizes",
]
